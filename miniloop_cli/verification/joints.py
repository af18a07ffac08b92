"""Checks of joined recordings: their common views, other poses for a whole recording, and steps that bend.

Each recording was registered by itself, and is treated as one rigid body here, which edges join to the others. Places
that look alike can join recordings of different rooms, and no loop through time contradicts that. Only the views where
they overlap, and edges that place the body elsewhere, can contradict it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.typing import Floats, Ints, Pair
from miniloop_cli.verification.photometric_check import PhotometricCheck
from miniloop_cli.verification.second_best import Elsewhere, placements_elsewhere

SIMILAR_DEG = 30.0  # from more different directions, even the same place looks different
MIN_PAIRS = 5  # of scans, needed to compare two bodies


def votes_of_joints(T_world_cam: Floats, scans: Ints, body: Ints, photometric: PhotometricCheck) -> Mapping[Pair, Ints]:
    """Numbers (2,) of cells that agree and that disagree between two bodies, by their poses; a < b.

    T_world_cam (n, 4, 4) and body (n,) of all scans. The `scans`, all of one world, are compared in pairs that look in
    similar directions. Bodies with fewer than MIN_PAIRS such pairs are left out.
    """
    pairs, T_j_i = photometric.neighbours(T_world_cam, scans, body)
    similar = se3.rotation_angle_deg(T_j_i[:, :3, :3]) < SIMILAR_DEG
    pairs, T_j_i = pairs[similar], T_j_i[similar]
    ends = np.sort(body[pairs], axis=1)
    votes = photometric.votes(pairs, T_j_i)
    bodies, times = np.unique(ends, axis=0, return_counts=True)
    compared = bodies[times >= MIN_PAIRS].tolist()
    return {(a, b): votes[(ends == (a, b)).all(axis=1)].sum(axis=0) for a, b in compared}


def bodies_elsewhere(
    T_world_cam: Floats, body: Ints, here: EdgeTable, others: EdgeTable, settings: Averaging
) -> list[Elsewhere]:
    """Bodies with another pose of nearly as much support; the `scans` of the results are numbers of bodies.

    T_world_cam (n, 4, 4) and body (n,) of all scans; `here`: edges between bodies that agree with the poses; `others`:
    those that contradict them; all of one world.
    """
    if not len(others):
        return []
    T_body = np.tile(np.eye(4), (int(body.max()) + 1, 1, 1))
    for number in np.unique(body):
        T_body[number, :3, 3] = T_world_cam[body == number, :3, 3].mean(axis=0)

    def of_bodies(edges: EdgeTable) -> EdgeTable:
        i, j = body[edges.i], body[edges.j]
        T = se3.inverse(T_body[j]) @ T_world_cam[edges.j] @ edges.T_j_i @ se3.inverse(T_world_cam[edges.i]) @ T_body[i]
        return replace(edges, i=i, j=j, T_j_i=T)

    there = of_bodies(others)
    joined = np.unique(np.concatenate([body[here.pairs].ravel(), there.pairs.ravel()]))
    return placements_elsewhere(T_body, joined, of_bodies(here), there, settings, settings.min_bridge_inliers)


@dataclass(frozen=True)
class Bend:
    """Two successive scans a, b of a body whose relative pose the others changed, by this much."""

    a: int
    b: int
    angle_deg: float
    distance_m: float


def bends(T_world_cam: Floats, T_own: Floats, body: Ints, settings: Averaging) -> dict[int, Bend]:
    """The worst step between successive scans, for each body whose shape changed when it was joined.

    T_world_cam (n, 4, 4) as joined, T_own (n, 4, 4) with each body in its own world, body (n,). Steps may change by the
    largest residual of an edge.
    """
    found = dict[int, Bend]()
    a = np.flatnonzero(body[:-1] == body[1:])
    step, own = (se3.inverse(T[a]) @ T[a + 1] for T in (T_world_cam, T_own))
    angle_deg, distance_m = se3.angle_and_distance(se3.inverse(own) @ step)
    size = np.maximum(angle_deg / settings.max_residual_deg, distance_m / settings.max_residual_m)
    for k in np.argsort(size, kind="stable"):
        if size[k] > 1:
            found[int(body[a[k]])] = Bend(int(a[k]), int(a[k]) + 1, float(angle_deg[k]), float(distance_m[k]))
    return found
