"""EXIF orientation of colour images; depth images have none."""

from __future__ import annotations

from dataclasses import replace

from miniloop_cli.datasets.images import MAX_IMAGE_BYTES, ImageFile, read_orientation
from miniloop_cli.datasets.paths import open_file
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Frame, Note, NoteKind, Sequence

LOOKED_AT = 5
SAME_ASPECT = 0.02


def with_upright_colour(sequence: Sequence) -> Sequence:
    """The sequence with colour rotated by its EXIF orientation if depth has that orientation, with notes.

    Half a turn and mirroring keep the shape, so the orientation of depth is unknown, and colour stays as stored.
    """
    found = next((found for frame in sequence.frames[:LOOKED_AT] if (found := _shapes(frame))), None)
    if found is None:
        return sequence
    orientation, stored, depth = found
    if orientation >= 5 and _alike(stored[::-1], depth) and not _alike(stored, depth):
        note = Note(NoteKind.CONVERTED, "colour is rotated by its EXIF orientation, to match the depth images")
        return replace(sequence.with_frames(_turned), notes=(*sequence.notes, note))
    text = f"the EXIF orientation ({orientation}) is not applied to colour: depth has none, and both are used as stored"
    return replace(sequence, notes=(*sequence.notes, Note(NoteKind.ASSUMED, text)))


def _turned(frame: Frame) -> Frame:
    return replace(frame, color=replace(frame.color, upright=True)) if isinstance(frame.color, ImageFile) else frame


def _shapes(frame: Frame) -> tuple[int, tuple[int, int], tuple[int, int]] | None:
    """Orientation other than "as stored", and (width, height) of stored colour and of depth; None if unknown."""
    if not isinstance(frame.color, ImageFile):
        return None
    try:
        with open_file(frame.color.path, MAX_IMAGE_BYTES) as file:
            orientation = read_orientation(file)
        if orientation == 1:
            return None
        color, depth = frame.color.header(), frame.depth.header()
    except InputError:
        return None
    return orientation, (color.width, color.height), (depth.width, depth.height)


def _alike(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    return abs(one[0] * other[1] / max(one[1] * other[0], 1) - 1) < SAME_ASPECT
