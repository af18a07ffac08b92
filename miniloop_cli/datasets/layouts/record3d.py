"""Record3D exports: rgb/, depth/ (16-bit PNG, millimetres, lower resolution) and metadata.json with ARKit's poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.beside import unused_confidence
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import (
    given_camera,
    numbers,
    read_json,
    trajectory_of,
    usable_pose,
)
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import DEPTH_SUFFIXES, IMAGE_SUFFIXES, shown
from miniloop_cli.datasets.stamps import SECONDS
from miniloop_cli.datasets.stream import RATE_HZ, Stream, named_stream
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import DepthFormat, Note, NoteKind, Sequence, Trajectory
from miniloop_cli.typing import Floats

MAX_ZOOM = 0.5  # a frame's focal length beyond is not of these images


class Record3D:
    """Record3D: rgb/, depth/ (16-bit PNG, millimetres), metadata.json."""

    def matches(self, root: Path) -> bool:
        """By the names of its files and folders."""
        return all((root / name).exists() for name in ("rgb", "depth", "metadata.json"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`. Raises InputError, also for depth in EXR or in the app's own compression."""
        color, depth = named_stream(root, "rgb", IMAGE_SUFFIXES), named_stream(root, "depth", DEPTH_SUFFIXES)
        path = root / "metadata.json"
        data = read_json(path) if path.exists() else {}
        rate_hz, times_s = _clock(data, shown(path))
        notes: tuple[Note, ...] = ()
        if times_s is not None:
            color, depth, notes = _timed(color, times_s), _timed(depth, times_s), _if_short(color, times_s)
        found = pair(root, color, depth, rate_hz=rate_hz)
        frames = found.frames
        camera = given_camera(root, camera_path, frames)
        if camera is None:
            camera, own = _cameras(data, shown(path), color)
            frames, said = with_own_cameras(frames, own, camera)
            notes = (*notes, *said)
        truth = path if path.exists() else None
        form = DepthFormat(resample=True)
        return Sequence(
            root.name,
            root,
            camera,
            frames,
            truth,
            (*found.notes, *notes, *unused_confidence(root)),
            found.available,
            form,
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's poses (qx qy qz qw px py pz a frame, OpenGL camera axes): a reference, not the truth."""
        if sequence.ground_truth_path is None:
            return None
        where = shown(sequence.ground_truth_path)
        data = read_json(sequence.ground_truth_path)
        rows = data.get("poses")
        if not isinstance(rows, list) or not rows:
            return None
        values = numbers(rows, 7 * len(rows), f"{where}: poses").reshape(-1, 7)
        norms = np.linalg.norm(values[:, :4], axis=1)
        usable = np.isfinite(values).all(axis=1) & (norms > 1e-6)
        rate_hz, times_s = _clock(data, where)
        poses = {}
        for k in np.flatnonzero(usable).tolist():
            T_world_gl = se3.pose(se3.rotations(values[k, :4]), values[k, 4:])
            stamp = times_s[k] if times_s is not None and k < len(times_s) else k / rate_hz
            poses[float(stamp)] = usable_pose(T_world_gl @ OPENGL_AXES, where)
        return trajectory_of(poses, where)


def _clock(data: dict[str, Any], where: str) -> tuple[float, Floats | None]:
    """Frames a second, and the times (s) of all frames by number where the metadata state them."""
    fps = data.get("fps")
    rate_hz = float(fps) if isinstance(fps, int | float) and 0.1 <= fps <= 1000 else RATE_HZ
    times = data.get("frameTimestamps")
    if not isinstance(times, list) or not times:
        return rate_hz, None
    times_s = numbers(times, len(times), f"{where}: frameTimestamps")
    if not np.isfinite(times_s).all():
        raise InputError(f"{where}: frameTimestamps must be finite numbers")
    return rate_hz, times_s


def _timed(stream: Stream, times_s: Floats) -> Stream:
    """A stream with the times of its frame numbers; as it is where they do not reach."""
    if stream.numbers is None or stream.numbers[-1] >= len(times_s):
        return stream
    return replace(stream, times=times_s[stream.numbers], unit=SECONDS)


def _if_short(color: Stream, times_s: Floats) -> tuple[Note, ...]:
    if color.numbers is None or color.numbers[-1] < len(times_s):
        return ()
    text = f"frameTimestamps has {len(times_s)} times, too few for frame numbers up to {color.numbers[-1]}: not used"
    return (Note(NoteKind.DROPPED, text),)


def _cameras(data: dict[str, Any], where: str, color: Stream) -> tuple[Camera, dict[ImageSource, Floats]]:
    """The camera of the recording, and each image's own (fx fy cx cy) where the metadata state them.

    `K` is stored by columns and belongs to the colour images of size `w` x `h`, as the coefficients of the frames do;
    where there are such, their median is the camera.
    """
    K = numbers(data.get("K"), 9, f"{where}: K")
    size = numbers([data.get("w"), data.get("h")], 2, f"{where}: w, h")
    pinhole, own, source = K[[0, 4, 6, 7]], {}, "the sequence's own metadata.json"
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
        pinhole, source = (
            np.median(each, axis=0),
            f"median of the {len(each)} cameras of the sequence's own metadata.json",
        )
    keys = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale")
    values = dict(zip(keys, [*pinhole.tolist(), *size.tolist(), 1000.0], strict=True))
    return make_camera(values, where, source), own
