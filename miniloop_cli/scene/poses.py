"""One pose a scan, and the edges that poses depend on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.typing import Bools, Floats, Ints

FEW_EDGES = 3  # a scan with fewer verified edges may use its weak ones


@dataclass(frozen=True)
class Poses:
    """T_world_cam (n, 4, 4), one world a component; component (n,) int, 0 the largest, -1 a scan without any edge."""

    T_world_cam: Floats
    component: Ints

    @property
    def registered(self) -> Ints:
        """Scans of the largest component, ascending."""
        return np.flatnonzero(self.component == 0)

    def of(self, scans: Ints) -> Poses:
        """The poses of some scans."""
        return Poses(self.T_world_cam[scans], self.component[scans])

    def joins(self, edges: EdgeTable) -> Bools:
        """(m,) whether an edge lies in the largest component."""
        return (self.component[edges.i] == 0) & (self.component[edges.j] == 0)


def usable_edges(edges: EdgeTable, count: int) -> Bools:
    """(m,) verified edges, and the weak ones of scans with fewer than FEW_EDGES verified ones."""
    few = np.bincount(edges.pairs[edges.verified].ravel(), minlength=count) < FEW_EDGES
    return edges.verified | ((edges.verdict == Verdict.WEAK) & (few[edges.i] | few[edges.j]))


def residuals(edges: EdgeTable, T_world_cam: Floats) -> tuple[Floats, Floats]:
    """Differences between edges and poses: rotations (m,) degrees, translations (m,) metres."""
    expected = se3.inverse(T_world_cam[edges.j]) @ T_world_cam[edges.i]
    rotation = expected[:, :3, :3] @ np.swapaxes(edges.T_j_i[:, :3, :3], 1, 2)
    distance = np.linalg.norm(expected[:, :3, 3] - edges.T_j_i[:, :3, 3], axis=1)
    return se3.rotation_angle_deg(rotation), distance
