"""Record3D's own files (.r3d): a ZIP of `metadata` (JSON) and rgbd/N.jpg, N.depth, N.conf; also unpacked.

Depth is float32 metres and confidence 0 to 2 by LZFSE, of the size `dw` x `dh`; without that, 192 x 256 of a LiDAR or
480 x 640 of a FaceID camera, as Record3D stores them upright (github.com/nerfstudio-project/viser,
extras/_record3d.py; github.com/BernieZhu/RGBD-Video-iPhone12Pro).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.archive_path import inside
from miniloop_cli.datasets.confidence import with_confidence
from miniloop_cli.datasets.lzfse import LzfseImage, sizes
from miniloop_cli.datasets.numbered import given_camera, read_json
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import read_bytes, shown
from miniloop_cli.datasets.record3d import cameras, clock, poses_of, timed, too_few_times
from miniloop_cli.datasets.stream import Stream, named_stream
from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import DepthFormat, Note, NoteKind, Sequence, Trajectory

METRES = 1.0  # units of depth a metre
UPRIGHT = {256 * 192: (192, 256), 640 * 480: (480, 640)}  # width and height by the number of pixels


class Record3DFile:
    """Record3D's .r3d file (needs pyliblzfse), or the folder that it unpacks to: rgbd/ and metadata."""

    def matches(self, root: Path) -> bool:
        """By the suffix of a file, or the names in a folder."""
        if root.suffix.lower() == ".r3d" and root.is_file():
            return True
        return (root / "rgbd").is_dir() and (root / "metadata").is_file()

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`, which is not unpacked. Raises InputError."""
        folder = _folder(root)
        data, where = read_json(folder / "metadata"), shown(folder / "metadata")
        color, depth = named_stream(folder, "rgbd", (".jpg",)), named_stream(folder, "rgbd", (".depth",))
        depth = _images(depth, _size(data, depth), "<f4")
        rate_hz, times_s = clock(data, where)
        notes: tuple[Note, ...] = ()
        maps = _confidence(folder, depth)
        if times_s is not None:
            color, depth, notes = timed(color, times_s), timed(depth, times_s), too_few_times(color, times_s)
        found = pair(root, _quiet(color), _quiet(depth), rate_hz=rate_hz)
        frames = found.frames
        camera = given_camera(folder, camera_path, frames, METRES)
        if camera is None:
            camera, own = cameras(data, where, color, "metadata", METRES)
            frames, said = with_own_cameras(frames, own, camera)
            notes = (*notes, *said)
        frames, trusted = with_confidence(frames, maps, "rgbd/*.conf")
        form, notes = DepthFormat(floating=True, resample=True), (*found.notes, *notes, *trusted)
        name = root.stem if root.is_file() else root.name
        return Sequence(
            name, root, replace(camera, depth_scale=METRES), frames, folder / "metadata", notes, found.available, form
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's poses: a reference, not the truth."""
        path = sequence.ground_truth_path
        return None if path is None else poses_of(read_json(path), shown(path))


def _folder(root: Path) -> Path:
    folder = inside(root) if root.is_file() else root
    if not (folder / "metadata").is_file() or not (folder / "rgbd").is_dir():
        raise InputError(
            f"{shown(root)} holds no metadata and rgbd/: it is not a recording of Record3D, or it is incomplete"
        )
    return folder


def _size(data: dict[str, Any], depth: Stream) -> tuple[int, int]:
    """Width and height (px) of the depth images: stated, or from the number of values of the first one."""
    stated = data.get("dw"), data.get("dh")
    if all(isinstance(side, int) and 1 <= side <= 1 << 14 for side in stated):
        return int(stated[0] or 0), int(stated[1] or 0)
    first = depth.sources[0]
    count = sizes(read_bytes(_path(first)))[0] // 4
    if count not in UPRIGHT:
        raise InputError(f"{shown(first.name)}: depth of {count} values; the metadata do not state its size (dw, dh)")
    width, height = UPRIGHT[count]
    upright = not all(isinstance(data.get(k), int | float) for k in ("w", "h")) or data["h"] >= data["w"]
    return (width, height) if upright else (height, width)


def _path(source: ImageSource) -> Path:
    path = getattr(source, "path", None)
    assert isinstance(path, Path)
    return path


def _quiet(stream: Stream) -> Stream:
    """The stream without the note on files of other suffixes, as another stream uses them."""
    return replace(stream, notes=tuple(note for note in stream.notes if note.kind != NoteKind.UNUSED))


def _images(stream: Stream, size: tuple[int, int], dtype: str) -> Stream:
    """A stream of files as the images in them."""
    return replace(stream, sources=tuple(LzfseImage(_path(source), *size, dtype) for source in stream.sources))


def _confidence(folder: Path, depth: Stream) -> dict[ImageSource, ImageSource]:
    """The maps by the depth images that they belong to."""
    maps: dict[ImageSource, ImageSource] = {}
    for image in depth.sources:
        assert isinstance(image, LzfseImage)
        path = image.path.with_suffix(".conf")
        if path.is_file():
            maps[image] = replace(image, path=path, dtype=np.dtype(np.uint8).str)
    return maps
