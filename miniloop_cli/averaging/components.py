"""One pose a scan from the edges: averaged rotations, then translations, with one world for each component."""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.rotations import average_rotations
from miniloop_cli.averaging.translations import average_translations
from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.blocks import Blocks
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Floats, Ints


def average_components(edges: EdgeTable, count: int, settings: Averaging, jobs: int = 1) -> Poses:
    """Poses of the `count` scans, component by component, from accepted edges; the same bytes for any `jobs`."""
    T, label = np.tile(np.eye(4), (count, 1, 1)), components(count, edges.pairs)
    component = np.where(np.bincount(label)[label] > 1, label, -1)  # single scans come last
    with Blocks(jobs) as blocks:
        for number in range(component.max(initial=-1) + 1):
            scans = np.flatnonzero(component == number)
            T[scans] = _average_component(edges.subset(component[edges.i] == number), scans, settings, blocks)
    return Poses(T, component)


def _average_component(edges: EdgeTable, scans: Ints, settings: Averaging, blocks: Blocks) -> Floats:
    pairs = np.searchsorted(scans, edges.pairs)
    inliers = edges.inlier_count.astype(float)
    robust = settings.rotations == "robust"
    R = average_rotations(
        len(scans),
        pairs,
        edges.T_j_i[:, :3, :3],
        inliers if robust else None,
        start="votes" if robust else "tree",
        scale_deg=settings.rotation_scale_deg,
        blocks=blocks,
    ).R_world_cam
    t_j_i, weights = _translations_given_rotations(edges, R, pairs)
    robust = settings.translations == "robust"
    t = average_translations(
        R,
        pairs,
        t_j_i,
        weights if robust else inliers,
        robust=robust,
        scale_m=settings.translation_scale_m,
        blocks=blocks,
    ).t_world_cam
    return se3.pose(R, t)


def _translations_given_rotations(edges: EdgeTable, R_world_cam: Floats, pairs: Ints) -> tuple[Floats, Floats]:
    """The translations that fit an edge's correspondences best for its averaged rotation.

    With w the rotation that averaging added, the information matrix gives v = -H_vv^-1 H_vw w: with equal isotropic
    noise this is the paper's least squares, t = mean(q) - R mean(p). Returns t (m, 3) and weights (m,) 1/m^2.
    """
    H = edges.information
    R = np.swapaxes(R_world_cam[pairs[:, 1]], 1, 2) @ R_world_cam[pairs[:, 0]]
    w = se3.log_so3(R @ np.swapaxes(edges.T_j_i[:, :3, :3], 1, 2))
    v = -np.linalg.solve(H[:, 3:, 3:], np.einsum("mij,mj->mi", H[:, 3:, :3], w)[..., None])[..., 0]
    t = np.einsum("mij,mj->mi", se3.exp_so3(w), edges.T_j_i[:, :3, 3]) + v
    return t, np.trace(np.linalg.inv(H[:, 3:, 3:]), axis1=1, axis2=2) ** -1.0
