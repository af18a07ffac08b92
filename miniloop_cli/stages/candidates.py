"""Candidate pairs of scans, and their comparison: by sketches of their features, or exactly."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Matching
from miniloop_cli.datasets.pairs import read_pairs
from miniloop_cli.errors import InputError
from miniloop_cli.feature_types import FEATURE_TYPES
from miniloop_cli.features.detect import compact, comparable
from miniloop_cli.features.lsh_match import Sketched, match_sketched, sketch
from miniloop_cli.features.match import match
from miniloop_cli.features.retrieval import image_vectors, similar_pairs
from miniloop_cli.ransac.distance_consistency import consistent
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.typing import Ints, Pair

Descriptors = Sequence[NDArray]
MAX_CHECKED_MATCHES = 150  # matches that need no further check
AGREEING_M = 0.04  # tighter than the estimator's threshold, so that a few chance matches do not pass for an overlap


def listed_pairs(count: int, source: str, settings: Matching) -> list[Pair]:
    """The pairs by a source: "auto" and "exhaustive" every pair, "sequential" near frames, or a file of pairs.

    Raises InputError naming the malformed line of a file.
    """
    if source in ("auto", "exhaustive"):
        return list(combinations(range(count), 2))
    if source == "sequential":
        return neighbours(count, settings.sequential_window)
    try:
        return sorted({(min(i, j), max(i, j)) for i, j in read_pairs(Path(source), count) if i != j})
    except InputError as error:
        raise InputError(f"{error} (--pairs is auto, exhaustive, sequential or a file of lines 'i j')") from error


def neighbours(count: int, most: int) -> list[Pair]:
    """Each frame with the `most` frames after it."""
    return [(i, j) for i in range(count) for j in range(i + 1, min(i + 1 + most, count))]


def retrieved_pairs(compact: Descriptors, settings: Matching, rng: np.random.Generator) -> list[Pair]:
    """Pairs of frames that are near in time or look similar: the candidates of long recordings."""
    alike = similar_pairs(image_vectors(compact, rng), settings.retrieval_k)
    return sorted({*neighbours(len(compact), settings.sequential_window), *alike})


def comparer(scans: ScanSet, matching: Matching, workers: Workers) -> Callable[[Sequence[Pair]], Matches]:
    """A function that compares pairs: by sketches with `matching.pairs: auto`, else exactly.

    Descriptors are prepared when it is first called.
    """
    kind = scans.feature_type
    strongest = [scan.descriptors[: min(scan.with_depth, matching.count)] for scan in scans.features]

    @cache
    def sketches() -> list[Sketched]:
        return sketch([compact(found, kind)[0] for found in strongest])

    @cache
    def exact() -> Descriptors:
        return [comparable(found, kind) for found in strongest]

    def compare(pairs: Sequence[Pair]) -> Matches:
        if matching.pairs == "auto":
            binary = FEATURE_TYPES[kind].descriptors.binary
            ratio2 = matching.ratio ** (1 if binary else 2)  # of counts of bits, or of squared distances
            return match_quickly(sketches(), scans.points, pairs, matching, ratio2, workers)
        return match_fully(exact(), pairs, matching, workers)

    return compare


def match_quickly(
    features: Sequence[Sketched],
    points: Sequence[ScanPoints],
    pairs: Sequence[Pair],
    settings: Matching,
    ratio2: float,
    workers: Workers,
) -> Matches:
    """Matches (k, 2) of the pairs by sketches; a pair with too few matches of consistent distances is left out.

    features: the features with depth of each scan, strongest first; ratio2: bound of the ratio test, see
    `match_sketched`.
    """

    shared = features, points, settings, ratio2
    return enough(pairs, workers.spread(_match_quickly, shared, pairs, "matching pairs", len(pairs)), settings)


def _match_quickly(shared: tuple[Sequence[Sketched], Sequence[ScanPoints], Matching, float], pair: Pair) -> Ints | None:
    features, points, settings, ratio2 = shared
    rows = match_sketched(features[pair[0]], features[pair[1]], settings.count, ratio2)
    if settings.min_matches <= len(rows) <= MAX_CHECKED_MATCHES and settings.min_distance_consistent > 1:
        agreeing = consistent(points, pair, rows, AGREEING_M, settings.min_distance_consistent - 1).sum()
        return rows if agreeing >= settings.min_distance_consistent else None
    return rows


def match_fully(descriptors: Descriptors, pairs: Sequence[Pair], settings: Matching, workers: Workers) -> Matches:
    """Matches of every pair over its `count` strongest features."""

    shared = descriptors, settings
    return enough(pairs, workers.spread(_match_fully, shared, pairs, "matching pairs", len(pairs)), settings)


def _match_fully(shared: tuple[Descriptors, Matching], pair: Pair) -> Ints:
    descriptors, settings = shared
    a, b = (descriptors[k][: settings.count] for k in pair)
    return match(a, b, settings.ratio)


def enough(pairs: Sequence[Pair], found: Iterable[Ints | None], settings: Matching) -> Matches:
    """The pairs with at least `min_matches` matches: the edges of the overlap graph (paper, section 4)."""
    return {
        pair: rows
        for pair, rows in zip(pairs, found, strict=True)
        if rows is not None and len(rows) >= settings.min_matches
    }
