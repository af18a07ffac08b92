"""Robust back-ends of others on the same edges; for comparison, each only where it is installed."""

from __future__ import annotations

import importlib.util
from typing import Any

import networkx as nx
import numpy as np

from benchmarks.experiments.false_edges import Solution, Solve, TrueGraph
from benchmarks.experiments.peers.averaging import pycolmap_rotations
from benchmarks.experiments.view_graphs import ViewGraph
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.typing import Bools, Floats

MEDIAN_CHI2 = 5.348  # of six degrees of freedom


def gtsam_gnc(graph: TrueGraph, edges: EdgeTable) -> Solution:
    """Graduated non-convexity (Yang et al. 2020) with truncated least squares, gtsam's defaults."""
    import gtsam

    factors, start = _pose_graph(graph, edges, None)
    parameters = gtsam.GncLMParams()
    parameters.setKnownInliers([factors.size() - 1])  # the prior
    return _poses(graph, gtsam.GncLMOptimizer(factors, start, parameters).optimize())


def gtsam_cauchy(graph: TrueGraph, edges: EdgeTable) -> Solution:
    """Levenberg-Marquardt with Cauchy's kernel."""
    import gtsam

    factors, start = _pose_graph(graph, edges, gtsam.noiseModel.mEstimator.Cauchy.Create(1.0))
    return _poses(graph, gtsam.LevenbergMarquardtOptimizer(factors, start).optimize())


def _pose_graph(graph: TrueGraph, edges: EdgeTable, kernel: Any) -> tuple[Any, Any]:
    """Factors of the edges, a prior last, and where to start.

    Information matrices are scaled to what the true edges' errors are: the peers need not guess the size of the noise.
    """
    import gtsam

    factors, scale = gtsam.NonlinearFactorGraph(), 1 / _excess(graph)
    for (i, j), T_j_i, ours in zip(edges.pairs.tolist(), edges.T_j_i, edges.information, strict=True):
        A = se3.adjoint(T_j_i)  # ours is a step in scan j, gtsam's in scan i: xi_j = Ad(T_j_i) xi_i
        information = scale * A.T @ ours @ A
        model: Any = gtsam.noiseModel.Gaussian.Information(0.5 * (information + information.T))
        if kernel is not None:
            model = gtsam.noiseModel.Robust.Create(kernel, model)
        factors.add(gtsam.BetweenFactorPose3(j, i, gtsam.Pose3(T_j_i), model))
    fixed = gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)
    factors.add(gtsam.PriorFactorPose3(int(graph.scans[0]), gtsam.Pose3(), fixed))
    return factors, _start(graph, edges)


def _start(graph: TrueGraph, edges: EdgeTable) -> Any:
    """Poses along the spanning tree of most inliers."""
    import gtsam

    tree = nx.Graph()
    columns = zip(edges.pairs.tolist(), edges.inlier_count.tolist(), edges.T_j_i, strict=True)
    for (i, j), inliers, T_j_i in columns:
        tree.add_edge(i, j, weight=inliers, T={i: T_j_i, j: se3.inverse(T_j_i)})
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
    edges = graph.edges
    E = graph.motions(edges.i, edges.j) @ se3.inverse(edges.T_j_i)
    xi = np.concatenate([se3.log_so3(E[:, :3, :3]), E[:, :3, 3]], axis=1)
    chi2 = np.einsum("ma,mab,mb->m", xi, edges.information, xi)
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


def pycolmap(graph: TrueGraph, edges: EdgeTable) -> Solution:
    """COLMAP's global rotation averaging: rotations only."""
    T, posed = _nothing(graph)
    place = np.full(len(T), -1)
    place[graph.scans] = np.arange(len(graph.scans))
    false = np.zeros(len(edges), bool)
    compact = ViewGraph(graph.T_world_cam[graph.scans], place[edges.pairs], edges.T_j_i, false)
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
