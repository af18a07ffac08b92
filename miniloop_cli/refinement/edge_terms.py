"""The residual of an edge of the pose graph, and its derivatives.

E = (T_world_j^-1 T_world_i) T_j_i^-1 = (R_E, t_E), residual r = (log R_E, t_E), cost rho(r^T Lambda r) / 2. (R, t) is
the measured T_j_i and J^-1 the inverse right Jacobian of SO(3) at log R_E, steps [exp(w) | v] of the poses change r by
  [ J^-1 R            0     ]                        [ -J^-T     0 ]
  [ R_E hat(t) R    R_E R   ] (w_i, v_i)    and      [ hat(t_E) -I ] (w_j, v_j).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.geometry.se3 import project_so3
from miniloop_cli.refinement.robust import KERNELS, Kernel, robust
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.view_graph import checked_pairs
from miniloop_cli.typing import Floats, Ints


class Edges(NamedTuple):
    """Edges (m,) from poses i to j: measured R (m, 3, 3), t (m, 3), information (m, 6, 6); kernel, squared scale."""

    i: Ints
    j: Ints
    R: Floats
    t: Floats
    information: Floats
    kind: int
    c2: float

    @property
    def pairs(self) -> Ints:
        """(m, 2) rows (i, j)."""
        return np.stack([self.i, self.j], axis=1)


def make_edges(count: int, pairs: ArrayLike, T_j_i: Floats, information: Floats, kernel: Kernel, scale: float) -> Edges:
    """Edges between `count` poses from pairs (m, 2) rows (i, j), T_j_i (m, 4, 4) and information (m, 6, 6).

    Raises ValueError for shapes that do not fit or numbers that are not finite, GraphError for impossible pairs.
    """
    pairs = checked_pairs(count, pairs)
    T, L = np.asarray(T_j_i, float).reshape(-1, 4, 4), np.asarray(information, float).reshape(-1, 6, 6)
    if not len(pairs) == len(T) == len(L):
        raise ValueError(f"{len(pairs)} pairs, {len(T)} relative poses, {len(L)} information matrices: not one a row")
    if not (np.isfinite(T).all() and np.isfinite(L).all()):
        raise ValueError("relative poses and information matrices must be finite")
    L = (L + L.transpose(0, 2, 1)) / 2
    eigenvalues = np.linalg.eigvalsh(L)
    if np.any(eigenvalues[:, 0] < -1e-9 * eigenvalues[:, -1]):
        raise ValueError(f"the information of edge {int(np.argmin(eigenvalues[:, 0]))} has a negative eigenvalue")
    i, j = np.ascontiguousarray(pairs.T)
    R, t = np.ascontiguousarray(project_so3(T[:, :3, :3])), np.ascontiguousarray(T[:, :3, 3])
    return Edges(i, j, R, t, L, KERNELS[kernel], float(scale**2))


@njit(cache=True, nogil=True, error_model="numpy")
def log_rotation(R: Floats, w: Floats) -> None:
    """Rotation vector of R (3, 3) into w (3,), by the quaternion: stable at all angles."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace > 0:
        q = np.sqrt(1 + trace) / 2  # the real part
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            w[a] = (R[c, b] - R[b, c]) / (4 * q)
    else:
        a = 0
        for d in range(1, 3):
            if R[d, d] > R[a, a]:
                a = d
        b, c = (a + 1) % 3, (a + 2) % 3
        s = np.sqrt(max(1 + R[a, a] - R[b, b] - R[c, c], 0.0)) / 2
        q = (R[c, b] - R[b, c]) / (4 * s)
        w[a] = s
        w[b] = (R[b, a] + R[a, b]) / (4 * s)
        w[c] = (R[c, a] + R[a, c]) / (4 * s)
        if q < 0:
            q = -q
            for d in range(3):
                w[d] = -w[d]
    sine = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    scale = 2 * np.arctan2(sine, q) / sine if sine > 1e-9 else 2.0
    for a in range(3):
        w[a] *= scale


@njit(cache=True, nogil=True, error_model="numpy")
def _residual(edges: Edges, e: int, R: Floats, t: Floats, R_ji: Floats, R_E: Floats, r: Floats, Lr: Floats) -> float:
    """Squared Mahalanobis residual; R_ji = R_j^T R_i, R_E, r (6,) and Lambda r are left in the arguments."""
    i, j = edges.i[e], edges.j[e]
    for a in range(3):
        r[3 + a] = 0.0
        for b in range(3):
            R_ji[a, b] = R[j, 0, a] * R[i, 0, b] + R[j, 1, a] * R[i, 1, b] + R[j, 2, a] * R[i, 2, b]
            r[3 + a] += R[j, b, a] * (t[i, b] - t[j, b])
    for a in range(3):
        for b in range(3):
            R_E[a, b] = R_ji[a, 0] * edges.R[e, b, 0] + R_ji[a, 1] * edges.R[e, b, 1] + R_ji[a, 2] * edges.R[e, b, 2]
        r[3 + a] -= R_E[a, 0] * edges.t[e, 0] + R_E[a, 1] * edges.t[e, 1] + R_E[a, 2] * edges.t[e, 2]
    log_rotation(R_E, r[:3])
    s = 0.0
    for a in range(6):
        Lr[a] = 0.0
        for b in range(6):
            Lr[a] += edges.information[e, a, b] * r[b]
        s += r[a] * Lr[a]
    return max(s, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse_right_jacobian(w: Floats, J: Floats) -> None:
    """I + hat(w) / 2 + (1 - (a / 2) cot(a / 2)) / a^2 hat(w)^2, a = |w| (Chirikjian 2011, (10.86))."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    half = np.sqrt(angle2) / 2
    k = 1 / 12 + angle2 / 720 if angle2 < 1e-6 else (1 - half / np.tan(half)) / angle2
    for a in range(3):
        for b in range(3):
            J[a, b] = k * w[a] * w[b]
        J[a, a] += 1 - k * angle2
    J[0, 1] -= w[2] / 2
    J[1, 0] += w[2] / 2
    J[0, 2] += w[1] / 2
    J[2, 0] -= w[1] / 2
    J[1, 2] -= w[0] / 2
    J[2, 1] += w[0] / 2


@njit(cache=True, nogil=True, error_model="numpy")
def _jacobians(
    R_meas: Floats, t_meas: Floats, R_ji: Floats, R_E: Floats, r: Floats, J: Floats, Ji: Floats, Jj: Floats
) -> None:
    """Derivatives (6, 6) of r by the steps of i and j; J (3, 3) is scratch. Ji and Jj must be zero before."""
    _inverse_right_jacobian(r[:3], J)
    for a in range(3):
        for b in range(3):
            Ji[a, b] = J[a, 0] * R_meas[0, b] + J[a, 1] * R_meas[1, b] + J[a, 2] * R_meas[2, b]
            Ji[3 + a, 3 + b] = R_ji[a, b]
            Jj[a, b] = -J[b, a]
    for b in range(3):  # column b of hat(t) R is t x R[:, b]
        x = t_meas[1] * R_meas[2, b] - t_meas[2] * R_meas[1, b]
        y = t_meas[2] * R_meas[0, b] - t_meas[0] * R_meas[2, b]
        z = t_meas[0] * R_meas[1, b] - t_meas[1] * R_meas[0, b]
        for a in range(3):
            Ji[3 + a, b] = R_E[a, 0] * x + R_E[a, 1] * y + R_E[a, 2] * z
        Jj[3 + b, 3 + b] = -1.0
    Jj[3, 1], Jj[3, 2] = -r[5], r[4]
    Jj[4, 0], Jj[4, 2] = r[5], -r[3]
    Jj[5, 0], Jj[5, 1] = -r[4], r[3]


@njit(cache=True, nogil=True, error_model="numpy")
def _add_product(A: Floats, B: Floats, weight: float, S: Floats, q: int) -> None:
    """S[q] += weight A^T B, all (6, 6)."""
    for a in range(6):
        for k in range(6):
            x = weight * A[k, a]
            for b in range(6):
                S[q, a, b] += x * B[k, b]


@njit(cache=True, nogil=True, error_model="numpy")
def add_edges(edges: Edges, block: Ints, R: Floats, t: Floats, damping: float, S: Floats, g: Floats) -> float:
    """Add all edges to the blocks S (b, 6, 6) and the gradient g (n, 6); half their robust cost is returned.

    `block` (m,) numbers the block of (min(i, j), max(i, j)); the diagonal blocks are 0..n - 1.
    """
    R_ji, R_E, J = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    r, Lr, Ji, Jj = np.empty(6), np.empty(6), np.zeros((6, 6)), np.zeros((6, 6))
    LJi, LJj = np.empty((1, 6, 6)), np.empty((1, 6, 6))
    cost = 0.0
    for e in range(len(edges.i)):
        i, j = edges.i[e], edges.j[e]
        s = _residual(edges, e, R, t, R_ji, R_E, r, Lr)
        rho, w = robust(edges.kind, s, edges.c2)
        cost += rho
        _jacobians(edges.R[e], edges.t[e], R_ji, R_E, r, J, Ji, Jj)
        LJi[:], LJj[:] = 0.0, 0.0
        _add_product(edges.information[e], Ji, w, LJi, 0)
        _add_product(edges.information[e], Jj, w, LJj, 0)
        _add_product(Ji, LJi[0], 1.0, S, i)
        _add_product(Jj, LJj[0], 1.0, S, j)
        if i < j:
            _add_product(Ji, LJj[0], 1.0, S, block[e])
        else:
            _add_product(Jj, LJi[0], 1.0, S, block[e])
        for a in range(6):
            for b in range(6):
                g[i, a] += w * Ji[b, a] * Lr[b]
                g[j, a] += w * Jj[b, a] * Lr[b]
            for b in range(6):  # the damped part of the diagonals
                S[i, a, a] += damping * Ji[b, a] * LJi[0, b, a]
                S[j, a, a] += damping * Jj[b, a] * LJj[0, b, a]
    return 0.5 * cost


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate_edges(edges: Edges, R: Floats, t: Floats, chi2: Floats, weight: Floats) -> float:
    """Squared Mahalanobis residuals and robust weights (m,) into the arguments; half the robust cost is returned.

    Poses R (n, 3, 3) and t (n, 3) of the camera in the world; `chi2` and `weight` (m,) are written.
    """
    R_ji, R_E, r, Lr = np.empty((3, 3)), np.empty((3, 3)), np.empty(6), np.empty(6)
    cost = 0.0
    for e in range(len(edges.i)):
        chi2[e] = _residual(edges, e, R, t, R_ji, R_E, r, Lr)
        rho, weight[e] = robust(edges.kind, chi2[e], edges.c2)
        cost += rho
    return 0.5 * cost
