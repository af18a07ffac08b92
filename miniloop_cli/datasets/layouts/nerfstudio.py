"""nerfstudio's transforms.json with depth images: NeRFCapture, and recordings prepared for nerfstudio or Instant-NGP.

`file_path` and `depth_file_path` (nerfstudio) or `depth_path` (NeRFCapture, Instant-NGP) name a frame's images,
`transform_matrix` its pose, camera to world in OpenGL's axes. Depth times `depth_unit_scale_factor` (nerfstudio, 0.001
if it is not stated) or `integer_depth_scale` (Instant-NGP) is metres. Intrinsics may be those of each frame
(github.com/nerfstudio-project/nerfstudio, docs/quickstart/data_conventions.md; github.com/jc211/NeRFCapture,
NeRFCapture/Models/Manifest.swift and NeRFCapture/DatasetWriter.swift).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.camera_files import nerfstudio
from miniloop_cli.datasets.camera_files.fields import Fields
from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import MAX_JSON_BYTES, given_camera, numbers, read_json, trajectory_of, usable_pose
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.paths import IMAGE_SUFFIXES, read_bytes, shown, within
from miniloop_cli.datasets.stamps import apart, in_seconds, unit_notes, unit_of
from miniloop_cli.datasets.stream import RATE_HZ
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import DepthFormat, Frame, Note, NoteKind, Sequence, Trajectory, dropped_images
from miniloop_cli.typing import Floats

TRANSFORMS = "transforms.json"
DEPTH_KEYS = ("depth_file_path", "depth_path")
TABLES = ("rgb.txt", "depth.txt")  # a recording with these is TUM's, and its transforms.json an export
PINHOLE = ("fl_x", "fl_y", "cx", "cy")
CORNER = np.array([0, 0, 0.5, 0.5])  # the principal point counts from the corner of the first pixel


class Nerfstudio:
    """NeRFCapture, nerfstudio: transforms.json whose frames name depth images."""

    def matches(self, root: Path) -> bool:
        """By a transforms.json that names depth images."""
        path = root / TRANSFORMS
        if not path.is_file() or any((root / name).exists() for name in TABLES):
            return False
        try:
            content = read_bytes(path, MAX_JSON_BYTES)
        except InputError:
            return False
        return any(f'"{key}"'.encode() in content for key in DEPTH_KEYS)

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`, with the frames that have both images. Raises InputError."""
        path = root / TRANSFORMS
        data = read_json(path)
        entries = _entries(data, path)
        frames, own = [], {}
        stamps, notes = _stamps(entries, shown(path))
        missing = 0
        for k, entry in enumerate(entries):
            color, depth = _images(root, entry, f"{shown(path)}: frame {k}")
            if depth is None or not color.path.is_file() or not depth.path.is_file():
                missing += 1
                continue
            frames.append(Frame(stamps[k], color, depth))
            own[color] = entry
        if not frames:
            raise InputError(
                f"{shown(path)}: none of its {len(entries)} frames has a depth image beside its colour image"
            )
        if missing:
            text = (
                f"{missing} of {len(entries)} frames of {TRANSFORMS} lack an image, colour or depth: they are not used"
            )
            notes.append(dropped_images(text, missing, len(entries)))
        kept = tuple(sorted(frames, key=lambda frame: frame.timestamp_s))
        camera = given_camera(root, camera_path, kept)
        if camera is None:
            camera, pinholes = _cameras(data, own, path)
            kept, said = with_own_cameras(kept, pinholes, camera)
            notes += said
        available = (len(entries), len(entries) - missing)
        return Sequence(root.name, root, camera, kept, path, tuple(notes), available, DepthFormat(resample=True))

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of transforms.json, camera to world: a reference of the app or of another tool, not the truth."""
        path = sequence.ground_truth_path
        if path is None:
            return None
        entries = _entries(read_json(path), path)
        stamps, _ = _stamps(entries, shown(path))
        poses = {}
        for k, entry in enumerate(entries):
            where = f"{shown(path)}: frame {k}: transform_matrix"
            T = numbers(entry.get("transform_matrix"), 16, where).reshape(4, 4)
            poses[stamps[k]] = usable_pose(T @ OPENGL_AXES, where)
        return trajectory_of(poses, shown(path))


def _entries(data: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    """The entries of the frames, in the order of the file. Raises InputError."""
    frames = data.get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise InputError(f"{shown(path)}: frames must be a list of frames")
    return frames


def _stamps(entries: list[dict[str, Any]], where: str) -> tuple[list[float], list[Note]]:
    """The times (s) of all frames, with notes on their origin; if some frames have none, all are numbered instead.

    Raises InputError for equal times, and for times in an unknown unit.
    """
    key = next((key for key in ("timestamp", "time") if all(key in entry for entry in entries)), None)
    if key is None or not entries:
        text = f"the frames have no time stamps: {RATE_HZ:g} frames a second are assumed"
        return (np.arange(len(entries)) / RATE_HZ).tolist(), [Note(NoteKind.ASSUMED, text)]
    found = numbers([entry[key] for entry in entries], len(entries), f"{where}: {key}")
    if not np.isfinite(found).all() or len(np.unique(found)) < len(found):
        raise InputError(f"{where}: {key} must be a finite number, another one for each frame")
    unit = unit_of(found)
    if unit is None:
        raise InputError(f"{where}: {key} steps by {apart(found):g}: seconds or milliseconds? Write it in seconds")
    return in_seconds(found, unit).tolist(), unit_notes(where, found, unit)


def _images(root: Path, entry: dict[str, Any], where: str) -> tuple[ImageFile, ImageFile | None]:
    """The images that a frame names; NeRFCapture writes the colour image's name without its suffix."""
    name, depth = entry.get("file_path"), next((entry[key] for key in DEPTH_KEYS if entry.get(key)), None)
    if not isinstance(name, str) or not isinstance(depth, str | None):
        raise InputError(f"{where}: file_path must name an image")
    color = within(root, name, where)
    if not color.suffix or not color.is_file():
        candidates = (color.with_name(color.name + suffix) for suffix in IMAGE_SUFFIXES)
        color = next((path for path in candidates if path.is_file()), color)
    return ImageFile(color), ImageFile(within(root, depth, where)) if depth else None


def _cameras(
    data: dict[str, Any], own: dict[ImageFile, dict[str, Any]], path: Path
) -> tuple[Camera, dict[ImageSource, Floats]]:
    """The common camera, which is the median of the frames' own cameras, if they have some; and these."""
    where = shown(path)
    pinholes: dict[ImageSource, Floats] = {}
    sides = [[entry.get(key, data.get(key)) for key in ("w", "h")] for entry in own.values()]
    sizes = numbers(sides, 2 * len(sides), f"{where}: w, h").reshape(-1, 2)
    if (sizes != sizes[0]).any():
        raise InputError(f"{where}: the frames have images of different sizes")
    for image, entry in own.items():
        pinhole = [entry.get(key, data.get(key)) for key in PINHOLE]
        pinholes[image] = numbers(pinhole, 4, f"{where}: fl_x, fl_y, cx, cy")
    median = np.median(list(pinholes.values()), axis=0).tolist()
    width, height = sizes[0].tolist()
    shared = {key: data[key] for key in (*nerfstudio.LENS, "depth_unit_scale_factor") if key in data}
    shared |= dict(zip(PINHOLE, median, strict=True)) | {"w": width, "h": height}
    reading = nerfstudio.read(Fields(shared, where))
    values = dict(reading.values)
    scale, stated = _depth_scale(data, where)
    source = f"the sequence's own {TRANSFORMS}"
    if any(key in entry for entry in own.values() for key in PINHOLE):
        source = f"median of the {len(own)} cameras of {source}"
    camera = make_camera(values | {"depth_scale": scale}, where, source)
    return replace(camera, depth_scale_assumed=not stated), {image: K - CORNER for image, K in pinholes.items()}


def _depth_scale(data: dict[str, Any], where: str) -> tuple[float, bool]:
    """Units of depth a metre, and whether the file states it. Raises InputError."""
    for key in ("depth_unit_scale_factor", "integer_depth_scale"):
        if key in data:
            metres = float(numbers([data[key]], 1, f"{where}: {key}")[0])
            if not 0 < metres <= 1:
                raise InputError(f"{where}: {key} is metres a unit of depth; {metres:g} cannot be, give --camera")
            return 1 / metres, True
    return 1000.0, False
