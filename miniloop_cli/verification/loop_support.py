"""Unverified edges, solved again in loops over verified ones.

Two verified edges i-k and k-j predict the pose of scan j relative to scan i without the matches of the edge i-j.
Predictions over different scans k share no match, so if most of them agree they are evidence, and the matches of the
edge itself only have to confirm them. The pose of the edge comes from the joint estimate of one such loop.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.graph.edge_pool import Cycle
from miniloop_cli.typing import Bools, Floats, Pair

if TYPE_CHECKING:
    import networkx as nx

LOOPS = 6  # loops over verified edges that are used, the strongest first
AGREE_DEG, AGREE_M = 5.0, 0.10


@dataclass(frozen=True)
class Prediction:
    """The loop i-k-j that fits best with the others; how many others there are, and how many of them agree with it."""

    cycle: Cycle
    T_j_i: Floats
    others: int
    agree: int

    @property
    def credible(self) -> bool:
        """Whether at least one other loop, and at least half of them, agree."""
        return self.agree >= 1 and 2 * self.agree >= self.others


def pose_graph(edges: Iterable[tuple[int, int, Floats, int]]) -> nx.Graph:
    """Verified edges (i, j, T_j_i, inliers), i < j."""
    import networkx as nx

    graph = nx.Graph()
    graph.add_edges_from((i, j, {"T": T, "inliers": inliers}) for i, j, T, inliers in edges)
    return graph


def predict(graph: nx.Graph, pair: Pair) -> Prediction | None:
    """The pose of scan j relative to scan i by verified edges; None if no scan has verified edges to both."""
    i, j = pair
    if i not in graph or j not in graph:
        return None
    strength = {k: min(graph[i][k]["inliers"], graph[k][j]["inliers"]) for k in graph[i] if k in graph[j]}
    between = sorted(strength, key=lambda k: (-strength[k], k))[:LOOPS]
    if not between:
        return None
    T = np.array([_directed(graph, k, j) @ _directed(graph, i, k) for k in between])
    alike = agree(T[:, None], T).sum(axis=1) - 1
    best = int(alike.argmax())
    return Prediction((i, between[best], j), T[best], len(between) - 1, int(alike[best]))


def agree(T_a: Floats, T_b: Floats) -> Bools:
    """Whether relative poses T_a, T_b (..., 4, 4) differ by less than AGREE_DEG and AGREE_M."""
    E = se3.inverse(T_a) @ T_b
    return (se3.rotation_angle_deg(E[..., :3, :3]) < AGREE_DEG) & (np.linalg.norm(E[..., :3, 3], axis=-1) < AGREE_M)


def _directed(graph: nx.Graph, a: int, b: int) -> Floats:
    """Pose that maps points of scan a into scan b."""
    T = graph[a][b]["T"]
    return T if a < b else se3.inverse(T)
