"""From the residuals of point terms to a gradient and a Hessian a row, for the elimination of the points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from miniloop_cli.refinement.robust import weight_and_curvature
from miniloop_cli.refinement.terms import NEAR_M, PointTerm
from miniloop_cli.runtime.blocks import BLOCK, ONE_THREAD, Blocks
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Bools, Floats, Ints

LEAST_CURVATURE = 0.25  # of the weights': for large residuals, the curvature of the kernels is too small or negative


class PointEquations(NamedTuple):
    """Points p_cam (3, k) m of all observations; gradient (k, 3) and Hessian (k, 3, 3) of the cost by them."""

    p_cam: Floats
    gradient: Floats
    hessian: Floats

    def subset(self, kept: Bools) -> PointEquations:
        """Those of the rows that are kept (k,)."""
        return PointEquations(np.ascontiguousarray(self.p_cam[:, kept]), self.gradient[kept], self.hessian[kept])

    @contextmanager
    def silent(self, rows: Ints) -> Iterator[PointEquations]:
        """These equations with some rows zero meanwhile; a copy takes hundreds of megabytes for a long recording."""
        gradient, hessian = self.gradient[rows], self.hessian[rows]
        self.gradient[rows], self.hessian[rows] = 0.0, 0.0
        try:
            yield self
        finally:
            self.gradient[rows], self.hessian[rows] = gradient, hessian


class _Weighted(NamedTuple):
    """A block of rows of a term: residuals (d, k), derivatives (d, 3, k), weights (k,) of its kernel; two sums."""

    residual: Floats
    jacobian: Floats
    weight: Floats
    curvature: float
    cost: float


def point_equations(
    terms: Sequence[PointTerm], p_cam: Floats, least_curvature: float = LEAST_CURVATURE, blocks: Blocks = ONE_THREAD
) -> tuple[PointEquations, float]:
    """The equations of all terms at the points p_cam (3, k), and the cost.

    The Hessian of a term uses the mean curvature of its kernel, at least `least_curvature` times that of its weights.
    Steps with the weights alone (iteratively reweighted least squares) are a quarter to a half too short.
    """
    rows = p_cam.shape[1]
    gradient, hessian, cost = np.zeros((rows, 3)), np.zeros((rows, 3, 3)), 0.0
    for term in terms:
        parts = blocks.map(_weighted, rows, term, p_cam)
        cost += sum(part.cost for part in parts)
        weights = sum(float(part.weight.sum()) for part in parts)
        share = max(sum(part.curvature for part in parts) / max(weights, 1e-12), least_curvature)
        blocks.map(_add, rows, parts, share, gradient, hessian)
    return PointEquations(p_cam, gradient, hessian), cost


def _weighted(low: int, high: int, term: PointTerm, p_cam: Floats) -> _Weighted:
    """Rows low..high - 1 of a term at the points p_cam (3, k)."""
    p_cam = p_cam[:, low:high]
    residual, jacobian = (np.ascontiguousarray(found) for found in term.of(slice(low, high)).linearise(p_cam))
    s = (residual**2).sum(axis=0)
    measured = np.isfinite(s)
    weight, curvature = weight_and_curvature(term.robust.kernel, s, term.robust.scale, len(residual))
    counts = measured & (p_cam[2] >= NEAR_M)
    cost = 0.5 * float(term.robust.cost(s[measured]).sum())
    return _Weighted(residual, jacobian, np.where(counts, weight, 0.0), float(curvature[counts].sum()), cost)


def _add(low: int, high: int, parts: list[_Weighted], share: float, gradient: Floats, hessian: Floats) -> None:
    """Add the products of rows low..high - 1 to gradient (k, 3) and hessian (k, 3, 3)."""
    part = parts[low // BLOCK]
    _add_products(part.residual, part.jacobian, part.weight, share, gradient[low:high], hessian[low:high])


@njit(cache=True, nogil=True, error_model="numpy")
def _add_products(
    residual: Floats, jacobian: Floats, weight: Floats, share: float, gradient: Floats, hessian: Floats
) -> None:
    """gradient += J^T w r, hessian += share J^T w J, of residuals (d, k) and their derivatives (d, 3, k)."""
    for k in range(len(weight)):
        if weight[k] == 0.0:
            continue
        for i in range(len(residual)):
            for a in range(3):
                weighted = weight[k] * jacobian[i, a, k]
                gradient[k, a] += weighted * residual[i, k]
                for b in range(3):
                    hessian[k, a, b] += share * weighted * jacobian[i, b, k]
