"""Lists of pairs of frames, as people write them: lines "i j"."""

from __future__ import annotations

from pathlib import Path

from miniloop_cli.datasets.paths import read_lines, shown
from miniloop_cli.errors import InputError


def read_pairs(path: Path, count: int) -> list[tuple[int, int]]:
    """The pairs of a file, in its order: lines "i j ..." or "i,j ..." of frame numbers 0..count-1; # starts a comment.

    Raises InputError naming the line that does not fit.
    """
    pairs = []
    for number, line in read_lines(path):
        fields = line.split("#")[0].replace(",", " ").split()
        where = f"{shown(path)}, line {number}"
        try:
            i, j = (int(field) for field in fields[:2])
        except ValueError:
            raise InputError(f"{where}: expected two frame numbers, found '{shown(line[:60])}'") from None
        if not (0 <= i < count and 0 <= j < count):
            raise InputError(f"{where}: frame numbers must be 0 to {count - 1}, found '{shown(line[:60])}'")
        pairs.append((i, j))
    return pairs
