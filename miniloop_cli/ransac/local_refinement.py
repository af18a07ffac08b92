"""After the search: refine on all matches with their own noise, count the inliers again, refit on them alone."""

from __future__ import annotations

import numpy as np

from miniloop_cli.ransac.gauss_newton import CAUCHY2, WHOLE, closing_jacobians, compose_into, gauss_newton
from miniloop_cli.ransac.matches import Packed
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Bools, Floats

STEPS = 8
# The row of packed covariances that holds an entry of the 3 x 3 matrix.
ENTRY = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@njit(**WHOLE)
def mahalanobis2(poses: Floats, matches: Packed, out: Floats) -> None:
    """out (N,) = r^T S^-1 r of each match, r = T p - q, S = CQ + R CP R^T; infinite where S is singular.

    poses (edges, 3, 4): one for each edge of `matches`.
    """
    P, Q, CP, CQ = matches.P, matches.Q, matches.CP, matches.CQ
    S, M, r = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for e in range(poses.shape[0]):
        T = poses[e]
        for k in range(matches.start[e], matches.start[e + 1]):
            for i in range(3):
                r[i] = T[i, 0] * P[0, k] + T[i, 1] * P[1, k] + T[i, 2] * P[2, k] + T[i, 3] - Q[i, k]
                for j in range(3):
                    a, b, c = ENTRY[j, 0], ENTRY[j, 1], ENTRY[j, 2]
                    M[i, j] = T[i, 0] * CP[a, k] + T[i, 1] * CP[b, k] + T[i, 2] * CP[c, k]
            for i in range(3):
                for j in range(i, 3):
                    S[i, j] = CQ[ENTRY[i, j], k] + M[i, 0] * T[j, 0] + M[i, 1] * T[j, 1] + M[i, 2] * T[j, 2]
            a00, a01 = S[1, 1] * S[2, 2] - S[1, 2] ** 2, S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
            a02, a11 = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1], S[0, 0] * S[2, 2] - S[0, 2] ** 2
            a12, a22 = S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2], S[0, 0] * S[1, 1] - S[0, 1] ** 2
            det = S[0, 0] * a00 + S[0, 1] * a01 + S[0, 2] * a02
            square = a00 * r[0] ** 2 + a11 * r[1] ** 2 + a22 * r[2] ** 2
            square += 2 * (a01 * r[0] * r[1] + a02 * r[0] * r[2] + a12 * r[1] * r[2])
            out[k] = square / det if det > 0 else np.inf


def edge_poses(T: Floats, edges: int) -> Floats:
    """(edges, 3, 4) poses of all edges of a pair (1) or a cycle (n) from the chain T (n-1, 3, 4)."""
    if edges == len(T):
        return T
    poses = np.empty((edges, 3, 4))
    poses[:-1] = T
    compose_into(T, poses[-1])
    return poses


def refine_locally(
    T: Floats, matches: Packed, gate2: float, chi2_gate: float, upright: bool
) -> tuple[Floats, Floats, Floats] | None:
    """Robust joint refinement of T (n-1, 3, 4), in place, and the fit of each edge's matches to it.

    Returns chi2 (N,), information (edges, 6, 6) of each edge from its own inliers, covariance (edges, 6, 6) of each
    edge's pose in the joint estimate; None if the matches do not determine the poses. `gate2` (m^2): matches farther
    off are ignored from the start.
    """
    edges, chain = len(matches.start) - 1, len(T)
    H, information, chi2 = np.empty((6 * chain, 6 * chain)), np.empty((edges, 6, 6)), np.empty(matches.P.shape[1])
    if not gauss_newton(T, matches, 0.0, gate2, CAUCHY2, upright, STEPS, H, information):
        return None
    for _ in range(2):
        mahalanobis2(edge_poses(T, edges), matches, chi2)
        if not gauss_newton(
            T, select_matches(matches, chi2 < chi2_gate), 0.0, np.inf, CAUCHY2, upright, STEPS, H, information
        ):
            return None
    mahalanobis2(edge_poses(T, edges), matches, chi2)
    return chi2, information, _covariances(T, H, edges, upright)


def select_matches(matches: Packed, kept: Bools) -> Packed:
    """The matches that `kept`, (N,) for all edges, marks."""
    before = np.concatenate([[0], np.cumsum(kept)])
    P, Q, CP, CQ = (np.ascontiguousarray(x[:, kept]) for x in matches[:4])
    return Packed(P, Q, CP, CQ, before[matches.start])


def _covariances(T: Floats, H: Floats, edges: int, upright: bool) -> Floats:
    """(edges, 6, 6) of each edge's pose, the closing edge through the chain, from the joint information H."""
    chain = len(T)
    joint = np.linalg.inv(H)
    if upright:
        held = np.arange(6 * chain) % 6 < 2
        joint[held] = joint[:, held] = 0.0
    covariance = np.empty((edges, 6, 6))
    for e in range(chain):
        covariance[e] = joint[6 * e : 6 * e + 6, 6 * e : 6 * e + 6]
    if edges > chain:
        A = np.empty((chain, 6, 6))
        closing_jacobians(T, A)
        A = np.concatenate(A, axis=1)
        covariance[-1] = A @ joint @ A.T
    return covariance
