"""The images of a topic as a stream, by the stamps in their headers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets.bags.bag import Bag, Topic
from miniloop_cli.datasets.bags.source import BagImage
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.stream import Stream
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Note, NoteKind, dropped_images


def image_stream(path: Path, topic: Topic, use_received: bool = False) -> Stream:
    """All images of a topic whose head can be read, in the order of reception.

    `use_received`: use the times of reception, which are late and of another clock. Raises InputError if no image can
    be read.
    """
    sources, stamps, damaged, unstamped, reason = [], [], 0, 0, ""
    for place in topic.places:
        source = BagImage(path, topic.name, topic.type, topic.wire, place)
        try:
            stamp_ns = source.head().stamp_ns
        except InputError as error:
            damaged, reason = damaged + 1, reason or str(error)
            continue
        if not use_received and stamp_ns == 0:
            unstamped += 1
            continue
        sources.append(source)
        stamps.append(place.time_ns if use_received else stamp_ns)
    notes = []
    if damaged:
        text = f"{damaged} of {len(topic.places)} messages of {topic.name} cannot be read, the first: {shown(reason)}"
        notes.append(dropped_images(text, damaged, len(topic.places)))
    if unstamped and sources:
        text = f"{unstamped} of {len(topic.places)} images of {topic.name} have no stamp and are not used"
        notes.append(dropped_images(text, unstamped, len(topic.places)))
    if not sources and not unstamped:
        raise InputError(
            f"{shown(path)}: none of the {len(topic.places)} messages of {topic.name} can be read: {reason}"
        )
    times = np.array(stamps, np.int64) / 1e9
    places = tuple(f"{topic.name} at {source.place.time_ns / 1e9:.6f} s" for source in sources)
    return Stream(topic.name, tuple(sources), places, times=times, notes=tuple(notes))


def stamped_streams(path: Path, color: Topic, depth: Topic) -> tuple[Stream, Stream]:
    """Both streams by the stamps of their images; if one has none, by the times of reception, with a note."""
    streams = image_stream(path, color), image_stream(path, depth)
    if all(stream.sources for stream in streams):
        return streams
    color_stream, depth_stream = image_stream(path, color, True), image_stream(path, depth, True)
    which = color.name if not streams[0].sources else depth.name
    text = f"the images of {which} have no stamps: the times of their reception are used, which are late and irregular"
    notes = (*color_stream.notes, Note(NoteKind.ASSUMED, text))
    return Stream(**{**vars(color_stream), "notes": notes}), depth_stream


def damage_notes(path: Path, bag: Bag) -> tuple[Note, ...]:
    """Notes on missing parts of the bag."""
    damage, name = bag.damage, shown(path.name)
    if damage.cut_at is not None:
        text = f"{name} was cut off or is damaged at byte {damage.cut_at}: the rest is not read"
        return (Note(NoteKind.DROPPED, text),)
    if damage.unfinished:
        text = f"{name} was not closed by its recorder: its last messages may be missing"
        return (Note(NoteKind.DROPPED, text),)
    return ()
