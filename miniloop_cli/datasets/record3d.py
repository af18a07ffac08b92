"""The metadata of Record3D, in its files and in its exports: clock, cameras, and ARKit's poses.

`K` is stored by columns, for the colour images of size `w` x `h` as stored, which are upright if the phone was; the
poses are of these images as well (github.com/nerfstudio-project/viser, extras/_record3d.py).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import numbers, trajectory_of, usable_pose
from miniloop_cli.datasets.stamps import SECONDS
from miniloop_cli.datasets.stream import RATE_HZ, Stream
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import Note, NoteKind, Trajectory
from miniloop_cli.typing import Floats

MAX_ZOOM = 0.5  # focal lengths of frames that differ by more are not of these images


def poses_of(data: dict[str, Any], where: str) -> Trajectory | None:
    """ARKit's poses (qx qy qz qw px py pz a frame, OpenGL camera axes), camera to world. Raises InputError."""
    rows = data.get("poses")
    if not isinstance(rows, list) or not rows:
        return None
    values = numbers(rows, 7 * len(rows), f"{where}: poses").reshape(-1, 7)
    norms = np.linalg.norm(values[:, :4], axis=1)
    usable = np.isfinite(values).all(axis=1) & (norms > 1e-6)
    rate_hz, times_s = clock(data, where)
    poses = {}
    for k in np.flatnonzero(usable).tolist():
        T_world_gl = se3.pose(se3.rotations(values[k, :4]), values[k, 4:])
        stamp = times_s[k] if times_s is not None and k < len(times_s) else k / rate_hz
        poses[float(stamp)] = usable_pose(T_world_gl @ OPENGL_AXES, where)
    return trajectory_of(poses, where)


def clock(data: dict[str, Any], where: str) -> tuple[float, Floats | None]:
    """Frames a second, and the times (s) of all frames by number, if the metadata have them. Raises InputError."""
    fps = data.get("fps")
    rate_hz = float(fps) if isinstance(fps, int | float) and 0.1 <= fps <= 1000 else RATE_HZ
    times = data.get("frameTimestamps")
    if not isinstance(times, list) or not times:
        return rate_hz, None
    times_s = numbers(times, len(times), f"{where}: frameTimestamps")
    if not np.isfinite(times_s).all():
        raise InputError(f"{where}: frameTimestamps must be finite numbers")
    return rate_hz, times_s


def timed(stream: Stream, times_s: Floats) -> Stream:
    """A stream with the times (n,) of its frame numbers; unchanged if there are too few."""
    if stream.numbers is None or stream.numbers[-1] >= len(times_s):
        return stream
    return replace(stream, times=times_s[stream.numbers], unit=SECONDS)


def too_few_times(color: Stream, times_s: Floats) -> tuple[Note, ...]:
    """A note if the metadata have fewer times (n,) than frames."""
    if color.numbers is None or color.numbers[-1] < len(times_s):
        return ()
    text = f"frameTimestamps has {len(times_s)} times, too few for frame numbers up to {color.numbers[-1]}: not used"
    return (Note(NoteKind.DROPPED, text),)


def cameras(
    data: dict[str, Any], where: str, color: Stream, name: str, depth_scale: float = 1000.0
) -> tuple[Camera, dict[ImageSource, Floats]]:
    """The camera of the recording, and each image's own (4,) fx fy cx cy if the metadata state them.

    If so, their median is the camera. `name` is that of the metadata, for messages. Raises InputError.
    """
    K = numbers(data.get("K"), 9, f"{where}: K")
    size = numbers([data.get("w"), data.get("h")], 2, f"{where}: w, h")
    pinhole, own, source = K[[0, 4, 6, 7]], {}, f"the sequence's own {name}"
    rows = data.get("perFrameIntrinsicCoeffs")
    if isinstance(rows, list) and rows:
        each = numbers(rows, 4 * len(rows), f"{where}: perFrameIntrinsicCoeffs").reshape(-1, 4)
        if not np.isfinite(each).all() or not (np.abs(each[:, :2] / pinhole[:2] - 1) < MAX_ZOOM).all():
            raise InputError(
                f"{where}: perFrameIntrinsicCoeffs (fx fy cx cy a frame) do not fit K; remove them to use K"
            )
        if color.numbers is not None:
            own = {
                image: each[number]
                for image, number in zip(color.sources, color.numbers.tolist(), strict=True)
                if number < len(each)
            }
        pinhole, source = np.median(each, axis=0), f"median of the {len(each)} cameras of the sequence's own {name}"
    keys = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale")
    values = dict(zip(keys, [*pinhole.tolist(), *size.tolist(), depth_scale], strict=True))
    return make_camera(values, where, source), own
