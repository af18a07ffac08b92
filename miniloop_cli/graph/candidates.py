"""Which pairs of scans are compared, and how closely: a cheap look at all, the full comparison where it decides.

The look matches the few hundred strongest features of a pair. A pair whose look holds enough distance-consistent
matches is an edge as it is; one that holds hardly any is no edge; only what lies between is matched in full.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Matching
from miniloop_cli.errors import InputError
from miniloop_cli.features.match import match
from miniloop_cli.graph.overlap import Matches, Pair, ScanPoints, consistent
from miniloop_cli.graph.retrieval import image_vectors, similar_pairs
from miniloop_cli.parallel import Workers

Descriptors = Sequence[NDArray]
MANY = 150  # matches beyond which a look needs no further check
LOOK_THRESHOLD_M = 0.04  # tighter than the estimator's: a few chance matches must not pass for an overlap


def listed_pairs(count: int, source: str, settings: Matching) -> list[Pair]:
    """The pairs that a source names: "auto" and "exhaustive" every pair, "sequential" near frames, or a file.

    A file has lines "i j" of frame numbers; # starts a comment. Raises InputError naming the line that does not fit.
    """
    if source in ("auto", "exhaustive"):
        return list(combinations(range(count), 2))
    if source == "sequential":
        return neighbours(count, settings.neighbours)
    path = Path(source)
    if not path.is_file():
        raise InputError(f"--pairs {source}: give auto, exhaustive, sequential or a file of lines 'i j'")
    found = set()
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        fields = line.split("#")[0].replace(",", " ").split()
        if not fields:
            continue
        if len(fields) < 2 or not all(field.isdecimal() and int(field) < count for field in fields[:2]):
            raise InputError(f"{path}, line {number}: expected two frame numbers from 0 to {count - 1}, got '{line}'")
        i, j = sorted(int(field) for field in fields[:2])
        if i != j:
            found.add((i, j))
    return sorted(found)


def neighbours(count: int, most: int) -> list[Pair]:
    """Each frame with the `most` frames after it."""
    return [(i, j) for i in range(count) for j in range(i + 1, min(i + 1 + most, count))]


def retrieved_pairs(compact: Descriptors, settings: Matching, rng: np.random.Generator) -> list[Pair]:
    """Frames that are near in time or look alike: the candidates of long recordings."""
    alike = similar_pairs(image_vectors(compact, rng), settings.similar)
    return sorted({*neighbours(len(compact), settings.neighbours), *alike})


def match_progressively(
    descriptors: Descriptors, points: Sequence[ScanPoints], pairs: Sequence[Pair], settings: Matching, workers: Workers
) -> Matches:
    """Matches of the pairs by a look first; pairs that the look rules out are left out.

    descriptors: comparable descriptors of each scan's features with depth, strongest first.
    """

    def look_then_match(pair: Pair) -> NDArray[np.int64] | None:
        a, b = (descriptors[k][: settings.look_count] for k in pair)
        rows = match(a, b, settings.ratio)
        agreeing = len(rows) if len(rows) > MANY else consistent(points, pair, rows, LOOK_THRESHOLD_M, 3).sum()
        if agreeing < settings.look_min:
            return None
        if agreeing < settings.look_enough:
            a, b = (descriptors[k][: settings.count] for k in pair)
            rows = match(a, b, settings.ratio)
        return rows

    return enough(pairs, workers.map(look_then_match, pairs, "matching pairs", len(pairs)), settings)


def match_fully(descriptors: Descriptors, pairs: Sequence[Pair], settings: Matching, workers: Workers) -> Matches:
    """Matches of every pair over its `count` strongest features."""

    def match_pair(pair: Pair) -> NDArray[np.int64]:
        a, b = (descriptors[k][: settings.count] for k in pair)
        return match(a, b, settings.ratio)

    return enough(pairs, workers.map(match_pair, pairs, "matching pairs", len(pairs)), settings)


def enough(pairs: Sequence[Pair], found: Iterable[NDArray[np.int64] | None], settings: Matching) -> Matches:
    """The pairs with at least `min_matches` matches: the edges of the overlap graph (paper, section 4)."""
    return {
        pair: rows
        for pair, rows in zip(pairs, found, strict=True)
        if rows is not None and len(rows) >= settings.min_matches
    }
