"""From the residuals of point terms to what the elimination of the points needs: a gradient and a Hessian a row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from miniloop_cli.refinement.robust import KERNELS, robust
from miniloop_cli.refinement.terms import NEAR_M, PointTerm
from miniloop_cli.typing import Bools, Floats

LEAST_CURVATURE = 0.25  # of the weights' own: where residuals are large, the kernels' is no guide


class PointEquations(NamedTuple):
    """Points p_cam (3, k) m of all observations; gradient (k, 3) and Hessian (k, 6) of the cost by them.

    A row of the Hessian holds the entries 00 01 02 11 12 22.
    """

    p_cam: Floats
    gradient: Floats
    hessian: Floats

    def subset(self, kept: Bools) -> PointEquations:
        """Those of the rows that are kept (k,)."""
        return PointEquations(np.ascontiguousarray(self.p_cam[:, kept]), self.gradient[kept], self.hessian[kept])


def point_equations(
    terms: Sequence[PointTerm], p_cam: Floats, least_curvature: float = LEAST_CURVATURE
) -> tuple[PointEquations, float]:
    """The equations of all terms at the points p_cam (3, k), and the cost.

    The Hessian of a term has its kernel's mean curvature here, at least `least_curvature` of what its weights say.
    Steps by the weights alone (iteratively reweighted least squares) fall short by a quarter to a half, each time.
    """
    gradient, hessian, cost = np.zeros((p_cam.shape[1], 3)), np.zeros((p_cam.shape[1], 6)), 0.0
    for term in terms:
        residual, jacobian = (np.ascontiguousarray(found) for found in term.linearise(p_cam))
        kind, c2 = KERNELS[term.robust.kernel], float(term.robust.scale**2)
        cost += _accumulate(p_cam[2], residual, jacobian, kind, c2, least_curvature, gradient, hessian)
    return PointEquations(p_cam, gradient, hessian), cost


@njit(cache=True, nogil=True, error_model="numpy")
def _accumulate(
    z: Floats,
    residual: Floats,
    jacobian: Floats,
    kind: int,
    c2: float,
    least_curvature: float,
    gradient: Floats,
    hessian: Floats,
) -> float:
    """Add J^T w r to the gradient and J^T w J, times the mean curvature, to the Hessian; half the robust cost."""
    d, rows = residual.shape
    weight = np.zeros(rows)
    cost, weights, curvatures = 0.0, 0.0, 0.0
    for k in range(rows):
        s = 0.0
        for i in range(d):
            s += residual[i, k] * residual[i, k]
        if np.isnan(s):
            continue
        rho, w = robust(kind, s, c2)
        cost += rho
        if z[k] < NEAR_M:
            continue
        weight[k] = w
        weights += w
        # The mean over directions of the second derivative, rho' + 2 s rho'' / d: see robust.weight_and_curvature.
        curvatures += w * (1 - 2 * kind * (s / (c2 + s)) / d) if kind else 1.0
    share = max(curvatures / max(weights, 1e-12), least_curvature)
    for k in range(rows):
        w = weight[k]
        if w == 0.0:
            continue
        for i in range(d):
            q = 0
            for a in range(3):
                wj = w * jacobian[i, a, k]
                gradient[k, a] += wj * residual[i, k]
                for b in range(a, 3):
                    hessian[k, q] += share * wj * jacobian[i, b, k]
                    q += 1
    return 0.5 * cost
