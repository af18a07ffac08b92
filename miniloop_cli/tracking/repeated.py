"""Repeated images: a recorder stored an image again instead of a new one, so its stamp is wrong."""

from __future__ import annotations

from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.scene.tracked import Repeat, Tracked
from miniloop_cli.typing import Bools

MANY = 0.05  # of all frames: with more, the stamps of the recording are not reliable


def notes_on_repeats(tracked: Tracked) -> list[Note]:
    """Notes on frames whose images repeat those before them."""
    color, depth, notes = tracked.repeat == Repeat.COLOR, tracked.repeat == Repeat.DEPTH, []
    if color.any():
        text = f"{_which(color)} the colour image before: the poses are those of that image, not of the time stamps"
        notes.append(Note(NoteKind.CONTRADICTED if color.mean() > MANY else NoteKind.ASSUMED, text))
    if depth.any():
        notes.append(Note(NoteKind.DROPPED, f"{_which(depth)} the depth image before: that depth is not used"))
    return notes


def _which(again: Bools) -> str:
    """How many frames, and the first of them."""
    return f"{again.sum()} of {len(again)} frames (the first: {again.argmax()}) repeat"
