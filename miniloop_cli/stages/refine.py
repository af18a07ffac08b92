"""Stage: all poses of the largest component refined together."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from miniloop_cli.config import Bundle, Calibrate, Refinement
from miniloop_cli.geometry.camera import Trust
from miniloop_cli.refinement.inputs import Between, Refined, Scans
from miniloop_cli.refinement.two_cameras import TwoCameras
from miniloop_cli.runtime.allocator import give_back_freed_memory
from miniloop_cli.runtime.artifact_store import Arrays
from miniloop_cli.scene.calibration import Calibration
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.landmarks import Landmarks
from miniloop_cli.scene.poses import Poses, usable_edges
from miniloop_cli.scene.priors import Vertical
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.timing import Timing
from miniloop_cli.stages.artifacts import REFINED
from miniloop_cli.stages.run import Run

LOG = logging.getLogger("miniloop")


def refine(
    poses: Poses,
    edges: EdgeTable,
    scans: ScanSet,
    method: Refinement,
    bundle: Bundle,
    vertical: Vertical | None,
    run: Run,
    between: Between | None = None,
    calibrate: Calibrate = "auto",
    two: TwoCameras | None = None,
) -> Refined:
    """Poses of the largest component, refined from the given ones with the edges used in it; the others are unchanged.

    `vertical`: from an accelerometer; the poses are then level, z up. `between`: of a whole recording, whose keyframes
    are the scans; then the poses are those of all its frames. `calibrate`: whether the camera is estimated;
    `two`: to estimate a separate depth camera as well.
    """
    inside = edges.subset(usable_edges(edges, len(scans)) & poses.joins(edges))
    inputs = Scans(
        scans.features,
        scans.points,
        scans.stamps_s,
        scans.depth_stamps_s,
        scans.camera,
        scans.feature_type,
        vertical,
        two,
    )
    if method == "none" or not len(inside):
        from miniloop_cli.refinement.joint import level

        poses = level(poses, inputs)[0]
        poses = between.tracked.all_poses(poses) if between else poses
        return Refined(poses, np.full((len(poses.component), 6, 6), np.nan))

    asked = calibrate == "on" or (calibrate == "auto" and scans.camera.trust == Trust.GUESS)
    calibrated = method == "bundle" and asked
    if calibrate == "on" and method != "bundle":
        LOG.warning("calibrate: on needs refine: bundle; the camera stays as it was given")

    def make() -> Arrays:
        # A run with refined poses in the cache does not import these libraries.
        from miniloop_cli.refinement.joint import refine_jointly

        give_back_freed_memory()
        found = refine_jointly(poses, inside, inputs, method, bundle, run.workers, between, calibrated)
        seen = found.landmarks
        columns = {
            "T_world_cam": found.poses.T_world_cam,
            "component": found.poses.component,
            "covariance": found.covariance,
            "timing_s": np.array([found.timing.readout_s, found.timing.lag_s]),
            "points": seen.points_world,
            "point": seen.point,
            "frame": seen.frame,
            "px": seen.px,
            **_columns(found.calibration),
        }
        return columns if found.velocity is None else columns | {"velocity": found.velocity}

    key = (
        scans.key,
        scans.stamps_s,
        scans.depth_stamps_s,
        inputs.accelerometer,
        poses,
        inside,
        method,
        bundle,
        between,
        *((scans.camera.trust,) if calibrated else ()),
        *((two.given, two.free) if two else ()),
    )
    kept = run.store.cached(REFINED, key, make)
    timing = Timing(*kept["timing_s"].tolist())
    landmarks = Landmarks(*(kept[name] for name in ("points", "point", "frame", "px")))
    poses = Poses(kept["T_world_cam"], kept["component"])
    return Refined(poses, kept["covariance"], timing, landmarks, kept.get("velocity"), _calibration(kept, inputs))


def _columns(found: Calibration | None) -> Arrays:
    if found is None:
        return {}
    numbers = np.array([found.middle_m, found.gain, found.gain_sigma, found.scale_sigma, found.sigma_factor])
    columns = {"theta": found.theta, "theta_covariance": found.covariance, "theta_status": found.status}
    return columns | {"calibration": numbers}


def _calibration(kept: Arrays, scans: Scans) -> Calibration | None:
    """The calibration from `_columns`; None if calibration was not requested, or not possible."""
    if "theta" not in kept:
        return None
    theta, covariance, status = kept["theta"], kept["theta_covariance"], kept["theta_status"]
    given = scans.two.given if scans.two else None
    *numbers, sigma_factor = kept["calibration"].tolist()
    found = Calibration(scans.camera, theta, covariance, status, *numbers)
    return replace(found, depth_given=given, sigma_factor=sigma_factor)
