"""Scenes with known truth: tracks of an RGB-D camera, and pose graphs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.se3 import exp_so3, inverse, log_so3, pose

CAMERA = Camera(525.0, 520.0, 319.5, 239.5, 640, 480)


@dataclass
class Scene:
    T: np.ndarray
    points: np.ndarray
    frame: np.ndarray
    track: np.ndarray
    px: np.ndarray
    z: np.ndarray

    @property
    def observations(self):
        return self.frame, self.track, self.px, self.z


def path(n, offset=0.0):
    s = np.linspace(0, 1.2, n)
    w = np.stack([0.1 * np.sin(7 * s), s, 0.1 * np.cos(5 * s)], axis=1)
    return pose(exp_so3(w), np.stack([np.sin(3 * s), 0.3 * np.cos(4 * s), 0.5 * np.sin(2 * s)], axis=1) + offset)


def scene(rng, n=8, points=120, seen=0.7, sigma_px=0.0, depth_sigmas=0.0, no_depth=0.0, outliers=0.0, offset=0.0):
    """n views of points, each visible one seen with probability `seen`; noise as the camera's model."""
    T = path(n, offset)
    home = rng.integers(0, n, points)
    px = np.stack([rng.uniform(0, 639, points), rng.uniform(0, 479, points)], axis=1)
    local = CAMERA.backproject(px, rng.uniform(0.8, 4, points))
    X = np.einsum("kij,kj->ki", T[home, :3, :3], local) + T[home, :3, 3]
    rows = []
    for f in range(n):
        x = (X - T[f, :3, 3]) @ T[f, :3, :3]
        near = np.flatnonzero((x[:, 2] > 0.5) & (rng.random(points) < seen))
        uv = CAMERA.project(x[near])
        inside = ((uv >= 0) & (uv < [640, 480])).all(axis=1)
        rows.append((np.full(inside.sum(), f), near[inside], uv[inside], x[near[inside], 2]))
    frame, track, px, z = (np.concatenate(c) for c in zip(*rows, strict=True))
    px = px + sigma_px * rng.standard_normal(px.shape)
    z = z + depth_sigmas * CAMERA.noise.sigma_m(z) * rng.standard_normal(len(z))
    wrong = rng.random(len(z)) < outliers
    px[wrong] += rng.uniform(-80, 80, (wrong.sum(), 2))
    wrong = rng.random(len(z)) < outliers
    z[wrong] *= rng.uniform(0.6, 1.6, wrong.sum())
    z[rng.random(len(z)) < no_depth] = np.nan
    return Scene(T, X, frame, track, px, z)


def perturbed(T, rng, deg, m):
    n = len(T)
    return T @ pose(exp_so3(np.radians(deg) * rng.standard_normal((n, 3))), m * rng.standard_normal((n, 3)))


def tangent(E):
    return np.concatenate([log_so3(E[:, :3, :3]), E[:, :3, 3]], axis=1)


def errors(T_true, T, fixed):
    """(n, 6) errors (w, v), T_true = T [exp(w) | v], once the fixed frame is laid upon its truth."""
    return tangent(inverse(T_true[fixed] @ inverse(T[fixed]) @ T) @ T_true)


def graph(rng, n=30, edges=120, sigma_rad=0.01, sigma_m=0.02, wrong=0.0, noise=True):
    """Poses around a room, relative poses of random pairs (a chain always among them), information, and which lie."""
    s = np.arange(n)
    p = np.stack([3 * np.sin(2 * np.pi * s / n), 2 * np.sin(4 * np.pi * s / n + 0.3), 0.3 * np.sin(s)], axis=1)
    T = pose(exp_so3(np.stack([0.3 * np.sin(s), 0.3 * np.cos(s / 2), 2 * np.pi * s / n], axis=1)), p)
    pairs = np.sort(rng.integers(0, n, (edges, 2)), axis=1)
    pairs = np.concatenate([np.stack([s[:-1], s[1:]], axis=1), pairs[pairs[:, 0] < pairs[:, 1]]])
    m = len(pairs)
    A = np.eye(6) + 0.3 * rng.standard_normal((m, 6, 6))
    scale = np.diag([sigma_rad] * 3 + [sigma_m] * 3)
    C = scale @ A @ A.transpose(0, 2, 1) @ scale
    xi = np.einsum("mij,mj->mi", np.linalg.cholesky(C), rng.standard_normal((m, 6))) * noise
    measured = inverse(pose(exp_so3(xi[:, :3]), xi[:, 3:])) @ inverse(T[pairs[:, 1]]) @ T[pairs[:, 0]]
    lies = (rng.random(m) < wrong) & (np.arange(m) >= n - 1)
    measured[lies] = measured[lies] @ pose(
        exp_so3(rng.uniform(-1, 1, (lies.sum(), 3))), rng.uniform(-1, 1, (lies.sum(), 3))
    )
    return T, pairs, measured, np.linalg.inv(C), lies
