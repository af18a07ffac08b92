"""One pose a scan from the edges between them: rotations averaged, then translations, one world a component."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.averaging.rotations import average_rotations
from miniloop_cli.averaging.translations import average_translations
from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import Edge, pairs_of
from miniloop_cli.scene.poses import Poses, usable_edges
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Floats, Ints


def average_components(edges: Sequence[Edge], count: int, settings: Averaging) -> Poses:
    """Poses of the scans of every component of these edges, all of which are believed."""
    T, label = np.tile(np.eye(4), (count, 1, 1)), components(count, pairs_of(edges))
    component = np.where(np.bincount(label)[label] > 1, label, -1)  # lone scans come last
    for number in range(component.max(initial=-1) + 1):
        scans = np.flatnonzero(component == number)
        T[scans] = _average_component([e for e in edges if component[e.i] == number], scans, settings)
    return Poses(T, component)


def beginning(edges: Sequence[Edge], count: int) -> Poses:
    """Where a second look and refinement begin: the edges that are used, averaged with the default settings.

    What is made from it then depends on which edges are believed alone, whatever the settings that led to them.
    """
    return average_components(usable_edges(edges, count), count, Averaging())


def _average_component(edges: Sequence[Edge], scans: Ints, settings: Averaging) -> Floats:
    pairs = np.searchsorted(scans, pairs_of(edges))
    T_j_i = np.array([e.T_j_i for e in edges])
    inliers = np.array([e.inlier_count for e in edges], float)
    robust = settings.rotations == "robust"
    R = average_rotations(
        len(scans),
        pairs,
        T_j_i[:, :3, :3],
        inliers if robust else None,
        start="votes" if robust else "tree",
        scale_deg=settings.rotation_scale_deg,
    ).R_world_cam
    t_j_i, weights = _translations_given_rotations(edges, T_j_i, R, pairs)
    robust = settings.translations == "robust"
    t = average_translations(
        R, pairs, t_j_i, weights if robust else inliers, robust=robust, scale_m=settings.translation_scale_m
    ).t_world_cam
    return se3.pose(R, t)


def _translations_given_rotations(
    edges: Sequence[Edge], T_j_i: Floats, R_world_cam: Floats, pairs: Ints
) -> tuple[Floats, Floats]:
    """The translations that satisfy an edge's correspondences best once its rotation is the averaged one.

    With w the rotation that averaging added, the information matrix gives v = -H_vv^-1 H_vw w: with equal isotropic
    noise this is the paper's least squares, t = mean(q) - R mean(p). Returns t (m, 3) and weights (m,) 1/m^2.
    """
    H = np.array([e.information for e in edges])
    R = np.swapaxes(R_world_cam[pairs[:, 1]], 1, 2) @ R_world_cam[pairs[:, 0]]
    w = se3.log_so3(R @ np.swapaxes(T_j_i[:, :3, :3], 1, 2))
    v = -np.linalg.solve(H[:, 3:, 3:], np.einsum("mij,mj->mi", H[:, 3:, :3], w)[..., None])[..., 0]
    t = np.einsum("mij,mj->mi", se3.exp_so3(w), T_j_i[:, :3, 3]) + v
    return t, np.trace(np.linalg.inv(H[:, 3:, 3:]), axis1=1, axis2=2) ** -1.0
