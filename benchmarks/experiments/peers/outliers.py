"""Robust back-ends of others on the same edges; for comparison, each only where it is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from typing import Any

import networkx as nx
import numpy as np

from benchmarks.experiments.false_edges import Solution, Solve, TrueGraph
from benchmarks.experiments.peers.averaging import pycolmap_rotations
from benchmarks.experiments.view_graphs import ViewGraph
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import Edge, pairs_of
from miniloop_cli.typing import Bools, Floats

MEDIAN_CHI2 = 5.348  # of six degrees of freedom


def gtsam_gnc(graph: TrueGraph, edges: Sequence[Edge]) -> Solution:
    """Graduated non-convexity (Yang et al. 2020) with truncated least squares, gtsam's defaults."""
    import gtsam

    factors, start = _pose_graph(graph, edges, None)
    parameters = gtsam.GncLMParams()
    parameters.setKnownInliers([factors.size() - 1])  # the prior
    return _poses(graph, gtsam.GncLMOptimizer(factors, start, parameters).optimize())


def gtsam_cauchy(graph: TrueGraph, edges: Sequence[Edge]) -> Solution:
    """Levenberg-Marquardt with Cauchy's kernel."""
    import gtsam

    factors, start = _pose_graph(graph, edges, gtsam.noiseModel.mEstimator.Cauchy.Create(1.0))
    return _poses(graph, gtsam.LevenbergMarquardtOptimizer(factors, start).optimize())


def _pose_graph(graph: TrueGraph, edges: Sequence[Edge], kernel: Any) -> tuple[Any, Any]:
    """Factors of the edges, a prior last, and where to start.

    Information matrices are scaled to what the true edges' errors are: the peers need not guess the size of the noise.
    """
    import gtsam

    factors, scale = gtsam.NonlinearFactorGraph(), 1 / _excess(graph)
    for edge in edges:
        A = se3.adjoint(edge.T_j_i)  # ours is a step in scan j, gtsam's in scan i: xi_j = Ad(T_j_i) xi_i
        information = scale * A.T @ edge.information @ A
        model: Any = gtsam.noiseModel.Gaussian.Information(0.5 * (information + information.T))
        if kernel is not None:
            model = gtsam.noiseModel.Robust.Create(kernel, model)
        factors.add(gtsam.BetweenFactorPose3(edge.j, edge.i, gtsam.Pose3(edge.T_j_i), model))
    fixed = gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)
    factors.add(gtsam.PriorFactorPose3(int(graph.scans[0]), gtsam.Pose3(), fixed))
    return factors, _start(graph, edges)


def _start(graph: TrueGraph, edges: Sequence[Edge]) -> Any:
    """Poses along the spanning tree of most inliers."""
    import gtsam

    tree = nx.Graph()
    for edge in edges:
        tree.add_edge(edge.i, edge.j, weight=edge.inlier_count, T={edge.i: edge.T_j_i, edge.j: se3.inverse(edge.T_j_i)})
    tree = nx.maximum_spanning_tree(tree)
    root = int(graph.scans[0])
    T, values = {root: np.eye(4)}, gtsam.Values()
    for scan, new in nx.bfs_edges(tree, root):
        T[new] = T[scan] @ tree[scan][new]["T"][new]  # T[new]: from scan `new` into `scan`
    for scan, pose in T.items():
        values.insert(scan, gtsam.Pose3(pose))
    return values


def _excess(graph: TrueGraph) -> float:
    """How much larger the true edges' squared errors are than their information matrices say."""
    i, j = pairs_of(graph.edges).T
    E = se3.inverse(graph.T_world_cam[j]) @ graph.T_world_cam[i] @ se3.inverse(np.array([e.T_j_i for e in graph.edges]))
    xi = np.concatenate([se3.log_so3(E[:, :3, :3]), E[:, :3, 3]], axis=1)
    chi2 = np.einsum("ma,mab,mb->m", xi, np.array([e.information for e in graph.edges]), xi)
    return max(float(np.median(chi2)) / MEDIAN_CHI2, 1.0)


def _poses(graph: TrueGraph, values: Any) -> Solution:
    T, posed = _nothing(graph)
    for scan in graph.scans.tolist():
        if values.exists(scan):
            T[scan], posed[scan] = values.atPose3(scan).matrix(), True
    return T, posed, None


def _nothing(graph: TrueGraph) -> tuple[Floats, Bools]:
    count = len(graph.T_world_cam)
    return np.tile(np.eye(4), (count, 1, 1)), np.zeros(count, bool)


def pycolmap(graph: TrueGraph, edges: Sequence[Edge]) -> Solution:
    """COLMAP's global rotation averaging: rotations only."""
    T, posed = _nothing(graph)
    place = np.full(len(T), -1)
    place[graph.scans] = np.arange(len(graph.scans))
    pairs = place[pairs_of(edges)]
    compact = ViewGraph(
        graph.T_world_cam[graph.scans], pairs, np.array([e.T_j_i for e in edges]), np.zeros(len(edges), bool)
    )
    try:
        T[graph.scans, :3, :3], _ = pycolmap_rotations(compact)
    except MiniloopError:
        return T, posed, None
    T[:, :3, 3] = np.nan
    posed[graph.scans] = True
    return T, posed, None


def installed() -> dict[str, Solve]:
    """The peers that are installed."""
    found: dict[str, Solve] = {}
    if importlib.util.find_spec("gtsam"):
        found |= {"gtsam GNC": gtsam_gnc, "gtsam LM, Cauchy": gtsam_cauchy}
    if importlib.util.find_spec("pycolmap"):
        found["pycolmap"] = pycolmap
    return found
