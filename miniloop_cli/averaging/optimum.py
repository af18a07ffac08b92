"""The best arrangement of the edges with fixed robust weights, for each component, and its certificate."""

from __future__ import annotations

import logging

import numpy as np

from miniloop_cli.averaging.certificate import Bound, bound, escaped
from miniloop_cli.averaging.fill_in import factor_work
from miniloop_cli.averaging.quadratic_form import EdgeWeights, QuadraticForm
from miniloop_cli.averaging.stiefel import cost, minimise
from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.scene.certificate import Certificate
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses, usable_edges
from miniloop_cli.typing import Floats, Ints

LOG = logging.getLogger("miniloop")
MOST_WORK = 3e8  # multiplications of a factor with one row a scan; with four rows it takes ten seconds
LOWER = 0.999  # of the cost: another minimum is better if it is below


def prove_optimum(poses: Poses, edges: EdgeTable, settings: Averaging) -> tuple[Poses, Certificate]:
    """The poses, and the certificate of the minimum that they belong to.

    The cost is that of the edges used in a component, with the weights that averaging's robust kernels give them at its
    poses, isotropic for each edge (see EdgeWeights). The poses are unchanged unless a better minimum than theirs is
    found; then they are those of that minimum.
    """
    used = usable_edges(edges, len(poses.component)) & (poses.component[edges.i] >= 0)
    T, optimum, bounds, left = poses.T_world_cam.copy(), poses.T_world_cam.copy(), [], False
    for number in range(poses.component.max(initial=-1) + 1):
        scans = np.flatnonzero(poses.component == number)
        inside = used & (poses.component[edges.i] == number)
        pairs = np.searchsorted(scans, edges.pairs[inside])
        work = factor_work(len(scans), pairs, MOST_WORK)
        if work > MOST_WORK:
            problem = (
                f"the graph of {len(scans)} scans and {len(pairs)} edges is too densely connected for the proof, which "
                f"takes {work / MOST_WORK:.2g} times the work that it may take"
            )
            return poses, Certificate(False, float("nan"), poses, problem=problem)
        graph = _Component(pairs, edges.T_j_i[inside], edges.information[inside], settings)
        begun, optimum[scans], found = graph.proven(T[scans])
        left = left or begun is not None
        T[scans] = T[scans] if begun is None else begun
        bounds.append(found)
    if left:
        LOG.info("averaging ended in a minimum that is not the lowest: a better arrangement of the edges was found")
    total = sum(one.cost for one in bounds)
    gap = sum(one.cost * one.gap for one in bounds) / total if total > 0 else 0.0
    certified = all(one.certified for one in bounds)
    gap = float(f"{gap:.3g}")  # further digits are those of rounding
    return Poses(T, poses.component), Certificate(certified, gap, Poses(optimum, poses.component), left)


class _Component:
    """A connected graph: pairs (m, 2), T_j_i (m, 4, 4), information (m, 6, 6)."""

    def __init__(self, pairs: Ints, T_j_i: Floats, information: Floats, settings: Averaging) -> None:
        self.pairs, self.T_j_i, self.settings = pairs, T_j_i, settings
        self.isotropic = EdgeWeights.of(T_j_i, information)

    def proven(self, T_world_cam: Floats) -> tuple[Floats | None, Floats, Bound]:
        """Poses (n, 4, 4) of a better minimum or None; those of the best one; and its bound."""
        form, Y, found = self._lowest_from(T_world_cam)
        begun = None
        if found.way_out is not None:
            other = escaped(form, Y, found.way_out)
            if cost(form, other) < LOWER * found.cost:
                begun = form.poses(other)
                form, Y, found = self._lowest_from(begun)
        return begun, form.poses(Y), found

    def _lowest_from(self, T: Floats) -> tuple[QuadraticForm, Floats, Bound]:
        form = QuadraticForm.of(len(T), self.pairs, self.T_j_i, self._robust(T))
        Y = minimise(form, form.rows(T)).Y
        return form, Y, bound(form, Y)

    def _robust(self, T: Floats) -> EdgeWeights:
        """The weights times those of averaging's kernels at the poses T: Geman-McClure's and Cauchy's."""
        settings, ones = self.settings, np.ones(len(self.pairs))
        T_i, T_j_in_i = T[self.pairs[:, 0]], T[self.pairs[:, 1]] @ self.T_j_i
        angle_deg = se3.rotation_angle_deg(np.swapaxes(T_i, 1, 2)[:, :3, :3] @ T_j_in_i[:, :3, :3])
        c = np.concatenate([self.isotropic.c_i, ones[:, None]], axis=1)
        distance_m = np.linalg.norm(np.einsum("mab,mb->ma", T_i - T_j_in_i, c)[:, :3], axis=1)
        rotation = 1 / (1 + (angle_deg / settings.rotation_scale_deg) ** 2) ** 2
        translation = 1 / (1 + (distance_m / settings.translation_scale_m) ** 2)
        return self.isotropic.times(
            rotation if settings.rotations == "robust" else ones,
            translation if settings.translations == "robust" else ones,
        )
