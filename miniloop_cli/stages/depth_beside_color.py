"""Stage: whether depth lies where colour has it; else points get the depth of other things, and the scale is wrong."""

from __future__ import annotations

from miniloop_cli.datasets import read_scan
from miniloop_cli.errors import InputError
from miniloop_cli.inspection.registration import SAMPLE, registration_of, sampled
from miniloop_cli.scene.sequence import Note, NoteKind, Scan, Sequence
from miniloop_cli.stages.run import Run

FEW = 8  # frames: they show that depth is registered; that it is not, more frames must show


def depth_beside_color(sequence: Sequence, run: Run) -> tuple[Note, ...]:
    """A note if the edges of depth and of colour fit elsewhere than on each other, in a sample of the frames.

    That they fit nowhere is no note: then few edges of the graph are verified, or there is little to tell it by.
    """

    def read(number: int) -> Scan | None:
        try:
            return read_scan(sequence, number)
        except InputError:
            return None

    for most in (FEW, SAMPLE):
        numbers = sampled(sequence, most)
        scans = zip(numbers, run.workers.map(read, numbers, "comparing depth and colour", len(numbers)), strict=True)
        sample = {number: scan for number, scan in scans if scan}
        if len(sample) < FEW:
            return ()
        verdict = registration_of(sequence, sample, read_scan)
        if verdict.kind == "registered":
            return ()
    if verdict.kind == "foreign" or not verdict.sentence():
        return ()
    return (Note(NoteKind.CONTRADICTED, f"{verdict.sentence()} (miniloop inspect says what to do)"),)
