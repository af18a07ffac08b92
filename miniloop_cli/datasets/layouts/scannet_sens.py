"""ScanNet's .sens files: colour (JPEG, PNG), depth (zlib) and poses in one file, which is not unpacked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import given_camera, trajectory_of, usable_pose
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.sens import SensFile, SensHeader, read_sens
from miniloop_cli.datasets.stamps import SECONDS
from miniloop_cli.datasets.stream import RATE_HZ, Stream
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import DepthCamera, DepthFormat, Note, NoteKind, Sequence, Trajectory, dropped_images
from miniloop_cli.typing import Floats

MAX_APART_M, MAX_TURNED = 0.001, 0.001  # largest difference of the colour and depth cameras for registered depth
SAME_VIEW_PX = 1.0  # at the corners of colour


class ScanNetSens:
    """ScanNet's .sens: colour as JPEG or PNG, depth as zlib or raw, poses."""

    def matches(self, root: Path) -> bool:
        """By the suffix of the file."""
        return root.suffix.lower() == ".sens" and root.is_file()

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in the file `root`. Raises InputError, also if depth is not registered to colour."""
        held = read_sens(root)
        header, where = held.header, shown(root)
        _require_registered(header, where)
        count = len(held.color)
        times_s, notes = _times(held), list[Note]()
        if count < header.frames:
            text = f"{where} ends after {count} of {header.frames} frames: it was cut off, or is damaged there"
            notes.append(dropped_images(text, header.frames - count, header.frames))
        numbers = np.arange(count, dtype=np.int64)
        color = Stream("colour", held.color, tuple(image.name for image in held.color), numbers, times_s, SECONDS)
        depth = Stream("depth", held.depth, tuple(image.name for image in held.depth), numbers)
        found = pair(root, color, depth)
        frames = found.frames
        camera = given_camera(root.parent, camera_path, frames, header.depth_scale) if camera_path else None
        if camera is None:
            camera = _checked(header.K_color, header, header.color_size, f"{root.name}, its colour camera")
        own = None
        if not _same_view(header):
            depth_camera = _checked(header.K_depth, header, header.depth_size, f"{root.name}, its depth camera")
            own = DepthCamera(depth_camera, tuple(np.eye(4).ravel().tolist()))
            text = "depth has intrinsics of its own: it is registered to colour as it is read"
            notes.append(Note(NoteKind.CONVERTED, text))
        notes = [*found.notes, *notes]
        form = DepthFormat(resample=True)
        said = tuple(notes)
        return Sequence(root.stem, root, camera, frames, root, said, found.available, form, depth_camera=own)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of the file, camera to world; frames where tracking was lost have none."""
        held = read_sens(sequence.root)
        times_s = _times(held)
        stamps = times_s if times_s is not None else np.arange(len(held.color)) / RATE_HZ
        where = shown(sequence.root)
        poses = {
            stamp: usable_pose(T, f"{where}: frame {k}")
            for k, (stamp, T) in enumerate(zip(stamps.tolist(), held.poses, strict=True))
        }
        return trajectory_of(poses, where)


def _times(held: SensFile) -> Floats | None:
    """The times (s) of the colour images; None if they do not increase."""
    times_s = held.stamps_us[:, 0] / 1e6
    increasing = (np.diff(times_s) > 0).all() and (len(times_s) > 1 or times_s[0] > 0)
    return times_s if increasing else None


def _pinhole(K: Floats) -> tuple[float, float, float, float]:
    """fx fy cx cy."""
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def _checked(K: Floats, header: SensHeader, size: tuple[int, int], name: str) -> Camera:
    """A camera of the file. Raises ConfigError for impossible values."""
    values = dict(zip(("fx", "fy", "cx", "cy", "width", "height"), (*_pinhole(K), *size), strict=True))
    return make_camera(values | {"depth_scale": header.depth_scale}, name, name)


def _require_registered(header: SensHeader, where: str) -> None:
    """Raise InputError if the cameras of colour and depth have different poses."""
    color, depth = header.extrinsics
    moved, turned = np.abs(color[:3, 3] - depth[:3, 3]).max(), np.abs(color[:3, :3] - depth[:3, :3]).max()
    if not moved <= MAX_APART_M or not turned <= MAX_TURNED:
        raise InputError(
            f"{where}: the cameras of colour and depth are {1000 * moved:.0f} mm apart: depth is not registered to "
            "colour; register it first"
        )


def _same_view(header: SensHeader) -> bool:
    """Whether depth, scaled to the size of colour, shows the same pixels (centres of pixels are whole numbers)."""
    (fx, fy, cx, cy), (ax, ay, bx, by) = _pinhole(header.K_depth), _pinhole(header.K_color)
    (width, height), (w, h) = header.color_size, header.depth_size
    for size, small, f, c, a, b in ((width, w, fx, cx, ax, bx), (height, h, fy, cy, ay, by)):
        scale = size / small
        F, C = f * scale, (c + 0.5) * scale - 0.5
        if not all(abs((end - b) / max(a, 1e-9) * F + C - end) <= SAME_VIEW_PX for end in (0, size - 1)):
            return False
    return True
