"""Stage: checks of the final poses; each finding is a note that makes the result doubtful."""

from __future__ import annotations

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.runtime.artifact_store import Arrays
from miniloop_cli.scene.edge import FOLLOWED, EdgeTable
from miniloop_cli.scene.poses import Poses, residuals
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.sequence import Note, NoteKind, Sequence
from miniloop_cli.scene.tracked import Tracked
from miniloop_cli.stages.artifacts import SECOND_MODES
from miniloop_cli.stages.run import Run
from miniloop_cli.verification.gating import check_scans
from miniloop_cli.verification.motion import gaps_before, impossible_steps
from miniloop_cli.verification.photometric_check import PhotometricCheck
from miniloop_cli.verification.second_best import placements_elsewhere
from miniloop_cli.verification.second_modes import second_modes


def doubt(
    poses: Poses,
    solved: EdgeTable,
    edges: EdgeTable,
    scans: ScanSet,
    whole: Sequence,
    tracked: Tracked | None,
    settings: Settings,
    photometric: PhotometricCheck | None,
    run: Run,
) -> tuple[Note, ...]:
    """The doubts about the poses of the scans.

    `solved`: the edges as estimated from their matches; `edges`: as judged in the end. `whole`: the recording, whose
    keyframes are the scans if it was `tracked`.
    """
    frames = tracked.keyframes if tracked else np.arange(len(scans))
    late = gaps_before(whole.stamps_s)
    gaps = np.array([late[a + 1 : b + 1].any() for a, b in zip([-1, *frames[:-1]], frames, strict=True)], bool)
    T, registered, averaging = poses.T_world_cam, poses.registered, settings.averaging
    here, others = hypotheses(poses, solved, edges, scans, settings, photometric, run)
    steps = impossible_steps(
        T, registered, scans.stamps_s, gaps, usual_depth_m(scans), (others, solved, edges), averaging, photometric
    )
    elsewhere = placements_elsewhere(T, registered, here, others, averaging, averaging.min_bridge_inliers)
    return (
        *(Note(NoteKind.IMPOSSIBLE_MOTION, step.sentence(frames)) for step in steps),
        *(Note(NoteKind.AMBIGUOUS, part.sentence(frames)) for part in elsewhere),
    )


def hypotheses(
    poses: Poses,
    solved: EdgeTable,
    edges: EdgeTable,
    scans: ScanSet,
    settings: Settings,
    photometric: PhotometricCheck | None,
    run: Run,
) -> tuple[EdgeTable, EdgeTable]:
    """Hypotheses about pairs of the largest component that their matches and images support: those that agree with the
    poses, and those that contradict them, including second modes.

    Results of guided matching take no part, as they depend on the poses.
    """
    followed = edges.edges_of(edges.solver == FOLLOWED)
    alone = _seen(solved.replaced(followed) if followed else solved, settings, photometric)
    alone = alone.subset(alone.verified & poses.joins(alone))
    angle_deg, distance_m = residuals(alone, poses.T_world_cam)
    limits = settings.averaging.max_residual_deg, settings.averaging.max_residual_m
    off = (angle_deg > limits[0]) | (distance_m > limits[1])
    here = alone.subset(~off)

    def make() -> Arrays:
        return second_modes(here, scans.points, settings.estimation, settings.averaging, run.seed, run.workers).arrays()

    inputs = (scans.key, here, settings.estimation, settings.averaging, run.seed)
    second = _seen(EdgeTable.from_arrays(run.store.cached(SECOND_MODES, inputs, make)), settings, photometric)
    return here, EdgeTable.of([*alone.edges_of(off), *second.edges_of(second.verified)])


def _seen(edges: EdgeTable, settings: Settings, photometric: PhotometricCheck | None) -> EdgeTable:
    """The edges without those that the views of their scans contradict."""
    if photometric is None or not len(edges):
        return edges
    return check_scans(edges, photometric, settings.averaging.min_photo_consistency)


def usual_depth_m(scans: ScanSet) -> float:
    """Median over the scans of the median depth of their points; infinite without points."""
    medians = [float(np.median(points.points_m[:, 2])) for points in scans.points if len(points.points_m)]
    return float(np.median(medians)) if medians else float("inf")
