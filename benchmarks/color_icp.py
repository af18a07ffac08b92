"""Would colour ICP on the graph's edges make the poses better? Final poses of a run against the same after ICP.

Each scan is registered again to the PARTNERS scans it shares most inliers with, by Open3D's colour ICP in STEPS_M,
started at the final poses; the relative poses then go into a pose graph. Errors as `miniloop eval` gives them.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import open3d as o3d

from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.evaluation.evaluate import evaluate
from miniloop_cli.geometry import se3
from miniloop_cli.refinement.posegraph import refine_pose_graph
from miniloop_cli.results.evaluation_inputs import read_inputs
from miniloop_cli.results.folder import Results
from miniloop_cli.scene.sequence import Sequence, Trajectory

PARTNERS, STEPS_M = 4, (0.04, 0.02)


def clouds(sequence: Sequence, index: int) -> list[o3d.geometry.PointCloud]:
    """The scan with normals at every resolution."""
    scan, camera = read_scan(sequence, index), sequence.camera
    v, u = np.mgrid[0 : camera.height : 2, 0 : camera.width : 2]
    z = scan.depth_m[::2, ::2].ravel()
    good = (z > 0.3) & (z < 4.0)
    px = camera.undistort(np.stack([u.ravel(), v.ravel()], axis=1)[good].astype(float))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(camera.backproject(px, z[good].astype(float))))
    cloud.colors = o3d.utility.Vector3dVector(scan.color[::2, ::2].reshape(-1, 3)[good] / 255)
    found = []
    for size in STEPS_M:
        small = cloud.voxel_down_sample(size)
        small.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2 * size, 30))
        found.append(small)
    return found


def show(result: Path, recording: Path, edge_file: Path | None) -> None:
    """Print the errors of a result before and after; relative ones over `edge_file`'s pairs, else the result's own."""
    trajectory, truth, edges, protocol, edges_are = read_inputs(result, recording, edge_file, None)
    sequence = open_sequence(recording)
    stamps = np.array([frame.timestamp_s for frame in sequence.frames])
    frame = np.abs(stamps - trajectory.timestamps_s[:, None]).argmin(axis=1)
    position = {int(k): n for n, k in enumerate(frame)}
    kept = (row for row in Results(result).edges if row["verdict"] == "verified")
    strong = sorted(kept, key=lambda row: -int(row["inliers"]))
    degree, pairs = np.zeros(len(frame), int), []
    for r in strong:
        i, j = position.get(int(r["i"])), position.get(int(r["j"]))
        if i is not None and j is not None and min(degree[i], degree[j]) < PARTNERS:
            pairs.append((i, j))
            degree[[i, j]] += 1
    begin = time.process_time()
    scans = [clouds(sequence, int(k)) for k in frame]
    T = trajectory.T_world_cam
    relative, information = [], []
    settings = o3d.pipelines.registration
    for i, j in pairs:
        pose = se3.inverse(T[j]) @ T[i]
        for source, target, reach in zip(scans[i], scans[j], STEPS_M, strict=True):
            pose = settings.registration_colored_icp(
                source, target, reach, pose,
                settings.TransformationEstimationForColoredICP(),
                settings.ICPConvergenceCriteria(1e-6, 1e-6, 30),
            ).transformation  # fmt: skip
        relative.append(pose)
        information.append(
            settings.get_information_matrix_from_point_clouds(scans[i][-1], scans[j][-1], STEPS_M[-1], pose)
        )
    # An unweighted count of corresponding points: 1 cm a point, and hardly independent.
    refined = refine_pose_graph(T, pairs, np.array(relative), np.array(information) / 0.01**2 / 100)
    seconds = time.process_time() - begin
    after = Trajectory(trajectory.timestamps_s, refined.T_world_cam)
    for name, poses in (
        ("as registered", trajectory),
        (f"after colour ICP, {len(pairs)} edges, {seconds:.0f} CPU s", after),
    ):
        numbers = evaluate(poses, truth, edges, protocol, edges_are).numbers
        rpe = numbers["rpe"]["edges"]
        print(
            f"{recording.name}: {name}: ATE {100 * numbers['ate_rmse_m']:.3f} cm, "
            f"edges {rpe['rot_deg_mean']:.3f} deg, {100 * rpe['trans_m_mean']:.3f} cm"
        )
