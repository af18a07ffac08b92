"""Scenes of the BOP data sets: rgb/ or gray/, depth/, and scene_camera.json with the camera of each image.

`cam_K` is stored by rows and may differ from image to image; depth times `depth_scale` is millimetres; `cam_R_w2c` and
`cam_t_w2c` (mm) are optional. Axes are OpenCV's (github.com/thodan/bop_toolkit, docs/bop_datasets_format.md).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from miniloop_cli.datasets.depth_units import MetricDepth
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import color_size, given_camera, numbers, read_json, trajectory_of, usable_pose
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import DEPTH_SUFFIXES, IMAGE_SUFFIXES, shown
from miniloop_cli.datasets.stream import RATE_HZ, Stream, named_stream
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import DepthFormat, Frame, Sequence, Trajectory
from miniloop_cli.typing import Floats

CAMERAS = "scene_camera.json"
COLOR = ("rgb", "gray")


class Bop:
    """BOP: a scene with rgb/ or gray/, depth/ and scene_camera.json."""

    def matches(self, root: Path) -> bool:
        """By the names of its files and folders."""
        return (root / CAMERAS).is_file() and (root / "depth").is_dir() and _color(root) is not None

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The scene in `root`, paired by image number; the median camera is that of all. Raises InputError."""
        folder = _color(root)
        if folder is None:
            raise InputError(f"{shown(root)}: no folder rgb/ or gray/; give one scene of a BOP data set")
        entries = _entries(root / CAMERAS)
        color, depth = named_stream(root, folder, IMAGE_SUFFIXES), named_stream(root, "depth", DEPTH_SUFFIXES)
        found = pair(root, color, depth)
        units = {number: entry.units_per_m for number, entry in entries.items()}
        frames, camera, notes = found.frames, given_camera(root, camera_path, found.frames), found.notes
        form = DepthFormat()
        if camera is None:
            scale = float(np.median(list(units.values())))
            camera, own = _cameras(root, entries, color, frames, scale)
            if any(abs(unit / scale - 1) > 1e-9 for unit in units.values()):
                frames, camera, form = _metric(frames, _by_number(depth), units, camera)
            frames, said = with_own_cameras(frames, own, camera)
            notes = (*notes, *said)
        truth = root / CAMERAS if any(entry.T_world_cam is not None for entry in entries.values()) else None
        return Sequence(root.name, root, camera, frames, truth, notes, found.available, form)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of scene_camera.json, if it has them, camera to world in metres."""
        path = sequence.ground_truth_path
        if path is None:
            return None
        poses = {number / RATE_HZ: entry.T_world_cam for number, entry in _entries(path).items()}
        return trajectory_of(poses, shown(path))


class _Entry(NamedTuple):
    """The camera of an image: (fx fy cx cy), units of its depth a metre, its pose."""

    pinhole: Floats
    units_per_m: float
    T_world_cam: Floats | None


def _entries(path: Path) -> dict[int, _Entry]:
    """The cameras by the numbers of the images. Raises InputError."""
    found = {}
    for name, entry in read_json(path).items():
        where = f"{shown(path)}: image {shown(name[:40])}"
        if not (name.isascii() and name.isdigit() and len(name) <= 12) or not isinstance(entry, dict):
            raise InputError(f"{where}: expected the number of an image and its camera")
        K = numbers(entry.get("cam_K"), 9, f"{where}: cam_K")
        mm = numbers(entry.get("depth_scale"), 1, f"{where}: depth_scale")[0]
        if not 1e-6 < mm < 1e6:
            raise InputError(f"{where}: a depth_scale of {mm:g} mm a unit")
        found[int(name)] = _Entry(K[[0, 4, 2, 5]], 1000 / float(mm), _pose(entry, where))
    if not found:
        raise InputError(f"{shown(path)} has no images")
    return found


def _pose(entry: dict[str, Any], where: str) -> Floats | None:
    if "cam_R_w2c" not in entry or "cam_t_w2c" not in entry:
        return None
    R = numbers(entry["cam_R_w2c"], 9, f"{where}: cam_R_w2c").reshape(3, 3)
    t_m = numbers(entry["cam_t_w2c"], 3, f"{where}: cam_t_w2c") / 1000
    T_cam_world = usable_pose(se3.pose(R, t_m), where)
    return None if T_cam_world is None else se3.inverse(T_cam_world)


def _color(root: Path) -> str | None:
    return next((name for name in COLOR if (root / name).is_dir()), None)


def _by_number(stream: Stream) -> dict[ImageSource, int]:
    if stream.numbers is None:
        raise InputError(f"{stream.where}: its images are not numbered, as those of BOP are")
    return dict(zip(stream.sources, stream.numbers.tolist(), strict=True))


def _cameras(
    root: Path, entries: dict[int, _Entry], color: Stream, frames: tuple[Frame, ...], scale: float
) -> tuple[Camera, dict[ImageSource, Floats]]:
    """The median camera, and that of each image."""
    size, where = color_size(frames), shown(root / CAMERAS)
    if size is None:
        raise InputError(f"{shown(root)}: none of the first {len(frames[:20])} colour images can be read")
    by_number = _by_number(color)
    own: dict[ImageSource, Floats] = {s: entries[k].pinhole for s, k in by_number.items() if k in entries}
    if missing := [number for number in by_number.values() if number not in entries]:
        raise InputError(f"{where} has no camera for image {missing[0]}; give one for all with --camera")
    values = dict(zip(("fx", "fy", "cx", "cy"), np.median(list(own.values()), axis=0).tolist(), strict=True))
    values |= {"width": size[0], "height": size[1], "depth_scale": scale}
    return make_camera(values, where, f"median of the {len(own)} cameras in {CAMERAS}"), own


def _metric(
    frames: tuple[Frame, ...], numbers_of: dict[ImageSource, int], units: dict[int, float], camera: Camera
) -> tuple[tuple[Frame, ...], Camera, DepthFormat]:
    """Frames, camera and format of a scene whose images have different units of depth: all become metres."""
    made = tuple(replace(f, depth=MetricDepth(f.depth, units[numbers_of[f.depth]])) for f in frames)
    return made, replace(camera, depth_scale=1.0), DepthFormat(floating=True)
