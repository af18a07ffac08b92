"""Who sees the same place: feature matches of pairs of scans, lifted to 3D with their noise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Matching
from miniloop_cli.features.detect import comparable
from miniloop_cli.features.lift import ScanFeatures
from miniloop_cli.features.match import match
from miniloop_cli.parallel import Workers
from miniloop_cli.ransac.estimate import EdgeMatches
from miniloop_cli.scans.camera import Camera

Pair = tuple[int, int]
Matches = dict[Pair, NDArray[np.int64]]


@dataclass(frozen=True)
class ScanPoints:
    """The features with depth of one scan in space: points (n, 3) m, covariances (n, 3, 3) m^2, camera frame."""

    points_m: NDArray[np.float64]
    covariances_m2: NDArray[np.float64]


def scan_points(features: ScanFeatures, camera: Camera) -> ScanPoints:
    """Back-project the features that have a depth (the first rows)."""
    count = features.with_depth
    points = camera.backproject(features.px_ideal[:count], features.z_m[:count])
    return ScanPoints(points, camera.point_covariance(points))


def match_pairs(
    features: Sequence[ScanFeatures], pairs: Iterable[Pair], kind: str, settings: Matching, workers: Workers
) -> Matches:
    """Matches (m, 2) of the features with depth of each pair of scans, where there are at least `min_matches`."""
    pairs = list(pairs)
    strongest = [comparable(scan.descriptors[: min(scan.with_depth, settings.count)], kind) for scan in features]

    def match_pair(pair: Pair) -> NDArray[np.int64]:
        return match(strongest[pair[0]], strongest[pair[1]], settings.ratio)

    found = workers.map(match_pair, pairs, "matching pairs", len(pairs))
    return {pair: rows for pair, rows in zip(pairs, found, strict=True) if len(rows) >= settings.min_matches}


def overlap_graph(count: int, matches: Mapping[Pair, NDArray[np.int64]]) -> nx.Graph:
    """Nodes 0..count-1, an edge a pair of scans with its number of `matches` (paper, section 4)."""
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    graph.add_edges_from((i, j, {"matches": len(rows)}) for (i, j), rows in matches.items())
    return graph


def edge_matches(points: Sequence[ScanPoints], pair: Pair, rows: NDArray[np.int64]) -> EdgeMatches:
    """The matches of a pair in space, from scan pair[0] to scan pair[1]."""
    a, b = points[pair[0]], points[pair[1]]
    return EdgeMatches(
        a.points_m[rows[:, 0]], b.points_m[rows[:, 1]], a.covariances_m2[rows[:, 0]], b.covariances_m2[rows[:, 1]]
    )
