"""The noise that reaches the poses through the tracks, for the covariance of a bundle adjustment.

The reduced gradient of a track is g = sum_k B_k^T a_k - W_k V^-1 sum_m R_m a_m. If the a_k are independent with
covariances A' (where the Hessian has A), then, with primes on everything made of A' and G = W V^-1,
  Cov(g) = sum B^T A' B - G_k Q_m^T - Q_k G_m^T for all k, m,   Q = W' - G V' / 2.
For A' = A this is the reduced Hessian itself.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from miniloop_cli.refinement.schur import add_point_terms, add_pose_terms, cholesky3
from miniloop_cli.refinement.track_terms import Model, Observations, camera_point, observation_terms

Array = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse3(V: Array, I: Array) -> None:
    """Inverse of the symmetric V (upper triangle given) into I, regular along rays seen once."""
    i0, l10, l20, i1, l21, i2 = cholesky3(V, 0.0)
    a, b = -l10 * i0 * i1, -l21 * i1 * i2  # L^-1 = [i0; a i1; c b i2]
    c = -(l20 * i0 + l21 * a) * i2
    I[0, 0], I[0, 1], I[0, 2] = i0 * i0 + a * a + c * c, a * i1 + c * b, c * i2
    I[1, 0], I[1, 1], I[1, 2] = I[0, 1], i1 * i1 + b * b, b * i2
    I[2, 0], I[2, 1], I[2, 2] = I[0, 2], I[1, 2], i2 * i2


@njit(cache=True, nogil=True, error_model="numpy")
def point_leverage(obs: Observations, model: Model, part: Model, R: Array, t: Array, X: Array) -> float:
    """Degrees of freedom that the points take from the residuals whose Hessian is `part`: sum of tr(V^-1 V_part)."""
    V, P, I, M, g = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    total = 0.0
    for p in range(len(obs.start) - 1):
        V[:], P[:] = 0.0, 0.0
        for k in range(obs.start[p], obs.start[p + 1]):
            f = obs.frame[k]
            x, y, z = camera_point(R, t, f, X, p)
            add_point_terms(V, g, M, R, f, observation_terms(obs, k, model, x, y, z))
            add_point_terms(P, g, M, R, f, observation_terms(obs, k, part, x, y, z))
        _inverse3(V, I)
        for i in range(3):
            total += I[i, i] * P[i, i]
            for j in range(i + 1, 3):
                total += 2 * I[i, j] * P[i, j]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _mixed(M: Array, x: float, y: float, z: float, W: Array) -> None:
    """The columns of B^T M, -x x M above and -M below, as rows of W (3, 6)."""
    for c in range(3):
        W[c, 0] = z * M[1, c] - y * M[2, c]
        W[c, 1] = x * M[2, c] - z * M[0, c]
        W[c, 2] = y * M[0, c] - x * M[1, c]
        for r in range(3):
            W[c, 3 + r] = -M[r, c]


@njit(cache=True, nogil=True, error_model="numpy")
def add_noise(
    obs: Observations, model: Model, noise: Model, R: Array, t: Array, X: Array, table: NDArray[np.uint32], S: Array
) -> None:
    """Blocks S (b, 6, 6) += Cov(g) of all tracks; the Hessian of `model` is A, that of `noise` A'."""
    longest = 0
    for p in range(len(obs.start) - 1):
        longest = max(longest, obs.start[p + 1] - obs.start[p])
    W, Q, G = np.empty((longest, 3, 6)), np.empty((longest, 3, 6)), np.empty((longest, 3, 6))
    V, Vn, I, M, g = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    unused = np.empty((len(R), 6))
    for p in range(len(obs.start) - 1):
        first, length = obs.start[p], obs.start[p + 1] - obs.start[p]
        V[:], Vn[:] = 0.0, 0.0
        for k in range(length):
            f = obs.frame[first + k]
            x, y, z = camera_point(R, t, f, X, p)
            add_point_terms(V, g, M, R, f, observation_terms(obs, first + k, model, x, y, z))
            _mixed(M, x, y, z, W[k])
            terms = observation_terms(obs, first + k, noise, x, y, z)
            add_point_terms(Vn, g, M, R, f, terms)
            _mixed(M, x, y, z, Q[k])
            add_pose_terms(S, unused, f, x, y, z, 1.0, terms)
        _inverse3(V, I)
        for i in range(3):
            for j in range(i):
                Vn[i, j] = Vn[j, i]
        for k in range(length):
            for r in range(6):
                for c in range(3):
                    G[k, c, r] = W[k, 0, r] * I[0, c] + W[k, 1, r] * I[1, c] + W[k, 2, r] * I[2, c]
                for c in range(3):
                    Q[k, c, r] -= 0.5 * (G[k, 0, r] * Vn[0, c] + G[k, 1, r] * Vn[1, c] + G[k, 2, r] * Vn[2, c])
        for k in range(length):
            for m in range(k, length):
                q = table[obs.frame[first + k], obs.frame[first + m]]
                for i in range(6):
                    g0, g1, g2, q0, q1, q2 = G[k, 0, i], G[k, 1, i], G[k, 2, i], Q[k, 0, i], Q[k, 1, i], Q[k, 2, i]
                    for j in range(6):
                        S[q, i, j] -= g0 * Q[m, 0, j] + g1 * Q[m, 1, j] + g2 * Q[m, 2, j]
                        S[q, i, j] -= q0 * G[m, 0, j] + q1 * G[m, 1, j] + q2 * G[m, 2, j]
