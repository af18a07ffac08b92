"""Who sees the same place: feature matches of pairs of scans, lifted to 3D with their noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.features.lift import ScanFeatures
from miniloop_cli.ransac.consistency import consistent_core
from miniloop_cli.ransac.estimate import EdgeMatches
from miniloop_cli.scans.camera import Camera
from miniloop_cli.typing import Bools, Floats, Ints, Pair

if TYPE_CHECKING:
    import networkx as nx

Matches = dict[Pair, Ints]


@dataclass(frozen=True)
class ScanPoints:
    """The features with depth of one scan in space: points (n, 3) m, covariances (n, 3, 3) m^2, camera frame."""

    points_m: Floats
    covariances_m2: Floats

    @cached_property
    def sigmas_m(self) -> Floats:
        """Root mean square standard deviation (n,) over the three axes."""
        return np.sqrt(np.trace(self.covariances_m2, axis1=1, axis2=2) / 3)


def scan_points(features: ScanFeatures, camera: Camera) -> ScanPoints:
    """Back-project the features that have a depth (the first rows)."""
    count = features.with_depth
    points = camera.backproject(features.px_ideal[:count], features.z_m[:count])
    return ScanPoints(points, camera.point_covariance(points))


def overlap_graph(count: int, matches: Mapping[Pair, Ints]) -> nx.Graph:
    """Nodes 0..count-1, an edge a pair of scans with its number of `matches` (paper, section 4)."""
    import networkx as nx

    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    graph.add_edges_from((i, j, {"matches": len(rows)}) for (i, j), rows in matches.items())
    return graph


def edge_matches(points: Sequence[ScanPoints], pair: Pair, rows: Ints) -> EdgeMatches:
    """The matches of a pair in space, from scan pair[0] to scan pair[1]."""
    a, b = points[pair[0]], points[pair[1]]
    return EdgeMatches(
        a.points_m[rows[:, 0]], b.points_m[rows[:, 1]], a.covariances_m2[rows[:, 0]], b.covariances_m2[rows[:, 1]]
    )


def consistent(points: Sequence[ScanPoints], pair: Pair, rows: Ints, threshold_m: float, least: int) -> Bools:
    """Matches (m,) bool that agree in their distances with at least `least` others (see ransac.consistency).

    Two matches agree if their distances differ by less than `threshold_m` and three sigma of both.
    """
    a, b = points[pair[0]], points[pair[1]]
    tolerance = 0.5 * threshold_m + 1.5 * np.hypot(a.sigmas_m[rows[:, 0]], b.sigmas_m[rows[:, 1]])
    P, Q = (np.ascontiguousarray(side.points_m[rows[:, k]].T) for k, side in enumerate((a, b)))
    return consistent_core(P, Q, tolerance, least)
