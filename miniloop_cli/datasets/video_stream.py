"""The frames of a video as a stream of images that belong to numbered depth images, one to one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.stamps import SECONDS
from miniloop_cli.datasets.stream import Stream
from miniloop_cli.datasets.video import video_frames
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Note, NoteKind, dropped_images
from miniloop_cli.typing import Ints


def timed_video(path: Path, depth: Ints, times_s: Mapping[int, float], table: str) -> tuple[Stream, tuple[Note, ...]]:
    """The frames of a video with the numbers of the depth images (n,) that belong to them, and notes.

    `times_s`: the times of frames by number, from the file `table`; without them, the video's own clock is used.
    The k-th frame has the k-th number of that file if the counts are equal, else the k-th number of the depth images if
    those counts are equal. Raises InputError for a video that cannot be read, if neither count is equal, and if no
    frame has a time.
    """
    frames, own_s = video_frames(path)
    name, count, notes = shown(path.name), len(frames), []
    if count == len(times_s):
        numbers = np.array(sorted(times_s))
    elif count == len(depth):
        numbers = np.sort(depth)
    else:
        raise InputError(
            f"{name} has {count} frames, but there are {len(depth)} depth images and {len(times_s)} rows in {table}: "
            "it is not known which belong together; record or export it again"
        )
    if times_s:
        timed = np.array([number in times_s for number in numbers.tolist()])
        if not timed.any():
            raise InputError(f"{table} has {len(times_s)} rows, none for the frames of {name}")
        if not timed.all():
            text = f"{int((~timed).sum())} of {count} frames of {name} have no row in {table}: they are not used"
            notes.append(dropped_images(text, int((~timed).sum()), count))
        frames, numbers = tuple(frames[k] for k in np.flatnonzero(timed)), numbers[timed]
        times = np.array([times_s[number] for number in numbers.tolist()])
        if (np.diff(times) <= 0).any():
            raise InputError(f"{table}: the times do not increase from frame to frame")
    else:
        times = own_s - own_s[0]
        notes.append(
            Note(NoteKind.ASSUMED, f"no file gives the times of frames: those of {name} are used, from 0 s on")
        )
    places = tuple(f"{name}:{number}" for number in numbers.tolist())
    return Stream(name, frames, places, numbers, times, SECONDS), tuple(notes)
