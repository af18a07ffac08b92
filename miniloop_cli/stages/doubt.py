"""Stage: what speaks against poses that are done, in notes that make the result doubtful."""

from __future__ import annotations

from collections.abc import Sequence as Many

import numpy as np

from miniloop_cli.config import Averaging
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.sequence import Note, NoteKind, Sequence
from miniloop_cli.scene.tracked import Tracked
from miniloop_cli.verification.motion import gaps_before, impossible_steps
from miniloop_cli.verification.photometric_check import PhotometricCheck


def doubt(
    poses: Poses,
    hypotheses: Many[EdgeTable],
    scans: ScanSet,
    whole: Sequence,
    tracked: Tracked | None,
    settings: Averaging,
    photometric: PhotometricCheck | None,
) -> tuple[Note, ...]:
    """The doubts about the poses of the scans, from all that was estimated of pairs, believed or not.

    `whole`: the recording, of which the scans are the keyframes where it was `tracked`.
    """
    frames = tracked.keyframes if tracked else np.arange(len(scans))
    late = gaps_before(whole.stamps_s)
    gaps = np.array([late[a + 1 : b + 1].any() for a, b in zip([-1, *frames[:-1]], frames, strict=True)], bool)
    steps = impossible_steps(
        poses.T_world_cam,
        poses.registered,
        scans.stamps_s,
        gaps,
        usual_depth_m(scans),
        hypotheses,
        settings,
        photometric,
    )
    return tuple(Note(NoteKind.IMPOSSIBLE_MOTION, step.sentence(frames)) for step in steps)


def usual_depth_m(scans: ScanSet) -> float:
    """Median over the scans of the median depth of their points; infinite without any."""
    medians = [float(np.median(points.points_m[:, 2])) for points in scans.points if len(points.points_m)]
    return float(np.median(medians)) if medians else float("inf")
