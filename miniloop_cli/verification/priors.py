"""Edges judged by priors: gravity and rough poses."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from miniloop_cli.config import Settings
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.scene.priors import Priors, Vertical
from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.scene.verdict import Rejection
from miniloop_cli.verification.gravity import checked, with_gravity
from miniloop_cli.verification.pose_prior import reject_by_pose_prior

LOG = logging.getLogger("miniloop")


def apply_priors(
    edges: EdgeTable,
    priors: Priors,
    matches: Matches,
    points: Sequence[ScanPoints],
    settings: Settings,
    seed: int,
    workers: Workers,
) -> tuple[EdgeTable, Vertical | None, tuple[Note, ...]]:
    """The edges after gravity and a pose prior, if these are given; the vertical; and notes.

    Raises InputError for an accelerometer or for a pose prior that most edges contradict.
    """
    notes, vertical = [], None
    if priors.accelerometer is not None:
        vertical, note = checked(edges, priors.accelerometer, settings.gravity)
        notes.append(note)
        if vertical is None:
            LOG.warning("%s", note)
        else:
            LOG.info("%s", note)
            edges = with_gravity(edges, vertical, matches, points, settings.estimation, settings.gravity, seed, workers)
    if priors.T_world_cam is not None:
        edges = reject_by_pose_prior(edges, priors.T_world_cam, settings.pose_prior)
        against = int((edges.rejection == Rejection.CONTRADICTS_POSE_PRIOR).sum())
        notes.append(f"pose prior is used: {against} edges contradict it")
        LOG.info("%s", notes[-1])
    return edges, vertical, tuple(Note(NoteKind.PRIOR, text) for text in notes)
