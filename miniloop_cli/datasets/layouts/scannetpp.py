"""ScanNet++'s iPhone recordings: iphone/rgb.mp4, depth.bin and pose_intrinsic_imu.json.

The JSON holds, by frame ("frame_000012" is the 12th of the video from 0 on), `timestamp` (s), `intrinsic` (3 x 3, for
the size of the video) and `aligned_pose` (4 x 4, camera to world, x right, y down, z forward: the authors' own
iphone/arkit_pcl.py uses it without turning axes; `pose`, ARKit's own, is not used). See github.com/scannetpp/scannetpp.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.depth_bin import depth_frames
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import (
    frame_number,
    given_camera,
    numbers,
    read_json,
    trajectory_of,
    usable_pose,
)
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.stream import Stream
from miniloop_cli.datasets.video_stream import timed_video
from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import DepthFormat, Note, NoteKind, Sequence, Trajectory
from miniloop_cli.typing import Floats

VIDEO, DEPTH, FRAMES = "rgb.mp4", "depth.bin", "pose_intrinsic_imu.json"
METRES = 1.0  # units of depth a metre


class ScanNetPP:
    """ScanNet++ (iPhone): iphone/rgb.mp4 (needs av), depth.bin (needs lz4), pose_intrinsic_imu.json."""

    def matches(self, root: Path) -> bool:
        """By the names of its files, in the folder or in iphone/."""
        return any(all((folder / name).is_file() for name in (VIDEO, DEPTH, FRAMES)) for folder in _folders(root))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`; frames of video and depth are decoded when they are read. Raises InputError."""
        folder = _folder(root)
        entries = _entries(folder / FRAMES)
        depth = _depth(folder / DEPTH, len(entries))
        assert depth.numbers is not None
        color, said = timed_video(folder / VIDEO, depth.numbers, _stamps(entries, folder / FRAMES), FRAMES)
        found = pair(root, color, depth)
        frames, notes = found.frames, (*found.notes, *said)
        camera = given_camera(folder, camera_path, frames, METRES)
        if camera is None:
            camera, own = _cameras(entries, folder / FRAMES, color)
            frames, moved = with_own_cameras(frames, own, camera)
            notes = (*notes, *moved)
        if (folder / "rgb_mask.mkv").exists():
            notes = (*notes, Note(NoteKind.UNUSED, "rgb_mask.mkv is not used: the pixels that it masks are used"))
        truth = folder / FRAMES if any("aligned_pose" in entry for entry in entries.values()) else None
        form = DepthFormat(floating=True, resample=True)
        return Sequence(root.name, root, camera, frames, truth, notes, found.available, form)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's poses, aligned to the laser scan by the authors: a reference, not the truth."""
        path = sequence.ground_truth_path
        if path is None:
            return None
        entries = _entries(path)
        stamps = {int(Path(frame.depth.name).name): frame.timestamp_s for frame in sequence.frames}
        stamps |= _stamps(entries, path)
        poses = {}
        for number, entry in entries.items():
            if number in stamps and "aligned_pose" in entry:
                where = f"{shown(path)}: frame_{number:06d}: aligned_pose"
                poses[stamps[number]] = usable_pose(numbers(entry["aligned_pose"], 16, where).reshape(4, 4), where)
        return trajectory_of(poses, shown(path))


def _folders(root: Path) -> tuple[Path, Path]:
    return root / "iphone", root


def _folder(root: Path) -> Path:
    found = next((folder for folder in _folders(root) if (folder / FRAMES).is_file()), None)
    if found is None:
        raise InputError(f"{shown(root)}: no {FRAMES}, neither there nor in iphone/")
    return found


def _entries(path: Path) -> dict[int, dict[str, Any]]:
    """The entries of the JSON by frame number, in order. Raises InputError."""
    found = {}
    for name, entry in read_json(path).items():
        number = frame_number(name)
        if number is None or not name.startswith("frame_") or not isinstance(entry, dict):
            raise InputError(f"{shown(path)}: '{shown(name[:40])}' is not a frame; expected frame_000000: {{...}}")
        found[number] = entry
    if not found:
        raise InputError(f"{shown(path)} has no frames")
    return dict(sorted(found.items()))


def _stamps(entries: dict[int, dict[str, Any]], path: Path) -> dict[int, float]:
    """The times (s) of the frames that have one. Raises InputError."""
    stamped = [number for number, entry in entries.items() if "timestamp" in entry]
    stamps = numbers([entries[number]["timestamp"] for number in stamped], len(stamped), f"{shown(path)}: timestamp")
    if not np.isfinite(stamps).all():
        raise InputError(f"{shown(path)}: a timestamp is not finite")
    return dict(zip(stamped, stamps.tolist(), strict=True))


def _depth(path: Path, count: int) -> Stream:
    sources = depth_frames(path, count)
    places = tuple(f"{DEPTH}:{source.number}" for source in sources)
    return Stream(DEPTH, sources, places, np.arange(len(sources), dtype=np.int64))


def _cameras(entries: dict[int, dict[str, Any]], path: Path, color: Stream) -> tuple[Any, dict[ImageSource, Floats]]:
    """The median camera and that of each frame of the video."""
    where, pinholes = shown(path), {}
    for number, entry in entries.items():
        if "intrinsic" in entry:
            K = numbers(entry["intrinsic"], 9, f"{where}: frame_{number:06d}: intrinsic")
            pinholes[number] = K[[0, 4, 2, 5]]
    if not pinholes:
        raise InputError(f"{where}: no frame has an intrinsic matrix; give the camera with --camera")
    assert color.numbers is not None
    keys = ("fx", "fy", "cx", "cy")
    values = dict(zip(keys, np.median(list(pinholes.values()), axis=0).tolist(), strict=True))
    size = color.sources[0].header()
    values |= {"width": size.width, "height": size.height, "depth_scale": METRES}
    camera = make_camera(values, where, f"median of the {len(pinholes)} cameras of the sequence's own {FRAMES}")
    pairs = zip(color.numbers.tolist(), color.sources, strict=True)
    return camera, {source: pinholes[number] for number, source in pairs if number in pinholes}
