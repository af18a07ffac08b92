"""Small maps and images with exact truth."""

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.mapping.absolute_pose import Sightings
from miniloop_cli.mapping.alone import map_of
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.scene_map import MapPart
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.scene.timing import Timing
from miniloop_cli.scene.verdict import Rejection, Verdict

CAMERA = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)


def some_pose(rng, angle=0.5, distance=0.5):
    return se3.pose(se3.exp_so3(angle * rng.normal(size=3)), distance * rng.normal(size=3))


def sightings(rng, T_world_cam, count=150, sigma_px=1.0, sigma_m=0.01, with_depth=False):
    """Points with errors of their own, as an image at T_world_cam sees the true ones, with pixel noise."""
    p_cam = np.stack([rng.uniform(-1, 1, count), rng.uniform(-0.8, 0.8, count), rng.uniform(1.5, 4, count)], axis=1)
    px = CAMERA.project(p_cam) + sigma_px * rng.normal(size=(count, 2))
    points = se3.transform(T_world_cam, p_cam) + sigma_m * rng.normal(size=(count, 3))
    z = p_cam[:, 2] + 2 * CAMERA.noise.sigma_m(p_cam[:, 2]) * rng.normal(size=count)
    covariance = np.tile(sigma_m**2 * np.eye(3), (count, 1, 1))
    return Sightings(px, z if with_depth else np.full(count, np.nan), points, covariance)


def keyframe(rng, points_world, T_world_cam, descriptors):
    """What a keyframe at T_world_cam keeps of points that it sees without error."""
    p = se3.transform(se3.inverse(T_world_cam), points_world)
    n = len(p)
    px = CAMERA.project(p)
    return ScanFeatures(px, px, p[:, 2].copy(), np.zeros((n, 2)), np.zeros(n, bool), descriptors)


def small_part(name="hall", seed=0, keyframes=4):
    """A recording of a few keyframes that all see the same 120 points, and two frames between each two of them."""
    rng = np.random.default_rng(seed)
    n = 3 * keyframes - 2
    points = np.stack([rng.uniform(-1, 1, 120), rng.uniform(-0.8, 0.8, 120), rng.uniform(2, 4, 120)], axis=1)
    descriptors = rng.integers(0, 256, (120, 128), dtype=np.uint8)
    T = np.array([se3.pose(se3.exp_so3(np.array([0, 0.01 * k, 0])), np.array([0.02 * k, 0, 0])) for k in range(n)])
    rows = np.arange(0, n, 3)
    features = tuple(keyframe(rng, points, T[k], descriptors) for k in rows)
    same = np.repeat(np.arange(120)[:, None], 2, axis=1)
    edges = [
        Edge(a, a + 1, same, np.ones(120, bool), se3.inverse(T[rows[a + 1]]) @ T[rows[a]], 1e4 * np.eye(6),
             1e-4 * np.eye(6), verdict=Verdict.VERIFIED, rejection=Rejection.NONE)
        for a in range(keyframes - 1)
    ]  # fmt: skip
    gray = rng.integers(1, 255, (48, 64)).astype(np.float32)
    flat = np.full((48, 64), 2.5, np.float32)
    views = tuple(View(gray, flat, flat, flat) for _ in rows)
    images = tuple(f"{seed:08x}{k:08x}" for k in rows)
    return MapPart(
        name, f"/recordings/{name}", "tum", n, CAMERA, "sift", Timing(0.02, -0.01), np.arange(n), 0.1 * np.arange(n),
        T, np.tile(1e-4 * np.eye(6), (n, 1, 1)), rows, images, features, views, EdgeTable.of(edges),
    )  # fmt: skip


def small_map(name="hall", seed=0):
    return map_of(small_part(name, seed), {"refine": "bundle"}, 0)
