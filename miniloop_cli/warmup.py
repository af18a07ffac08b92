"""Compilation in advance: on a first run, a second process compiles kernels of later stages during the earlier ones.

Compiling all kernels takes longer than registering a short recording, and one process compiles one kernel at a time. A
run without compiled kernels therefore starts `python -m miniloop_cli.warmup`. It runs the later stages on a few
synthetic scans and stores the compiled kernels in numba's cache for the run. A process waits for a kernel that the
other one is compiling (`KernelCache`); the order here makes such waits rare: first what all edges need, while the run
extracts and matches features; then the last stages, and 4-cycles while the run solves 5-cycles. The same command
prepares a fresh installation, e.g. as the last step of a container image.
"""

from __future__ import annotations

import atexit
import gc
import os
import subprocess
import sys
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np

SCANS, POINTS = 5, 120


def compiled() -> bool:
    """Whether numba's cache has the kernel with the longest compilation."""
    from miniloop_cli.ransac.gauss_newton import gauss_newton

    folder = gauss_newton.stats.cache_path
    return folder is not None and any(Path(folder).glob(f"gauss_newton.{gauss_newton.py_func.__name__}-*.nbi"))


@cache
def compile_in_background() -> subprocess.Popen[bytes] | None:
    """Start the warm-up, once a process, if kernels are missing; it ends with this process at the latest."""
    if compiled() or (os.cpu_count() or 1) < 2:
        return None
    silent = subprocess.DEVNULL
    process = subprocess.Popen(
        [sys.executable, "-m", "miniloop_cli.warmup"], stdin=silent, stdout=silent, stderr=silent
    )
    atexit.register(process.kill)
    return process


def warm_up() -> None:
    """Solve pairs and cycles, refine, average and compare views, on scans of a synthetic cloud of points."""
    from miniloop_cli.config import Settings
    from miniloop_cli.features.thumbnail import COLUMNS
    from miniloop_cli.geometry import se3
    from miniloop_cli.geometry.camera import Camera
    from miniloop_cli.refinement.inputs import Scans
    from miniloop_cli.refinement.joint import refine_jointly
    from miniloop_cli.runtime.parallel import Workers
    from miniloop_cli.scene.edge import Edge, EdgeTable
    from miniloop_cli.scene.features import ScanFeatures
    from miniloop_cli.scene.points import scan_points
    from miniloop_cli.scene.poses import Poses
    from miniloop_cli.scene.thumbnail import View
    from miniloop_cli.scene.verdict import Verdict
    from miniloop_cli.stages.solve_edges import solve_cycles
    from miniloop_cli.verification.consensus import average_verified
    from miniloop_cli.verification.photometric import BLOCK, compare_views

    rng, settings, workers = np.random.default_rng(0), Settings(), Workers(1)
    camera = Camera(500.0, 500.0, 319.5, 239.5, 640, 480)
    cloud = rng.uniform((-0.8, -0.6, 1.5), (0.8, 0.6, 3.0), (POINTS, 3))
    look = rng.integers(0, 256, (POINTS, 128)).astype(np.float32)
    motion = 0.02 * rng.standard_normal((SCANS, 6))
    T_world_cam = se3.pose(se3.exp_so3(motion[:, :3]), motion[:, 3:])
    features = []
    for T_cam_world in se3.inverse(T_world_cam):
        p_cam = cloud @ T_cam_world[:3, :3].T + T_cam_world[:3, 3]
        px = p_cam[:, :2] / p_cam[:, 2:] * 500 + [319.5, 239.5] + 0.3 * rng.standard_normal((POINTS, 2))
        features.append(ScanFeatures(px, px, p_cam[:, 2].copy(), np.zeros((POINTS, 2)), np.zeros(POINTS, bool), look))
    points = [scan_points(found, camera) for found in features]
    same = np.repeat(np.arange(POINTS)[:, None], 2, axis=1)
    edges = EdgeTable.of([
        Edge(i, j, same, np.ones(POINTS, bool), se3.inverse(T_world_cam[j]) @ T_world_cam[i],
             1e6 * np.eye(6), 1e-6 * np.eye(6), verdict=Verdict.VERIFIED)
        for i, j in combinations(range(SCANS), 2)
    ])  # fmt: skip
    stamps_s = np.arange(SCANS) / 30
    scans = Scans(features, points, stamps_s, stamps_s + 0.01, camera, settings.features.type)

    def solve(count: int) -> None:
        """Solve a pair, or a cycle of `count` scans."""
        ring = {(min(k, (k + 1) % count), max(k, (k + 1) % count)): same for k in range(count)}
        solve_cycles(ring, points, settings.estimation, 0, workers)

    solve(2)
    refine_jointly(Poses(T_world_cam, np.zeros(SCANS, int)), edges, scans, settings.refine, settings.bundle, workers)
    average_verified(edges, SCANS, settings.averaging)
    solve(4)
    view = View(*np.ones((4, BLOCK, COLUMNS), np.float32))
    compare_views([(view, view)], np.eye(4)[None], camera)
    for count in (3, 5):
        solve(count)


if __name__ == "__main__":
    gc.disable()  # a tenth of the time of compiling
    warm_up()
