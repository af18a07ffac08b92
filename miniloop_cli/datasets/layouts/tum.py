"""TUM RGB-D folders: rgb/, depth/, tables rgb.txt and depth.txt (or file names that are stamps), groundtruth.txt."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets.association import MAX_DIFFERENCE_S, associate, read_table, stamped_images
from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.intrinsics import default_camera, freiburg_camera, freiburg_family
from miniloop_cli.datasets.numbered import given_camera
from miniloop_cli.datasets.paths import read_bytes, shown
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Frame, Sequence, Trajectory


class Tum:
    """TUM: rgb/ and depth/ (16-bit PNG, 5000 units a metre), with rgb.txt and depth.txt or stamps as names."""

    def matches(self, root: Path) -> bool:
        """By the names of its tables and folders."""
        return all((root / f"{kind}.txt").exists() or (root / kind).is_dir() for kind in ("rgb", "depth"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`; nothing is decoded.

        Raises InputError for malformed tables, rows that lead outside the folder, and where no colour image has a
        depth image within 20 ms.
        """
        (color, color_from), (depth, depth_from) = _images(root, "rgb"), _images(root, "depth")
        color_s, depth_s = [t for t, _ in color], [t for t, _ in depth]
        pairs = associate(color_s, depth_s)
        if not len(pairs):
            raise InputError(f"{shown(root)}: {_why_nothing(color_s, depth_s, color_from, depth_from)}")
        frames = tuple(
            Frame(color[i][0], ImageFile(color[i][1]), ImageFile(depth[j][1]), depth_timestamp_s=depth[j][0])
            for i, j in pairs.tolist()
        )
        notes = []
        if len(frames) < max(len(color), len(depth)):
            within = f"within {1000 * MAX_DIFFERENCE_S:.0f} ms"
            notes.append(f"{len(frames)} pairs {within} from {len(color)} colour and {len(depth)} depth images")
        truth = root / "groundtruth.txt"
        return Sequence(
            root.name,
            root,
            choose_camera(root, camera_path, frames),
            frames,
            ground_truth_path=truth if truth.exists() else None,
            notes=tuple(notes),
            available=(len(color), len(depth)),
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The motion capture trajectory, where there is one."""
        if sequence.ground_truth_path is None:
            return None
        stamps = np.array([frame.timestamp_s for frame in sequence.frames])
        return read_trajectory(sequence.ground_truth_path, stamps, lambda: {"frames of the recording": stamps})


def choose_camera(root: Path, camera_path: Path | None, frames: tuple[Frame, ...] = ()) -> Camera:
    """The given file, the sequence's own camera.yaml, its TUM family (header, then name), or TUM's default."""
    if camera := given_camera(root, camera_path, frames, depth_scale=5000.0):
        return camera
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        if (root / name).exists() and (family := freiburg_family(_header(root / name))):
            return freiburg_camera(family, f"the header of {name}")
    if family := freiburg_family(root.name):
        return freiburg_camera(family, "the folder's name")
    return default_camera()


def _header(path: Path) -> str:
    text = read_bytes(path).decode("utf-8", "replace")
    return "\n".join(line for line in text[:4096].split("\n") if line.startswith("#"))


def _images(root: Path, kind: str) -> tuple[list[tuple[float, Path]], str]:
    if (root / f"{kind}.txt").exists():
        return read_table(root, f"{kind}.txt"), f"{kind}.txt"
    return stamped_images(root, kind), f"{kind}/"


def _why_nothing(color_s: list[float], depth_s: list[float], color_from: str, depth_from: str) -> str:
    for stamps, origin in ((color_s, color_from), (depth_s, depth_from)):
        if not stamps:
            return f"{origin} names no images"
    at = np.searchsorted(depth_s, color_s).clip(1, max(len(depth_s) - 1, 1))
    around = np.array(depth_s)[np.stack([at - 1, at.clip(max=len(depth_s) - 1)])]
    nearest = np.abs(around - np.array(color_s)).min()
    return (
        f"no colour image has a depth image within {1000 * MAX_DIFFERENCE_S:.0f} ms; the nearest stamps of "
        f"{color_from} and {depth_from} are {nearest:.3f} s apart; are both of one recording, and in seconds?"
    )
