"""Open3D's multiway registration: RANSAC on feature correspondences for every pair, then its pose graph optimisation.

Open3D brings no image features and no matcher for them: it is given ours, and exhaustive exact matching, by our
matcher, the fastest of those measured, or with `--matcher opencv` by the one that comes with the features. Two of its
answers are not taken as they come: `correspondence_set` holds nearest neighbours instead of the given correspondences,
and the pose is not refined on its inliers. Inliers are counted on the given correspondences here, and the pose is
fitted to them (twice, as inliers change).
"""

from __future__ import annotations

import tempfile
from itertools import combinations
from pathlib import Path

import networkx as nx
import numpy as np
import open3d as o3d

from benchmarks.side_by_side.clock import Clock, arguments, write_poses, write_result
from miniloop_cli.datasets import open_sequence
from miniloop_cli.features.detect import comparable
from miniloop_cli.geometry import se3
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.stages.candidates import enough, match_fully
from miniloop_cli.stages.extract import extract
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Floats, Ints, Pair

registration = o3d.pipelines.registration
o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)


def cloud(points: Floats) -> o3d.geometry.PointCloud:
    """Open3D's point cloud of (n, 3) points."""
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def register_pair(p: Floats, q: Floats, distance_m: float) -> tuple[Floats, Floats, int]:
    """Pose (4, 4) that maps p to q, Open3D's information matrix (6, 6), number of inliers; p, q (m, 3) matched."""
    rows = np.repeat(np.arange(len(p))[:, None], 2, axis=1)
    source, target, fit = cloud(p), cloud(q), registration.TransformationEstimationPointToPoint()
    T = registration.registration_ransac_based_on_correspondence(
        source, target, o3d.utility.Vector2iVector(rows), distance_m, fit, 3
    ).transformation
    for _ in range(2):
        inliers = np.linalg.norm(se3.transform(T, p) - q, axis=1) < distance_m
        if inliers.sum() < 3:
            return T, np.eye(6), 0
        T = fit.compute_transformation(source, target, o3d.utility.Vector2iVector(rows[inliers]))
    inliers = np.linalg.norm(se3.transform(T, p) - q, axis=1) < distance_m
    information = registration.get_information_matrix_from_point_clouds(
        cloud(p[inliers]), cloud(q[inliers]), distance_m, T
    )
    return T, information, int(inliers.sum())


def optimise(edges: dict[tuple[int, int], tuple[Floats, Floats, int]], distance_m: float) -> dict:
    """Poses {scan: T_world_cam} of the largest component: pose graph from the tree of most inliers, then optimised."""
    graph = nx.Graph()
    graph.add_weighted_edges_from((i, j, inliers) for (i, j), (_, _, inliers) in edges.items())
    tree = nx.maximum_spanning_tree(graph.subgraph(max(nx.connected_components(graph), key=len)))
    poses = {min(tree): np.eye(4)}
    for known, new in nx.bfs_edges(tree, min(tree)):
        T_known_new = edges[new, known][0] if (new, known) in edges else se3.inverse(edges[known, new][0])
        poses[new] = poses[known] @ T_known_new
    scans = sorted(poses)
    node = {scan: k for k, scan in enumerate(scans)}
    problem = registration.PoseGraph()
    problem.nodes.extend(registration.PoseGraphNode(poses[scan]) for scan in scans)
    for (i, j), (T, information, _) in edges.items():
        if i in node and j in node:
            # Neighbours in time are certain, loops are not: they may be pruned.
            problem.edges.append(registration.PoseGraphEdge(node[i], node[j], T, information, j - i > 1))
    option = registration.GlobalOptimizationOption(
        max_correspondence_distance=distance_m, edge_prune_threshold=0.25, reference_node=0
    )
    method = registration.GlobalOptimizationLevenbergMarquardt()
    registration.global_optimization(problem, method, registration.GlobalOptimizationConvergenceCriteria(), option)
    return {scan: problem.nodes[node[scan]].pose for scan in scans}


def main() -> None:
    options = arguments(__doc__, min_inliers=30, distance_m=0.05, matcher="miniloop")
    clock, workers, sequence = Clock(), Workers(), open_sequence(options.sequence)
    settings = load_settings(overrides=(f"matching.min_matches={options.min_inliers}",))  # fewer cannot do
    o3d.utility.random.seed(0)
    with clock.stage("features"), tempfile.TemporaryDirectory() as empty:
        scans = extract(sequence, settings.features, settings.depth, Run(Store(Path(empty)), workers))
        points = [scan.points_m for scan in scans.points]
    with clock.stage("matching"):
        descriptors = [comparable(found.descriptors[: found.with_depth], "rootsift") for found in scans.features]
        pairs = list(combinations(range(len(scans)), 2))
        if options.matcher == "opencv":
            # Late: what it imports beside would count in the memory of the other row.
            from benchmarks.side_by_side.matching import opencv

            def compare(pair: Pair) -> Ints:
                return opencv(descriptors[pair[0]], descriptors[pair[1]])

            found = workers.map(compare, pairs, "matching", len(pairs))
            matches = enough(pairs, found, settings.matching)
        else:
            matches = match_fully(descriptors, pairs, settings.matching, workers)
    with clock.stage("edges"):
        edges = {}
        for (i, j), rows in matches.items():
            edge = register_pair(points[i][rows[:, 0]], points[j][rows[:, 1]], options.distance_m)
            if edge[2] >= options.min_inliers:
                edges[i, j] = edge
    with clock.stage("pose graph"):
        poses = optimise(edges, options.distance_m)
    stamps = np.array([frame.timestamp_s for frame in sequence.frames])
    write_poses(options.out, stamps[list(poses)], np.array(list(poses.values())))
    write_result(options.out, {"stages": clock.stages, "frames": len(stamps), "edges": len(edges)})


if __name__ == "__main__":
    main()
