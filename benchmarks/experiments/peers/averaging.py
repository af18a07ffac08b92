"""Rotation averaging by others on the same view graphs; for comparison, each only where it is installed."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable

import numpy as np

from benchmarks.experiments.view_graphs import ViewGraph
from miniloop_cli.errors import MiniloopError
from miniloop_cli.typing import Floats

Solve = Callable[[ViewGraph], tuple[Floats, float]]
SHONAN_SCANS = 1000
"""gtsam's Shonan averaging certifies its optimum; beyond some thousand scans that takes minutes to hours."""


def pycolmap_rotations(graph: ViewGraph) -> tuple[Floats, float]:
    """R_world_cam (n, 3, 3) by COLMAP's global rotation averaging, with its defaults, and the seconds of that call."""
    import pycolmap

    reconstruction, poses = pycolmap.Reconstruction(), pycolmap.PoseGraph()
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[525, 525, 320, 240], camera_id=1)
    reconstruction.add_camera_with_trivial_rig(camera)
    scans = len(graph.T_world_cam)
    for k in range(scans):
        reconstruction.add_image_with_trivial_frame(pycolmap.Image(name=str(k), camera_id=1, image_id=k + 1))
    for (i, j), T in zip(graph.pairs.tolist(), graph.T_j_i, strict=True):
        edge = pycolmap.PoseGraphEdge(pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3]))
        edge.num_matches = 100
        if not poses.has_edge(i + 1, j + 1):
            poses.add_edge(i + 1, j + 1, edge)
    options = pycolmap.RotationEstimatorOptions(random_seed=0)
    start = time.perf_counter()
    found = pycolmap.run_rotation_averaging(options, poses, reconstruction, [])
    seconds = time.perf_counter() - start
    if not found:
        raise MiniloopError("pycolmap's rotation averaging gave no result on this graph")
    images = [reconstruction.image(k + 1) for k in range(scans)]
    poses_or_none = [image.cam_from_world().rotation.matrix().T if image.has_pose else np.eye(3) for image in images]
    return np.array(poses_or_none), seconds


def gtsam_rotations(graph: ViewGraph) -> tuple[Floats, float]:
    """R_world_cam (n, 3, 3) by gtsam's Shonan averaging with Huber's loss, and the seconds of its run."""
    import gtsam

    noise = gtsam.noiseModel.Isotropic.Sigma(3, np.radians(1.0))
    measurements = [
        gtsam.BinaryMeasurementRot3(j, i, gtsam.Rot3(T[:3, :3]), noise)
        for (i, j), T in zip(graph.pairs.tolist(), graph.T_j_i, strict=True)
    ]
    parameters = gtsam.ShonanAveragingParameters3(gtsam.LevenbergMarquardtParams.CeresDefaults())
    parameters.setUseHuber(True)
    parameters.setCertifyOptimality(False)
    start = time.perf_counter()
    shonan = gtsam.ShonanAveraging3(measurements, parameters)
    values, _ = shonan.run(shonan.initializeRandomly(), 3, 3)
    seconds = time.perf_counter() - start
    return np.array([values.atRot3(k).matrix() for k in range(len(graph.T_world_cam))]), seconds


def installed(scans: int) -> dict[str, Solve]:
    """The peers that are installed and can take a graph of `scans` scans."""
    found: dict[str, Solve] = {"pycolmap": pycolmap_rotations} if importlib.util.find_spec("pycolmap") else {}
    if importlib.util.find_spec("gtsam") and scans <= SHONAN_SCANS:
        found["gtsam"] = gtsam_rotations
    return found
