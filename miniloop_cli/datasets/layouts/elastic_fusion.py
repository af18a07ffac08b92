"""Logs of Kintinuous and ElasticFusion (.klg): frame after frame, depth in millimetres and colour.

A log begins with the number of frames (int32). Each has its time (int64), the bytes of depth and of colour (int32),
then these: depth as 640 x 480 uint16, by zlib unless it has that size; colour as JPEG, or RGB if it has that size.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.archive_path import ArchivePath
from miniloop_cli.datasets.block_source import FileBlock
from miniloop_cli.datasets.numbered import given_camera
from miniloop_cli.datasets.pairing import pair_rows
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.stamps import unit_of
from miniloop_cli.datasets.stream import Stream
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.scene.sequence import Note, NoteKind, Sequence, Trajectory, dropped_images

WIDTH, HEIGHT = 640, 480
PIXELS = WIDTH * HEIGHT
FRAME = struct.Struct("<qii")
SOURCE = "ElasticFusion's default (528 528 320 240): a log does not name the camera; --camera FILE is more accurate"
ORDER = "colour is read as RGB; some loggers swap red and blue (ElasticFusion's -f), which a log does not say"


class ElasticFusion:
    """ElasticFusion .klg: 640 x 480, depth in millimetres."""

    def matches(self, root: Path) -> bool:
        """By the suffix."""
        return not isinstance(root, ArchivePath) and root.suffix.lower() == ".klg" and root.is_file()

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in the log; nothing is decoded. Raises InputError."""
        try:
            stamps, color, depth, claimed, damage = _walk(root)
        except OSError as error:
            raise InputError(f"cannot read {shown(root)}: {error.strerror or error}") from error
        if not stamps:
            raise InputError(f"{shown(root)} has no whole frame{damage}; is it a log of ElasticFusion?")
        places = tuple(f"{shown(root.name)}: frame {k}" for k in range(len(stamps)))
        times, unit = np.array(stamps, float), unit_of(stamps)
        streams = [Stream(shown(root.name), sources, places, times=times, unit=unit) for sources in (color, depth)]
        pairs = pair_rows(root, *streams)
        camera = given_camera(root, camera_path, pairs.frames) or Camera(
            528.0, 528.0, 320.0, 240.0, WIDTH, HEIGHT, 1000.0, source=SOURCE, trust=Trust.GUESS
        )
        notes = [*pairs.notes, Note(NoteKind.ASSUMED, ORDER)]
        if len(stamps) != claimed or damage:
            text = f"{shown(root.name)} claims {claimed} frames and holds {len(stamps)} whole ones{damage}"
            notes.insert(0, dropped_images(text, claimed - len(stamps), claimed))
        return Sequence(root.stem, root, camera, pairs.frames, None, tuple(notes), pairs.available)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """None."""
        return None


def _walk(root: Path) -> tuple[list[int], tuple[FileBlock, ...], tuple[FileBlock, ...], int, str]:
    """Stamps, colour and depth of all whole frames, the number stated by the log, and a note on its end."""
    stamps: list[int] = []
    color: list[FileBlock] = []
    depth: list[FileBlock] = []
    damage = ""
    with root.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(0)
        start = file.read(4)
        claimed = struct.unpack("<i", start)[0] if len(start) == 4 else 0
        while (at := file.tell()) < end:
            head = file.read(FRAME.size)
            stamp, depth_bytes, color_bytes = FRAME.unpack(head) if len(head) == FRAME.size else (0, -1, -1)
            offset = at + FRAME.size
            if min(depth_bytes, color_bytes) < 0 or offset + depth_bytes + color_bytes > end:
                damage = f", then it is cut off or damaged at byte {at}"
                break
            name = f"{len(stamps)}"
            zipped = depth_bytes != 2 * PIXELS
            depth.append(FileBlock(root, f"depth/{name}", offset, depth_bytes, "u2", WIDTH, HEIGHT, zipped))
            kind = "rgb" if color_bytes == 3 * PIXELS else ""
            color.append(FileBlock(root, f"color/{name}", offset + depth_bytes, color_bytes, kind, WIDTH, HEIGHT))
            stamps.append(stamp)
            file.seek(offset + depth_bytes + color_bytes)
    return stamps, tuple(color), tuple(depth), claimed, damage
