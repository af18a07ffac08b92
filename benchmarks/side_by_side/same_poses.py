"""From relative to absolute poses: miniloop's averaging and pose graph, gtsam's and pycolmap's, on the same edges.

The edges are miniloop's as they are estimated, before averaging drops those that contradict the others; they are
taken from the cache where they are. Every method starts from the edges alone. Errors are those of the common list
of edges, rotations only where a method gives no more.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gtsam
import networkx as nx
import numpy as np

from benchmarks.experiments.own_inliers import judged_by_inliers
from benchmarks.experiments.peers.averaging import gtsam_rotations, pycolmap_rotations
from benchmarks.experiments.view_graphs import ViewGraph
from benchmarks.side_by_side.clock import arguments, write_poses, write_result
from miniloop_cli.averaging.rotations import average_rotations
from miniloop_cli.config import Averaging
from miniloop_cli.datasets import open_sequence
from miniloop_cli.geometry import se3
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.refinement.posegraph import refine_pose_graph
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Floats
from miniloop_cli.verification.consensus import average_verified


def tree_poses(edges: EdgeTable, count: int) -> Floats:
    """Poses (count, 4, 4) along the tree of most inliers: where gtsam starts."""
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    columns = zip(edges.pairs.tolist(), edges.inlier_count.tolist(), edges.T_j_i, strict=True)
    graph.add_edges_from((i, j, {"weight": inliers, "T_j_i": T_j_i}) for (i, j), inliers, T_j_i in columns)
    T, tree = np.tile(np.eye(4), (count, 1, 1)), nx.maximum_spanning_tree(graph)
    for known, new in nx.bfs_edges(tree, 0):
        T_j_i = tree.edges[known, new]["T_j_i"]
        T[new] = T[known] @ (se3.inverse(T_j_i) if known < new else T_j_i)
    return T


def gtsam_poses(edges: EdgeTable, count: int, graduated: bool) -> Floats:
    """gtsam's pose graph: Levenberg-Marquardt with Cauchy's loss, or graduated non-convexity."""
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    loss = gtsam.noiseModel.mEstimator.Cauchy.Create(2.0)
    for (i, j), T_i_j, covariance in zip(edges.pairs.tolist(), se3.inverse(edges.T_j_i), edges.covariance, strict=True):
        # The edge's error (w, v) lies in frame j, as gtsam's does; to first order only its sign differs.
        noise: Any = gtsam.noiseModel.Gaussian.Covariance(covariance)
        if not graduated:
            noise = gtsam.noiseModel.Robust.Create(loss, noise)
        graph.add(gtsam.BetweenFactorPose3(i, j, gtsam.Pose3(T_i_j), noise))
    for k, T in enumerate(tree_poses(edges, count)):
        start.insert(k, gtsam.Pose3(T))
    if graduated:
        parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
        parameters.setKnownInliers([0])
        found = gtsam.GncLMOptimizer(graph, start, parameters).optimize()
    else:
        found = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    return np.array([found.atPose3(k).matrix() for k in range(count)])


def miniloop_pose_graph(edges: EdgeTable, count: int, settings: Averaging) -> Floats:
    """miniloop's robust pose graph from its own averaging, on the edges that averaging leaves."""
    poses, judged = average_verified(edges, count, settings)
    kept = judged.subset(judged.verified)
    return refine_pose_graph(poses.T_world_cam, kept.pairs, kept.T_j_i, kept.information).T_world_cam


def main() -> None:
    options = arguments(__doc__, seed=0)
    sequence, settings = open_sequence(options.sequence), load_settings(overrides=("refine=none",))
    run = register(sequence, settings, Store(default_folder()), Workers(), options.seed)
    judged = judged_by_inliers(run.edges, settings.verification)
    component = components(len(sequence.frames), judged.pairs[judged.verified])
    scans, edges = np.flatnonzero(component == 0), judged.subset(judged.verified & (component[judged.i] == 0))
    edges = replace(edges, i=np.searchsorted(scans, edges.i), j=np.searchsorted(scans, edges.j))
    count, pairs, T_j_i, inliers = len(scans), edges.pairs, edges.T_j_i, edges.inlier_count
    view = ViewGraph(np.tile(np.eye(4), (count, 1, 1)), pairs, T_j_i, np.zeros(len(edges), bool))

    def turned(R: Floats) -> Floats:
        return se3.pose(R, np.zeros(3))

    methods: dict[str, tuple[bool, Callable[[], Floats]]] = {
        "miniloop, averaging": (True, lambda: average_verified(edges, count, settings.averaging)[0].T_world_cam),
        "miniloop, averaging and pose graph": (True, lambda: miniloop_pose_graph(edges, count, settings.averaging)),
        "gtsam, LM with Cauchy's loss": (True, lambda: gtsam_poses(edges, count, graduated=False)),
        "gtsam, graduated non-convexity": (True, lambda: gtsam_poses(edges, count, graduated=True)),
        "miniloop, rotations": (
            False, lambda: turned(average_rotations(count, pairs, T_j_i[:, :3, :3], inliers, start="votes").R_world_cam)
        ),
        "pycolmap, rotations": (False, lambda: turned(pycolmap_rotations(view)[0])),
        "gtsam, Shonan rotations": (False, lambda: turned(gtsam_rotations(view)[0])),
    }  # fmt: skip
    stamps = np.array([sequence.frames[scan].timestamp_s for scan in scans])
    rows: list[dict[str, Any]] = []
    for number, (name, (whole, solve)) in enumerate(methods.items()):
        solve()  # compile
        wall, cpu = time.perf_counter(), time.process_time()
        T = solve()
        row = {"method": name, "wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, "poses": whole}
        write_poses(options.out.with_name(f"{options.out.name}_{number}"), stamps, T)
        rows.append(row | {"trajectory": f"{options.out.name}_{number}.txt"})
    write_result(options.out, {"rows": rows, "edges": len(edges), "frames": len(sequence.frames), "scans": count})


if __name__ == "__main__":
    main()
