"""Depth with a confidence map: readings of low confidence are removed.

ARKit gives three levels: 0 low, 1 medium, 2 high. Record3D, Stray Scanner and ARKitScenes store these numbers; Polycam
stores 0, 127 and 255. Polycam's documentation advises to filter out the low ones, and Stray Scanner's own viewer does
(github.com/PolyCam/polyform, README.md; github.com/kekeblom/StrayVisualizer, `--confidence` 1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageHeader, ImageSource
from miniloop_cli.scene.sequence import Frame, Note, NoteKind, Sequence
from miniloop_cli.typing import Bytes

MIN_CONFIDENCE, HIGHEST = 1, 2
WORDS = ("low", "medium", "high")


@dataclass(frozen=True)
class ConfidentDepth:
    """A depth image without the readings whose confidence is below `least` (1 medium, 2 high): they become 0."""

    depth: ImageSource
    confidence: ImageSource
    least: int = MIN_CONFIDENCE

    @property
    def name(self) -> str:
        return self.depth.name

    def header(self) -> ImageHeader:
        return self.depth.header()

    def read(self) -> NDArray[Any]:
        stored = self.depth.read()
        try:
            level = levels(self.confidence.read())
        except InputError as error:
            raise InputError(f"its confidence map: {error}") from None
        if level.shape != stored.shape[:2]:
            sizes = [f"{shape[1]} x {shape[0]}" for shape in (stored.shape, level.shape)]
            raise InputError(f"depth is {sizes[0]}, its confidence map {sizes[1]}")
        return np.where(level >= self.least, stored, stored.dtype.type(0))

    def fingerprint(self) -> str:
        return f"{self.depth.fingerprint()}/{self.confidence.fingerprint()}>={self.least}"


def levels(stored: NDArray[Any]) -> Bytes:
    """(h, w) levels 0 to 2 of a stored map. Raises InputError (reason only) for other images.

    A map with values above 2 is Polycam's: 0 is low, 255 high, and values between are medium.
    """
    if stored.ndim != 2 or stored.dtype != np.uint8:
        raise InputError("it must have one channel of 8 bits")
    if stored.max(initial=0) <= HIGHEST:
        return stored
    return (stored > 0).astype(np.uint8) + (stored == 255)


def with_confidence(
    frames: tuple[Frame, ...], maps: Mapping[ImageSource, ImageSource], where: str
) -> tuple[tuple[Frame, ...], tuple[Note, ...]]:
    """Frames with depth filtered by its confidence map (`maps`: by depth image), and a note; `where` names the maps."""
    if not maps:
        return frames, ()
    used = [replace(f, depth=ConfidentDepth(f.depth, maps[f.depth])) if f.depth in maps else f for f in frames]
    count = sum(isinstance(frame.depth, ConfidentDepth) for frame in used)
    if count == len(frames):
        return tuple(used), (_note(where, MIN_CONFIDENCE),)
    text = f"{where} has maps for {count} of {len(frames)} frames: all depth of the others is used"
    return tuple(used), (_note(where, MIN_CONFIDENCE), Note(NoteKind.DROPPED, text))


def with_min_confidence(sequence: Sequence, least: int) -> Sequence:
    """The sequence with another least confidence than the default: the setting `depth.min_confidence`."""
    notes = tuple(_note(note.where, least) if isinstance(note, ConfidenceNote) else note for note in sequence.notes)
    if notes == sequence.notes:
        return sequence
    frames = tuple(
        replace(frame, depth=replace(frame.depth, least=least)) if isinstance(frame.depth, ConfidentDepth) else frame
        for frame in sequence.frames
    )
    return replace(sequence, frames=frames, notes=notes)


@dataclass(frozen=True)
class ConfidenceNote(Note):
    """The note that depth is filtered by confidence maps; `where` names the maps."""

    where: str


def _note(where: str, least: int) -> ConfidenceNote:
    what = f"readings of {' and '.join(WORDS[:least])} confidence are ignored" if least else "all are used"
    text = f"{where} holds the confidence of each depth reading: {what} (depth.min_confidence = {least})"
    return ConfidenceNote(NoteKind.CONVERTED, text, where)
