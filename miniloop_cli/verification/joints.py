"""What speaks against how recordings were joined: what both show, other places for a whole one, steps that bend.

Each recording was registered by itself, and is taken for one rigid body here. Edges to the others say where it stands.
Places that look alike can join recordings of different rooms, and no loop through time contradicts that: only what
both show where they overlap, and edges that say that the body stands elsewhere.
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

SIMILAR_DEG = 30.0  # from more different sides even one place looks different: other surfaces, other light
MIN_PAIRS = 5  # of scans, to say anything of two bodies


def votes_of_joints(T_world_cam: Floats, scans: Ints, body: Ints, photometric: PhotometricCheck) -> Mapping[Pair, Ints]:
    """Cells (2,) of the pictures of two bodies that agree and that disagree, by their poses; a < b.

    T_world_cam (n, 4, 4) and body (n,) of all scans; compared are the `scans`, which lie in one world, where they look
    in similar directions. Bodies of which fewer than MIN_PAIRS do are left out.
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
    """Bodies that could stand elsewhere with nearly as much support; their numbers are the `scans` of what is found.

    T_world_cam (n, 4, 4) and body (n,) of all scans, `here`: edges between bodies that agree with the poses, `others`:
    that contradict them, all of one world.
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
    """Of each body that is not as it was by itself, the worst step between its successive scans.

    T_world_cam (n, 4, 4) as joined, T_own (n, 4, 4) each body in a world of its own, body (n,). Steps may change by
    what edges may be off.
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
