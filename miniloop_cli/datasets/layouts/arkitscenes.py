"""ARKitScenes, raw and 3dod: lowres_wide/, lowres_depth/, confidence/, lowres_wide_intrinsics/, lowres_wide.traj.

Images are called <video>_<seconds>.png. A .pincam holds `width height fx fy cx cy` of one image; its time may differ by
a millisecond from that of the image. A row of the .traj is `time, axis-angle (rad), translation (m)`, world to camera,
at 10 Hz (github.com/apple/ARKitScenes, DATA.md and threedod/benchmark_scripts/utils/tenFpsDataLoader.py).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets.beside import confidence_maps
from miniloop_cli.datasets.confidence import with_confidence
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import given_camera, read_matrix, trajectory_of, usable_pose
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import read_lines, shown
from miniloop_cli.datasets.stream import Stream, named_stream, stamped_files
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import DepthFormat, Note, NoteKind, Sequence, Trajectory
from miniloop_cli.typing import Floats

COLOR, DEPTH, CAMERAS, POSES = "lowres_wide", "lowres_depth", "lowres_wide_intrinsics", "lowres_wide.traj"
OTHERS = ("vga_wide", "wide", "ultrawide", "highres_depth")
SAME_S = 0.0025  # times of one image, in names that are rounded to milliseconds
MAX_ROWS = 100_000


class ARKitScenes:
    """ARKitScenes: lowres_wide/, lowres_depth/ (16-bit PNG, millimetres), confidence/, lowres_wide_intrinsics/."""

    def matches(self, root: Path) -> bool:
        """By the names of its folders, in the folder or in <video>_frames/."""
        return _folder(root) is not None

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`; each image has its own intrinsics. Raises InputError."""
        folder = _folder(root)
        if folder is None:
            raise InputError(f"{shown(root)}: no folders {COLOR} and {DEPTH}")
        color, depth = named_stream(folder, COLOR, (".png",)), named_stream(folder, DEPTH, (".png",))
        found = pair(folder, color, depth)
        frames, notes = found.frames, found.notes
        camera = given_camera(folder, camera_path, frames)
        if camera is None:
            camera, own = _cameras(folder, color)
            frames, said = with_own_cameras(frames, own, camera)
            notes = (*notes, *said)
        maps, where, beside = confidence_maps(folder, depth)
        frames, trusted = with_confidence(frames, maps, where)
        notes = (*notes, *trusted, *beside)
        if others := [name for name in OTHERS if (folder / name).is_dir()]:
            text = f"{', '.join(f'{name}/' for name in others)} not used: {COLOR}/ and {DEPTH}/ are"
            notes = (*notes, Note(NoteKind.UNUSED, text))
        truth = folder / POSES if (folder / POSES).is_file() else None
        return Sequence(root.name, root, camera, frames, truth, notes, found.available, DepthFormat(resample=True))

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's poses, camera to world: a reference, not the truth. Raises InputError."""
        path = sequence.ground_truth_path
        if path is None:
            return None
        poses = {}
        for number, line in read_lines(path)[:MAX_ROWS]:
            where = f"{shown(path)}:{number}"
            try:
                values = np.array([float(text) for text in line.split()])
            except ValueError:
                values = np.zeros(0)
            if len(values) != 7 or not np.isfinite(values).all():
                raise InputError(f"{where}: expected time, axis-angle (3) and translation (3)")
            T_cam_world = se3.pose(se3.exp_so3(values[1:4]), values[4:])
            poses[float(values[0])] = usable_pose(se3.inverse(T_cam_world), where)
        return trajectory_of(poses, shown(path))


def _folder(root: Path) -> Path | None:
    """The folder of the images: `root`, or <video>_frames/ in it."""
    inner = root / f"{root.name}_frames"
    return next((f for f in (root, inner) if (f / COLOR).is_dir() and (f / DEPTH).is_dir()), None)


def _cameras(folder: Path, color: Stream) -> tuple[Camera, dict[ImageSource, Floats]]:
    """The median camera, and each image's own (fx fy cx cy)."""
    files = stamped_files(folder, CAMERAS, (".pincam",))
    values = {stamp: read_matrix(path, (1, 6))[0] for stamp, path in files.items()}
    stamps, rows = np.array(list(values)), np.array(list(values.values()))
    order = np.argsort(stamps)
    stamps, rows = stamps[order], rows[order]
    where = shown(folder / CAMERAS)
    if (rows[:, :2] != rows[0, :2]).any():
        raise InputError(f"{where}: the cameras are for images of different sizes")
    width, height, fx, fy, cx, cy = np.median(rows, axis=0).tolist()
    median = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": width, "height": height, "depth_scale": 1000.0}
    camera = make_camera(median, where, f"median of the {len(rows)} cameras in {CAMERAS}")
    own: dict[ImageSource, Floats] = {}
    if color.times is None or color.unit is None:
        return camera, own
    for source, time_s in zip(color.sources, (color.times / color.unit.per_s).tolist(), strict=True):
        k = int(np.abs(stamps - time_s).argmin())
        if abs(stamps[k] - time_s) <= SAME_S:
            own[source] = rows[k, 2:]
    return camera, own
