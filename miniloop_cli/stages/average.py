"""Stage: absolute poses from the edges, which are judged again by the views of their scans and by each other."""

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
    """The photometric check of the scans; their repetition comes from the cache or is computed."""

    def make() -> Arrays:
        return {"step_m": np.array(pattern_steps_m(scans, ransac, chi2, run.workers))}

    step_m = run.store.cached(REPETITION, (scans.key, ransac, chi2), make)["step_m"]
    outline = [features.outline for features in scans.features]
    return PhotometricCheck(scans.thumbnails, scans.points, outline, step_m, scans.camera)


def average(
    edges: EdgeTable, scans: ScanSet, settings: Averaging, photometric: PhotometricCheck | None, run: Run
) -> tuple[Poses, EdgeTable]:
    """Poses of all scans, and the judged edges; `photometric`: None if views are not to be compared."""
    return average_verified(edges, len(scans), settings, photometric, run.workers.threads)
