"""How well poses and a camera predict held-out tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miniloop_cli.geometry.camera_parameters import CameraParameters
from miniloop_cli.refinement.bundle import BundleSettings
from miniloop_cli.refinement.camera_measurements import CameraMeasurements, free_bundle
from miniloop_cli.typing import Floats

_POINT_STEPS, _DAMPING = 4, 1e-6


class HeldOut(NamedTuple):
    """The robust cost (p,) of each track, NaN where its point is not determined."""

    cost: Floats

    def gain_over(self, other: HeldOut) -> tuple[float, float]:
        """Relative decrease of the cost against another, and its standard deviation.

        Over the tracks that both determine, which are treated as independent.
        """
        both = np.isfinite(self.cost) & np.isfinite(other.cost)
        if both.sum() < 2:
            return 0.0, np.inf
        less, whole = other.cost[both] - self.cost[both], max(float(other.cost[both].sum()), 1e-12)
        return float(less.sum() / whole), float(less.std() * np.sqrt(both.sum()) / whole)


def held_out(
    T_world_cam: Floats, measured: CameraMeasurements, parameters: CameraParameters, settings: BundleSettings
) -> HeldOut:
    """The cost of tracks at fixed poses (n, 4, 4) and a fixed camera; only their points are fitted."""
    bundle, terms, kept = free_bundle(T_world_cam, measured, parameters, settings, 1)
    for _ in range(_POINT_STEPS):
        _, g, L = bundle.reduced(bundle.tracks, bundle.state.seen, _DAMPING)
        moved = bundle.moved(bundle.state.seen, np.zeros_like(g), L)
        if not moved.cost < bundle.state.cost:
            break
        bundle.state = moved
    cost = np.zeros(len(kept.track))
    for term in terms:
        s = (term.linearise(bundle.state.seen.p_cam)[0] ** 2).sum(axis=0)
        cost += np.where(np.isfinite(s), 0.5 * term.robust.cost(np.nan_to_num(s)), 0.0)
    count = int(measured.track.max(initial=-1)) + 1
    of_track = np.bincount(kept.track, cost, count)
    return HeldOut(np.where(np.bincount(kept.track, minlength=count) > 0, of_track, np.nan))
