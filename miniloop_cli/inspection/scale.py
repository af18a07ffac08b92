"""Checks of the focal length and of the depth scale.

Focal length: a wrong one stretches lateral coordinates against depth, and scans of a turning camera no longer fit
rigidly. The cost of the fit over several pairs therefore has its minimum at the true focal length.

Depth scale: a common factor on all depths only scales the world, so motions do not determine it. A ground truth does,
or the steps of a structured-light sensor, which are equal in inverse depth and fixed by its hardware.
"""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.inspection.pairs import MatchedPair, resection
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats

FACTORS = np.exp(np.linspace(-0.35, 0.35, 11))
CAUCHY = 3.0
MIN_POINTS, MAX_POINTS = 15, 200
MIN_MOTION_M = 0.08


@dataclass(frozen=True)
class FocalFit:
    """The best factor on the focal length, its 90 % interval (bootstrap over pairs), and the poses with it.

    `gain`: decrease of the mean robust cost of a match against the given focal length.
    """

    factor: float
    low: float
    high: float
    gain: float
    poses: dict[tuple[int, int], list[Floats]]  # T_j_i for each of FACTORS

    @property
    def contradicts(self) -> bool:
        """Whether the given focal length is certainly wrong by more than some per cent."""
        return abs(self.factor - 1) > 0.07 and (self.low > 1.04 or self.high < 0.96) and self.gain > 0.05

    @property
    def beyond(self) -> str:
        """The words " or less" or " or more" if the best factor is the last one tried, else ""."""
        return " or less" if self.factor <= FACTORS[0] else " or more" if self.factor >= FACTORS[-1] else ""

    def T_j_i(self) -> dict[tuple[int, int], Floats]:
        """Poses (4, 4) with the accepted focal length: the given one unless it is contradicted."""
        k = int(np.argmin(np.abs(np.log(FACTORS / (self.factor if self.contradicts else 1.0)))))
        return {key: poses[k] for key, poses in self.poses.items()}


def fit_focal(pairs: Many[MatchedPair], camera: Camera, rng: Generator) -> FocalFit | None:
    """The focal length, relative to the camera's, that makes the scans of the pairs fit best; None if undetermined."""
    costs, poses, matches = [], {}, 0
    for pair in pairs:
        known = np.flatnonzero(np.isfinite(pair.z_i) & np.isfinite(pair.z_j))[:MAX_POINTS]
        start, share, _ = resection(pair, camera)
        if len(known) < MIN_POINTS or not share > 0.2:
            continue
        px, z = (pair.px_i[known], pair.px_j[known]), (pair.z_i[known], pair.z_j[known])
        fits = [_rigid_fit(px, z, _scaled(camera, factor), start) for factor in FACTORS]
        costs.append([cost for cost, _ in fits])
        poses[pair.i, pair.j] = [T for _, T in fits]
        matches += len(known)
    if len(costs) < 4:
        return None
    cost = np.array(costs)
    draws = rng.integers(0, len(cost), (200, len(cost)))
    low, high = np.quantile([_minimum(cost[draw].sum(0)) for draw in draws], [0.05, 0.95])
    total = cost.sum(0)
    gain = (total[len(FACTORS) // 2] - total.min()) / matches
    return FocalFit(_minimum(total), float(low), float(high), float(gain), poses)


def _scaled(camera: Camera, factor: float) -> Camera:
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)


def _rigid_fit(
    px: tuple[Floats, Floats], z: tuple[Floats, Floats], camera: Camera, T_j_i: Floats
) -> tuple[float, Floats]:
    """Robust noise-scaled cost and pose of the best rigid motion between matched points (Gauss-Newton, Cauchy)."""
    p, q = camera.backproject(px[0], z[0]), camera.backproject(px[1], z[1])
    Cp, Cq = camera.point_covariance(p), camera.point_covariance(q)
    T = T_j_i
    J = np.zeros((len(p), 3, 6))
    J[:, :, 3:] = np.eye(3)
    for _ in range(6):
        R = T[:3, :3]
        turned = p @ R.T
        r = q - turned - T[:3, 3]
        W = np.linalg.inv(Cq + R @ Cp @ R.T)
        d2 = np.einsum("ni,nij,nj->n", r, W, r)
        WJ = (W / (1 + d2 / CAUCHY**2)[:, None, None]) @ _set_rotation(J, turned)
        A, g = np.einsum("nia,nib->ab", J, WJ), np.einsum("nia,ni->a", WJ, r)
        step = np.linalg.solve(A + 1e-9 * np.trace(A) * np.eye(6), g)
        T = se3.pose(se3.exp_so3(step[:3]) @ R, T[:3, 3] + step[3:])
    return float((CAUCHY**2 * np.log1p(d2 / CAUCHY**2)).sum()), T


def _set_rotation(J: Floats, turned: Floats) -> Floats:
    J[:, :, :3] = -se3.hat(turned)
    return J


def _minimum(cost: Floats) -> float:
    """Factor at the minimum of the cost (one value for each of FACTORS), between the samples by a parabola."""
    k, x = int(np.argmin(cost)), np.log(FACTORS)
    if k in (0, len(x) - 1):
        return float(FACTORS[k])
    below, at, above = cost[k - 1 : k + 2]
    return float(np.exp(x[k] + (x[1] - x[0]) * (below - above) / (2 * (below - 2 * at + above))))


def scale_against_truth(fit: FocalFit, stamps_s: Many[float], truth: Trajectory) -> tuple[float, float, float, int]:
    """Ratio of measured to true distances between frames: quartiles (25, 50, 75 %), and the number of usable pairs."""
    ratios = []
    for (i, j), T_j_i in fit.T_j_i().items():
        k = [int(np.argmin(np.abs(truth.timestamps_s - stamps_s[index]))) for index in (i, j)]
        if any(abs(truth.timestamps_s[a] - stamps_s[b]) > 0.02 for a, b in zip(k, (i, j), strict=True)):
            continue
        true_m = np.linalg.norm((se3.inverse(truth.T_world_cam[k[1]]) @ truth.T_world_cam[k[0]])[:3, 3])
        if true_m > MIN_MOTION_M:
            ratios.append(np.linalg.norm(T_j_i[:3, 3]) / true_m)
    if not ratios:
        return float("nan"), float("nan"), float("nan"), 0
    low, middle, high = np.quantile(ratios, [0.25, 0.5, 0.75])
    return float(low), float(middle), float(high), len(ratios)
