"""The location of an image, and the doubts about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.frame_velocity import SPEED_SIGMAS
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats

SURE_INLIERS = 30
SURE_SHARE = 0.25  # of the matches in nearby keyframes that must agree
SURE_ALIKE = 0.6  # share of the common view that must agree
SURE_PARTS, GRID = 5, (4, 3)  # cells of a grid over the image that must have inliers
SURE_DEG, SURE_M = 1.5, 0.04  # standard deviations


@dataclass(frozen=True)
class Location:
    """The pose of an image in a map, or why it is unknown.

    T_world_cam (4, 4) in the world of `piece`, covariance (6, 6) of (w, v) in T_world_cam [exp(w) | v]; both None if
    not `found`. `sure`: no check contradicts it; `reason`: the doubts, or why it was not found. `keyframes`: numbers of
    those that see the same. focal_px: estimated, if it was a guess.
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
    """A location that was not found."""
    return Location(False, False, f"not in this map: {reason}", inliers=inliers)


def doubts_about(px: Floats, matches: int, alike: float, covariance: Floats, camera: Camera) -> list[str]:
    """Sentences that doubt a pose; none if it is sure.

    px (k, 2): pixels of the inliers among `matches` matches; alike: share of the view that agrees with the map;
    covariance (6, 6) of the pose.
    """
    doubts = []
    if len(px) < SURE_INLIERS:
        doubts.append(f"only {len(px)} matches agree")
    share = len(px) / max(matches, 1)
    if share < SURE_SHARE:
        doubts.append(f"only {100 * share:.0f} % of the matches with nearby keyframes agree")
    parts = len(np.unique(np.floor(px * (np.array(GRID) / [camera.width, camera.height])).astype(int), axis=0))
    if parts < SURE_PARTS:
        doubts.append(f"the matches cover only {parts} of {GRID[0] * GRID[1]} cells of the image")
    if alike < SURE_ALIKE:
        doubts.append(f"only {100 * alike:.0f} % of the view looks as the map predicts")
    sigma = np.sqrt(np.diag(covariance))
    sigma_deg, sigma_m = float(np.degrees(np.linalg.norm(sigma[:3]))), float(np.linalg.norm(sigma[3:]))
    if sigma_deg > SURE_DEG or sigma_m > SURE_M:
        doubts.append(f"the pose is uncertain by {sigma_deg:.1f} deg and {100 * sigma_m:.1f} cm")
    return doubts


def unknown_motion(timing: Timing, with_depth: bool) -> Floats:
    """Covariance (6, 6) of a pose due to the unknown motion of the camera during the exposure.

    Rows are exposed one after the other, and depth is late: both shift the pose by the motion in that time.
    """
    late_s = np.hypot(timing.readout_s / np.sqrt(12), timing.lag_s if with_depth else 0.0)
    return np.diag(np.repeat((np.array(SPEED_SIGMAS) * late_s) ** 2, 3))
