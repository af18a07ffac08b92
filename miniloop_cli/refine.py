"""The joint refinement of all poses: by bundle adjustment over feature tracks, or over the edges of the graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Settings
from miniloop_cli.features.lift import ScanFeatures
from miniloop_cli.graph.edges import VERIFIED, Edge
from miniloop_cli.parallel import Workers
from miniloop_cli.poses import Poses
from miniloop_cli.refinement.bundle import bundle_adjust
from miniloop_cli.refinement.tracks import build_tracks
from miniloop_cli.scans.camera import Camera

Floats = NDArray[np.float64]


def refine(
    poses: Poses,
    edges: Sequence[Edge],
    features: Sequence[ScanFeatures],
    camera: Camera,
    settings: Settings,
    workers: Workers,
) -> tuple[Poses, Floats]:
    """Refined poses and their covariances (n, 6, 6); NaN where there is none."""
    nothing = np.full((len(features), 6, 6), np.nan)
    if settings.refine == "none":
        return poses, nothing
    inside = [e for e in edges if e.verdict == VERIFIED and poses.component[e.i] == 0]
    offsets = np.cumsum([0] + [len(found) for found in features])
    tracks = build_tracks(offsets, [(e.i, e.j) for e in inside], [e.matches[e.inliers] for e in inside])
    rows = offsets[tracks.frame] + tracks.feature
    px_ideal = np.concatenate([found.px_ideal for found in features])[rows]
    z_m = np.concatenate([found.z_m for found in features])[rows]
    result = bundle_adjust(poses.T_world_cam, tracks.frame, tracks.track, px_ideal, z_m, camera, jobs=2)
    return Poses(result.T_world_cam, poses.component), nothing
