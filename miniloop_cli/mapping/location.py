"""Where an image was taken, how surely, and what speaks against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.frame_velocity import SPEED_SIGMAS
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats

SURE_INLIERS = 30
SURE_SHARE = 0.25  # of the matches in the keyframes near by that must agree
SURE_ALIKE = 0.6  # share of the common view that must look alike
SURE_PARTS, GRID = 5, (4, 3)  # of so many parts of the image, those that must show inliers
SURE_DEG, SURE_M = 1.5, 0.04  # standard deviations


@dataclass(frozen=True)
class Location:
    """Where an image was taken, or why that is not known.

    T_world_cam (4, 4) in the world of `piece`, covariance (6, 6) of (w, v) in T_world_cam [exp(w) | v]; both None if
    not `found`. `sure`: nothing speaks against it; `reason`: what does, or why nothing was found. `keyframes`: numbers
    of those that saw it. focal_px: estimated, where it was a guess.
    """

    found: bool
    sure: bool
    reason: str
    T_world_cam: Floats | None = None
    covariance: Floats | None = None
    inliers: int = 0
    keyframes: tuple[int, ...] = ()
    piece: int = 0
    focal_px: float | None = None


def lost(reason: str, inliers: int = 0) -> Location:
    """Nothing was found."""
    return Location(False, False, f"not in this map: {reason}", inliers=inliers)


def doubts_about(px: Floats, matches: int, alike: float, covariance: Floats, camera: Camera) -> list[str]:
    """What speaks against a pose, in sentences; none if it is sure.

    px (k, 2): pixels of the inliers among so many `matches`; alike: share of the view that looks as the map does;
    covariance (6, 6) of the pose.
    """
    doubts = []
    if len(px) < SURE_INLIERS:
        doubts.append(f"only {len(px)} matches agree")
    share = len(px) / max(matches, 1)
    if share < SURE_SHARE:
        doubts.append(f"only {100 * share:.0f} % of the matches near by agree")
    parts = len(np.unique(np.floor(px * (np.array(GRID) / [camera.width, camera.height])).astype(int), axis=0))
    if parts < SURE_PARTS:
        doubts.append(f"they lie in {parts} of {GRID[0] * GRID[1]} parts of the image")
    if alike < SURE_ALIKE:
        doubts.append(f"{100 * alike:.0f} % of what is seen looks alike")
    sigma = np.sqrt(np.diag(covariance))
    sigma_deg, sigma_m = float(np.degrees(np.linalg.norm(sigma[:3]))), float(np.linalg.norm(sigma[3:]))
    if sigma_deg > SURE_DEG or sigma_m > SURE_M:
        doubts.append(f"the pose is uncertain by {sigma_deg:.1f} deg and {100 * sigma_m:.1f} cm")
    return doubts


def unknown_motion(timing: Timing, with_depth: bool) -> Floats:
    """Covariance (6, 6) of a pose by the motion of the camera while it took the image, which one image cannot tell.

    Rows are exposed one after the other, and depth is late: both shift the pose by the motion meanwhile.
    """
    late_s = np.hypot(timing.readout_s / np.sqrt(12), timing.lag_s if with_depth else 0.0)
    return np.diag(np.repeat((np.array(SPEED_SIGMAS) * late_s) ** 2, 3))
