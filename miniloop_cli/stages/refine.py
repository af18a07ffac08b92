"""Refined poses as an artefact: what they are made from, and what is kept of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.averaging.components import beginning
from miniloop_cli.config import Settings
from miniloop_cli.refinement.inputs import Refined, Scans
from miniloop_cli.runtime.artifact_store import Arrays, Store, content_fingerprint, fingerprint
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge
from miniloop_cli.scene.poses import Poses, usable_edges
from miniloop_cli.scene.timing import Timing
from miniloop_cli.stages.serialization import edges_fingerprint


def refined(
    poses: Poses, edges: Sequence[Edge], scans: Scans, scans_key: str, settings: Settings, store: Store,
    workers: Workers,
) -> Refined:  # fmt: skip
    """Poses of the largest component refined from the edges used in it; the others as they are.

    `scans_key` names the scans' features. What comes out depends on which edges are believed, not on how they were
    averaged (`beginning`): a run with other settings that believes the same edges finds it in the store.
    """
    count, of_largest = len(poses.component), poses.component == 0
    inside = [e for e in usable_edges(edges, count) if of_largest[e.i] and of_largest[e.j]]
    if settings.refine == "none" or not inside:
        from miniloop_cli.refinement.joint import level

        return Refined(level(poses, scans)[0], np.full((count, 6, 6), np.nan))
    how = [settings.refine, settings.bundle.model_dump()]
    stamps = content_fingerprint([scans.stamps_s, scans.depth_stamps_s])
    sensor = scans.accelerometer
    felt = [sensor.stamps_s, sensor.readings, sensor.up] if sensor else []
    key = fingerprint("refined", scans_key, stamps, content_fingerprint(felt), edges_fingerprint(inside), how)

    def make() -> Arrays:
        # A run that finds refined poses in the store needs none of the libraries that make them.
        from miniloop_cli.refinement.joint import refine

        found = refine(beginning(edges, count), inside, scans, settings, workers)
        timing = np.array([found.timing.readout_s, found.timing.lag_s])
        # The last bits depend on how a kernel was compiled; without them a zero has one sign, a point one rounding.
        T_world_cam = np.round(found.poses.T_world_cam, 12) + 0.0
        return {"T_world_cam": T_world_cam, "covariance": found.covariance, "timing_s": timing}

    kept = store.kept("refined", key, make)
    T_world_cam = np.where(of_largest[:, None, None], kept["T_world_cam"], poses.T_world_cam)
    return Refined(Poses(T_world_cam, poses.component), kept["covariance"], Timing(*kept["timing_s"].tolist()))
