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
from numpy.typing import NDArray

from benchmarks.experiments.peers.averaging import gtsam_rotations, pycolmap_rotations
from benchmarks.experiments.view_graphs import ViewGraph
from benchmarks.side_by_side.clock import arguments, write_poses, write_result
from miniloop_cli.averaging.rotations import average_rotations
from miniloop_cli.config import Averaging
from miniloop_cli.datasets import open_sequence
from miniloop_cli.geometry import se3
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.ransac.cycle_edges import judge
from miniloop_cli.refinement.posegraph import refine_pose_graph
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import VERIFIED, Edge, pairs_of
from miniloop_cli.scene.view_graph import components
from miniloop_cli.stages.average import average

Floats = NDArray[np.float64]


def tree_poses(edges: list[Edge], count: int) -> Floats:
    """Poses (count, 4, 4) along the tree of most inliers: where gtsam starts."""
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    graph.add_edges_from((e.i, e.j, {"weight": e.inlier_count, "edge": e}) for e in edges)
    T, tree = np.tile(np.eye(4), (count, 1, 1)), nx.maximum_spanning_tree(graph)
    for known, new in nx.bfs_edges(tree, 0):
        edge = tree.edges[known, new]["edge"]
        T[new] = T[known] @ (se3.inverse(edge.T_j_i) if edge.i == known else edge.T_j_i)
    return T


def gtsam_poses(edges: list[Edge], count: int, graduated: bool) -> Floats:
    """gtsam's pose graph: Levenberg-Marquardt with Cauchy's loss, or graduated non-convexity."""
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    loss = gtsam.noiseModel.mEstimator.Cauchy.Create(2.0)
    for e in edges:
        # The edge's error (w, v) lies in frame j, as gtsam's does; to first order only its sign differs.
        noise: Any = gtsam.noiseModel.Gaussian.Covariance(e.covariance)
        if not graduated:
            noise = gtsam.noiseModel.Robust.Create(loss, noise)
        graph.add(gtsam.BetweenFactorPose3(e.i, e.j, gtsam.Pose3(se3.inverse(e.T_j_i)), noise))
    for k, T in enumerate(tree_poses(edges, count)):
        start.insert(k, gtsam.Pose3(T))
    if graduated:
        parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
        parameters.setKnownInliers([0])
        found = gtsam.GncLMOptimizer(graph, start, parameters).optimize()
    else:
        found = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    return np.array([found.atPose3(k).matrix() for k in range(count)])


def miniloop_pose_graph(edges: list[Edge], count: int, settings: Averaging) -> Floats:
    """miniloop's robust pose graph from its own averaging, on the edges that averaging leaves."""
    poses, kept = average(edges, count, settings)
    kept = [e for e in kept if e.verdict == VERIFIED]
    return refine_pose_graph(
        poses.T_world_cam,
        pairs_of(kept),
        np.array([e.T_j_i for e in kept]),
        np.array([e.information for e in kept]),
    ).T_world_cam


def main() -> None:
    options = arguments(__doc__, seed=0)
    sequence, settings = open_sequence(options.sequence), load_settings(overrides=("refine=none",))
    run = register(sequence, settings, Store(default_folder()), Workers(), options.seed)
    edges = [e for e in (judge(edge, settings.verification) for edge in run.edges) if e.verdict == VERIFIED]
    scans = np.flatnonzero(components(len(sequence.frames), pairs_of(edges)) == 0).tolist()
    place = {scan: k for k, scan in enumerate(scans)}
    edges = [replace(e, i=place[e.i], j=place[e.j]) for e in edges if e.i in place]
    count, pairs = len(scans), pairs_of(edges)
    T_j_i = np.array([e.T_j_i for e in edges])
    view = ViewGraph(np.tile(np.eye(4), (count, 1, 1)), pairs, T_j_i, np.zeros(len(edges), bool))
    inliers = np.array([e.inlier_count for e in edges], float)

    def turned(R: Floats) -> Floats:
        return se3.pose(R, np.zeros(3))

    methods: dict[str, tuple[bool, Callable[[], Floats]]] = {
        "miniloop, averaging": (True, lambda: average(edges, count, settings.averaging)[0].T_world_cam),
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
