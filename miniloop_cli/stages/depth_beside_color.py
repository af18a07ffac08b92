"""Stage: whether depth is registered to colour. If not, features get the depth of what is beside them."""

from __future__ import annotations

from miniloop_cli.datasets import read_scan
from miniloop_cli.errors import InputError
from miniloop_cli.inspection.registration import SAMPLE, as_they_lie, edges_of, registration_of, sampled
from miniloop_cli.scene.sequence import Note, NoteKind, Scan, Sequence
from miniloop_cli.stages.run import Run

FEW = 8  # frames: they show that depth is registered; that it is not, more frames must show


def depth_beside_color(sequence: Sequence, run: Run) -> tuple[Note, ...]:
    """A note if outlines in depth fit those in colour only after a shift, at another scale, or in other frames.

    Outlines that fit nowhere give no note: the scene may have too few of them, and where depth belongs to other images,
    no pair of frames is verified.
    """

    def read(number: int) -> Scan | None:
        try:
            return read_scan(sequence, number)
        except InputError:
            return None

    def sample(most: int) -> dict[int, Scan]:
        numbers = sampled(sequence, most)
        scans = run.workers.map(read, numbers, "comparing depth and colour", len(numbers))
        return {number: scan for number, scan in zip(numbers, scans, strict=True) if scan}

    few = sample(FEW)
    if len(few) < FEW or as_they_lie(*edges_of(few)).kind == "registered":
        return ()
    verdict = registration_of(sequence, sample(SAMPLE), read_scan)
    if verdict.kind == "foreign" or not verdict.sentence():
        return ()
    return (Note(NoteKind.CONTRADICTED, f"{verdict.sentence()} (miniloop inspect says what to do)"),)
