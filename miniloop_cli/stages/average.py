"""Stage: absolute poses from the edges, which are judged again by what their scans show and by each other."""

from __future__ import annotations

import numpy as np

from miniloop_cli.config import Averaging, Ransac
from miniloop_cli.runtime.artifact_store import Arrays
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.stages.artifacts import REPETITION
from miniloop_cli.stages.run import Run
from miniloop_cli.verification.consensus import average_verified
from miniloop_cli.verification.photometric_check import PhotometricCheck
from miniloop_cli.verification.repetition import pattern_steps_m


def photometric_check(scans: ScanSet, ransac: Ransac, chi2: float, run: Run) -> PhotometricCheck:
    """What the scans show beside their matches; their repetition from the store, or made now."""

    def make() -> Arrays:
        return {"step_m": np.array(pattern_steps_m(scans, ransac, chi2, run.workers))}

    step_m = run.store.cached(REPETITION, (scans.key, ransac, chi2), make)["step_m"]
    outline = [features.outline for features in scans.features]
    return PhotometricCheck(scans.thumbnails, scans.points, outline, step_m, scans.camera)


def average(
    edges: EdgeTable, scans: ScanSet, settings: Averaging, photometric: PhotometricCheck | None
) -> tuple[Poses, EdgeTable]:
    """Poses of all scans, and the judged edges; `photometric`: what the scans show, None if that is not to be asked."""
    return average_verified(edges, len(scans), settings, photometric)
