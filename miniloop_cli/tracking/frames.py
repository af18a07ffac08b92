"""The frames of a recording in order, decoded; frames without content and repeated frames are recognised."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from miniloop_cli.datasets import read_scan
from miniloop_cli.datasets.thumbnails import thumbnail
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Scan, Sequence
from miniloop_cli.scene.tracked import Repeat, TrackedPart, TrackStatus
from miniloop_cli.typing import Bytes

LEAST_CONTRAST = 2.0  # standard deviation of the gray values; below, an image is blank


class TrackFrame(NamedTuple):
    """A decoded frame, its brightness (h, w), and whether there is any depth in it."""

    number: int
    scan: Scan
    gray: Bytes
    stamp_s: float
    has_depth: bool


def readable_frames(sequence: Sequence, numbers: range, part: TrackedPart) -> Iterator[TrackFrame]:
    """The frames that are not blank, in this order; the others are recorded in the part."""
    for number in numbers:
        try:
            scan = read_scan(sequence, number)
        except InputError as error:
            part.set(number, TrackStatus.UNREADABLE, str(error))
            continue
        if number not in part.thumbnails:
            part.thumbnails[number] = thumbnail(scan.color)
        has_depth = bool((scan.depth_m > 0).any())
        frame = TrackFrame(number, scan, _gray(scan), sequence.frames[number].timestamp_s, has_depth)
        if float(frame.gray.std()) < LEAST_CONTRAST:
            said = f"the image has no contrast (mean grey level {frame.gray.mean():.0f} of 255)"
            part.set(number, TrackStatus.BLANK, said)
            continue
        yield frame


def told_apart(frames: Iterator[TrackFrame], part: TrackedPart) -> Iterator[TrackFrame]:
    """The frames; repeated images are recorded in the part, and repeated depth is removed."""
    before: TrackFrame | None = None
    for frame in frames:
        kept = frame
        if before and np.array_equal(frame.gray, before.gray):
            part.repeat[frame.number - part.first] = Repeat.COLOR
        elif before and frame.has_depth and np.array_equal(frame.scan.depth_m, before.scan.depth_m):
            part.repeat[frame.number - part.first] = Repeat.DEPTH
            nothing = np.zeros_like(frame.scan.depth_m)
            kept = frame._replace(scan=replace(frame.scan, depth_m=nothing), has_depth=False)
        before = frame
        yield kept


def may_be_keyframe(sequence: Sequence, number: int) -> bool:
    """Whether a frame can be read, is not blank, and has depth that does not repeat that of the frame before."""
    part = TrackedPart.of(number - 1, number)
    frames = list(told_apart(readable_frames(sequence, range(max(number - 1, 0), number + 1), part), part))
    return bool(frames) and frames[-1].number == number and frames[-1].has_depth


def _gray(scan: Scan) -> Bytes:
    import cv2

    return np.asarray(cv2.cvtColor(scan.color, cv2.COLOR_RGB2GRAY), np.uint8)
