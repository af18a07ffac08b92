"""The pose of an image from points of the map: a robust search, then a refinement with all uncertainties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.jackknife import image_part, remaining_fraction
from miniloop_cli.typing import Bools, Floats, Ints

ITERATIONS = 2000
MAX_CHI2 = 11.3  # of an inlier; 99 % of pixels (2 degrees of freedom) are within 9.2
SCALE = 2.0  # of the Cauchy kernel, in sigmas
STEPS, SMALL = 15, 1e-5  # largest number of steps; one of less than so many rad and m is the last
NEAR_M = 0.05
LEAST = 4  # points that a pose needs


@dataclass(frozen=True)
class Sightings:
    """Observations of points of the map in an image, k of them.

    px_ideal (k, 2) undistorted pixels; z_m (k,) measured depth of the image, NaN without; points_m (k, 3) and
    covariances_m2 (k, 3, 3) in the world.
    """

    px_ideal: Floats
    z_m: Floats
    points_m: Floats
    covariances_m2: Floats

    def __len__(self) -> int:
        return len(self.points_m)

    def subset(self, rows: Floats | Bools) -> Sightings:
        """The observations of rows (indices or a mask)."""
        return Sightings(self.px_ideal[rows], self.z_m[rows], self.points_m[rows], self.covariances_m2[rows])


@dataclass(frozen=True)
class PoseEstimate:
    """T_world_cam (4, 4), its covariance (6, 6) of (w, v) in T_world_cam [exp(w) | v], and which observations agree.

    focal: factor on the camera's focal lengths; 1 unless it was estimated. chi2 (k,): of the observations' pixels.
    """

    T_world_cam: Floats
    covariance: Floats
    inliers: Bools
    focal: float
    chi2: Floats


def robust_pose(seen: Sightings, camera: Camera, threshold_px: float) -> tuple[Floats, Bools] | None:
    """T_world_cam (4, 4) by RANSAC over minimal samples, and its inliers (k,); None if none is found.

    LO-RANSAC over P3P samples by poselib, if it is installed, else OpenCV's RANSAC over AP3P samples.
    """
    if len(seen) < LEAST:
        return None
    found = _by_poselib(seen, camera, threshold_px)
    if found is None:
        found = _by_opencv(seen, camera, threshold_px)
    if found is None:
        return None
    T_world_cam = se3.inverse(se3.pose(se3.project_so3(found[:3, :3]), found[:3, 3]))
    p_cam = se3.transform(se3.inverse(T_world_cam), seen.points_m)
    front = p_cam[:, 2] > NEAR_M
    off = np.full(len(seen), np.inf)
    off[front] = np.linalg.norm(camera.project(p_cam[front]) - seen.px_ideal[front], axis=1)
    return T_world_cam, off < threshold_px


def refined_pose(
    T_world_cam: Floats, seen: Sightings, camera: Camera, sigma_px: float = 1.0, with_focal: bool = False
) -> PoseEstimate:
    """The pose (4, 4) that fits all observations best, each under a Cauchy kernel.

    A pixel is weighted by its own noise and by the projected covariance of its point; a depth by twice the sensor's
    noise and that of the point. `with_focal`: a factor on the focal length is estimated as well. Reweighted
    Gauss-Newton, at most STEPS steps.

    Variances are those of the grouped jackknife over parts of the image, by one Newton step without each part, if they
    exceed those of the residuals, as a rolling shutter deforms the image (refinement/jackknife.py). Correlations are
    those of the inverse Hessian.
    """
    size = 7 if with_focal else 6
    log_focal, T = 0.0, T_world_cam
    for _ in range(STEPS):
        H_k, g_k, _ = _equations(T, np.exp(log_focal), seen, camera, sigma_px)
        H, g = H_k.sum(axis=0)[:size, :size] + 1e-9 * np.eye(size), g_k.sum(axis=0)[:size]
        step = -np.linalg.solve(H, g)
        T = T @ se3.pose(se3.exp_so3(step[:3]), step[3:6])
        log_focal += float(step[6]) if with_focal else 0.0
        if np.abs(step).max() < SMALL:
            break
    H_k, g_k, chi2 = _equations(T, np.exp(log_focal), seen, camera, sigma_px)
    inliers = chi2 < MAX_CHI2
    freedom = max(2 * int(inliers.sum()) - size, 1)
    excess = max(1.0, float(chi2[inliers].sum()) / freedom)
    covariance = _covariance(H_k[:, :size, :size], g_k[:, :size], excess, image_part(seen.px_ideal, camera))
    return PoseEstimate(T, covariance[:6, :6], inliers, float(np.exp(log_focal)), chi2)


def _covariance(H_k: Floats, g_k: Floats, excess: float, part: Ints) -> Floats:
    """(s, s) from the normal equations of each observation (k, s, s), (k, s) at the minimum; part (k,) of the image."""
    tie = 1e-9 * np.eye(g_k.shape[1])
    inverse = np.linalg.inv(H_k.sum(axis=0) + tie)
    variance = np.zeros(g_k.shape[1])
    for number, left in enumerate(remaining_fraction(part)):
        rest = part != number
        variance += left * np.linalg.solve(H_k[rest].sum(axis=0) + tie, g_k[rest].sum(axis=0)) ** 2
    promised = excess * np.diag(inverse)
    size = np.sqrt(np.maximum(variance, promised) / np.diag(inverse))
    covariance = size[:, None] * inverse * size
    return (covariance + covariance.T) / 2


def _equations(
    T_world_cam: Floats, focal: float, seen: Sightings, camera: Camera, sigma_px: float
) -> tuple[Floats, Floats, Floats]:
    """Normal equations of each observation under its kernel, (k, 7, 7) and (k, 7), and chi2 (k,) of its pixel."""
    r_px, J_px, r_z, J_z = _linearised(T_world_cam, focal, seen, camera, sigma_px)
    chi2 = (r_px**2).sum(axis=1)
    weight = 1 / (1 + chi2 / SCALE**2)
    weight_z = np.where(np.isfinite(r_z), 1 / (1 + r_z**2 / SCALE**2), 0.0)
    r_z = np.nan_to_num(r_z)
    H = (
        np.swapaxes(J_px, 1, 2) @ (weight[:, None, None] * J_px)
        + weight_z[:, None, None] * J_z[:, :, None] * J_z[:, None]
    )
    g = weight[:, None] * np.einsum("kri,kr->ki", J_px, r_px) + (weight_z * r_z)[:, None] * J_z
    return H, g, chi2


def _linearised(
    T_world_cam: Floats, focal: float, seen: Sightings, camera: Camera, sigma_px: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Residuals in sigmas and their derivatives by (w, v, log focal): pixels (k, 2), (k, 2, 7); depths (k,), (k, 7).

    p_cam = exp(-w) (p - v) for the pose T_world_cam [exp(w) | v]: dp/dw = [p]x, dp/dv = -1. Points behind the camera
    have a residual so large that their weight is zero.
    """
    R = T_world_cam[:3, :3]
    p = (seen.points_m - T_world_cam[:3, 3]) @ R
    front = p[:, 2] > NEAR_M
    p = np.where(front[:, None], p, [0.0, 0.0, 1.0])
    C = R.T @ seen.covariances_m2 @ R
    x, y, z = p.T
    fx, fy, zero = focal * camera.fx, focal * camera.fy, np.zeros(len(p))
    D = np.stack([np.stack([fx / z, zero, -fx * x / z**2], 1), np.stack([zero, fy / z, -fy * y / z**2], 1)], axis=1)
    by_pose = np.concatenate([se3.hat(p), np.broadcast_to(-np.eye(3), (len(p), 3, 3))], axis=2)
    off_axis = np.stack([fx * x / z, fy * y / z], axis=1)
    J = np.concatenate([D @ by_pose, off_axis[:, :, None]], axis=2)
    residual = off_axis + np.array([camera.cx, camera.cy]) - seen.px_ideal
    S = sigma_px**2 * np.eye(2) + D @ C @ np.swapaxes(D, 1, 2)
    L = np.linalg.inv(np.linalg.cholesky(S))
    residual = np.where(front[:, None], np.einsum("kij,kj->ki", L, residual), 1e6)
    J = np.where(front[:, None, None], L @ J, 0.0)
    sigma_z = np.sqrt((2 * camera.noise.sigma_m(np.nan_to_num(seen.z_m, nan=1.0))) ** 2 + C[:, 2, 2])
    r_z = np.where(front, (z - seen.z_m) / sigma_z, np.nan)
    J_z = np.concatenate([by_pose[:, 2], np.zeros((len(p), 1))], axis=1) / sigma_z[:, None]
    return residual, J, r_z, J_z


def _by_poselib(seen: Sightings, camera: Camera, threshold_px: float) -> Floats | None:
    """T_cam_world (3, 4); None without poselib, or if it finds no pose."""
    try:
        import poselib
    except ImportError:
        return None
    model = {
        "model": "PINHOLE",
        "width": camera.width,
        "height": camera.height,
        "params": [camera.fx, camera.fy, camera.cx, camera.cy],
    }
    options = {"max_reproj_error": threshold_px, "max_iterations": ITERATIONS, "min_iterations": 100, "seed": 0}
    found, info = poselib.estimate_absolute_pose(seen.px_ideal, seen.points_m, model, options, {})
    return np.asarray(found.Rt, float) if info["num_inliers"] >= LEAST else None


def _by_opencv(seen: Sightings, camera: Camera, threshold_px: float) -> Floats | None:
    """T_cam_world (3, 4); None if no pose is found."""
    import cv2

    try:
        good, turn, t, inliers = cv2.solvePnPRansac(
            seen.points_m,
            seen.px_ideal,
            camera.K,
            None,
            iterationsCount=ITERATIONS,
            reprojectionError=threshold_px,
            confidence=0.9999,
            flags=cv2.SOLVEPNP_AP3P,
        )
    except cv2.error:  # no pose explains the points, or all are at one position
        return None
    if not good or inliers is None or not np.isfinite(turn).all() or not np.isfinite(t).all():
        return None
    R = se3.exp_so3(np.asarray(turn, float).ravel())
    return np.concatenate([R, np.asarray(t, float).reshape(3, 1)], axis=1)
