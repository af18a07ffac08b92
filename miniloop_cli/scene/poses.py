"""One pose a scan, and the edges that they rest on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import VERIFIED, WEAK, Edge, pairs_of
from miniloop_cli.typing import Floats, Ints

FEW_EDGES = 3  # a scan that hangs on fewer verified edges may use its weak ones


@dataclass(frozen=True)
class Poses:
    """T_world_cam (n, 4, 4), one world a component; component (n,) int, 0 the largest, -1 a scan without any edge."""

    T_world_cam: Floats
    component: Ints

    @property
    def registered(self) -> Ints:
        """Scans of the largest component, ascending."""
        return np.flatnonzero(self.component == 0)


def usable_edges(edges: Sequence[Edge], count: int) -> list[Edge]:
    """Verified edges, and the weak ones of scans that would hang on fewer than three."""
    few = np.bincount(pairs_of([e for e in edges if e.verdict == VERIFIED]).ravel(), minlength=count) < FEW_EDGES
    return [e for e in edges if e.verdict == VERIFIED or (e.verdict == WEAK and (few[e.i] or few[e.j]))]


def residuals(edges: Sequence[Edge], T_world_cam: Floats) -> tuple[Floats, Floats]:
    """Of each edge against the poses: rotation (m,) degrees, translation (m,) metres."""
    if not edges:
        return np.zeros(0), np.zeros(0)
    i, j = pairs_of(edges).T
    expected, measured = se3.inverse(T_world_cam[j]) @ T_world_cam[i], np.array([e.T_j_i for e in edges])
    rotation = expected[:, :3, :3] @ np.swapaxes(measured[:, :3, :3], 1, 2)
    return se3.rotation_angle_deg(rotation), np.linalg.norm(expected[:, :3, 3] - measured[:, :3, 3], axis=1)
