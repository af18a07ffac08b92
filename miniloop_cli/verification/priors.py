"""Edges judged by what is known of the frames beside their images."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from miniloop_cli.config import Settings
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.scene.priors import Priors, Vertical
from miniloop_cli.verification.gravity import checked, with_gravity
from miniloop_cli.verification.pose_prior import reject_by_pose_prior

LOG = logging.getLogger("miniloop")


def apply_priors(
    edges: list[Edge],
    priors: Priors,
    matches: Matches,
    points: Sequence[ScanPoints],
    settings: Settings,
    seed: int,
    workers: Workers,
) -> tuple[list[Edge], Vertical | None, tuple[str, ...]]:
    """The edges after gravity and rough poses, where they were given; the vertical; and what is to be said of it.

    Raises InputError for an accelerometer or for rough poses that most edges contradict.
    """
    notes, vertical = [], None
    if priors.accelerometer is not None:
        vertical, note = checked(edges, priors.accelerometer, settings.gravity)
        notes.append(note)
        if vertical is None:
            LOG.warning("%s", note)
        else:
            LOG.info("%s", note)
            edges = with_gravity(edges, vertical, matches, points, settings, seed, workers)
    if priors.T_world_cam is not None:
        edges = reject_by_pose_prior(edges, priors.T_world_cam, settings.pose_prior)
        against = sum("rough poses" in edge.reason for edge in edges)
        notes.append(f"rough poses are used: {against} edges contradict them")
        LOG.info("%s", notes[-1])
    return edges, vertical, tuple(notes)
