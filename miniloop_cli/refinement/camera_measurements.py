"""Measurements of a camera that is not known exactly, and the bundle adjustment of a part of their tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry import depth_model
from miniloop_cli.geometry.camera_parameters import CameraParameters
from miniloop_cli.geometry.se3 import project_so3
from miniloop_cli.refinement.bundle import BundleSettings
from miniloop_cli.refinement.bundle_problem import Bundle
from miniloop_cli.refinement.free_depth_term import FreeDepthTerm
from miniloop_cli.refinement.free_pixel_term import FreePixelTerm
from miniloop_cli.refinement.free_terms import FreeTerm
from miniloop_cli.refinement.points import initial_points
from miniloop_cli.refinement.robust import Robust
from miniloop_cli.refinement.terms import PoseTerm
from miniloop_cli.refinement.track_rows import TrackRows
from miniloop_cli.refinement.two_cameras import ReadingChange
from miniloop_cli.typing import Bools, Floats, Ints


@dataclass(frozen=True)
class CameraMeasurements:
    """k rows sorted by track, then by frame: frame, track (k,), measured px (k, 2), z_m (k,) m or NaN; rho (k,).

    `change`: how z_m depends on the parameters of a separate depth camera, if there is one.
    """

    frame: Ints
    track: Ints
    px: Floats
    z_m: Floats
    rho: Floats
    change: ReadingChange | None = None

    @staticmethod
    def of(
        frame: Ints, track: Ints, px: Floats, z_m: Floats, size: tuple[int, int], change: ReadingChange | None = None
    ) -> CameraMeasurements:
        """Rows in any order, from images of this width and height; those without a finite pixel are left out."""
        order = np.lexsort((frame, track))
        order = order[np.isfinite(px[order]).all(axis=1)]
        edge = depth_model.rho(px[order], *size)
        change = change and change.subset(order)
        return CameraMeasurements(frame[order], track[order], px[order], z_m[order], edge, change)

    def subset(self, rows: Bools) -> CameraMeasurements:
        """The rows (k,) that are kept."""
        change = self.change and self.change.subset(rows)
        return CameraMeasurements(
            self.frame[rows], self.track[rows], self.px[rows], self.z_m[rows], self.rho[rows], change
        )


def free_bundle(
    T_world_cam: Floats,
    measured: CameraMeasurements,
    parameters: CameraParameters,
    settings: BundleSettings,
    jobs: int,
    pose_terms: Sequence[PoseTerm] = (),
) -> tuple[Bundle, list[FreeTerm], CameraMeasurements]:
    """The bundle at poses (n, 4, 4), its terms, and the measurements whose points the poses determine."""
    camera = parameters.camera
    ideal = camera.undistort(measured.px)
    z_m = measured.z_m if measured.change is None else measured.z_m + measured.change.step(parameters.theta)
    z_m = z_m + parameters.depth_step(z_m, measured.rho)
    origin = T_world_cam[:, :3, 3].mean(axis=0)
    R, t = np.ascontiguousarray(project_so3(T_world_cam[:, :3, :3])), T_world_cam[:, :3, 3] - origin
    count = int(measured.track.max(initial=-1)) + 1
    z_m = np.where(z_m > 0, z_m, np.nan)
    X, good = initial_points(R, t, measured.frame, measured.track, count, ideal, z_m, camera)
    kept = measured.subset(good[measured.track])
    tracks = TrackRows(np.searchsorted(kept.track, np.arange(count + 1)), kept.frame.astype(np.uint32))
    sigma_m = settings.depth_sigma_factor * camera.noise.sigma_m(np.where(np.isfinite(kept.z_m), kept.z_m, 1.0))
    of_pixels, of_depth = (Robust(settings.kernel, scale) for scale in (settings.scale_px, settings.scale_depth))
    terms: list[FreeTerm] = [
        FreePixelTerm(np.ascontiguousarray(kept.px.T), parameters, settings.sigma_px, of_pixels),
        FreeDepthTerm(kept.z_m, sigma_m, kept.rho, parameters, of_depth, kept.change),
    ]
    return Bundle(tracks, terms, pose_terms, R, t, X, origin, jobs, settings.least_curvature), terms, kept
