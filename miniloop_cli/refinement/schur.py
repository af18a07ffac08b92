"""The Schur complement of the bundle adjustment: points eliminated track by track.

Of a point at x in a camera's frame (pose T_world_cam = (R, t), x = R^T (X - t)), a step [exp(w) | v] of the pose and d
of the point change x by B (w, v) + R^T d with B = [hat(x) | -I]. Every block therefore comes from two small quantities
in the camera frame, the gradient a = J^T W r (3) and the Hessian A = J^T W J (3 x 3) with respect to x:
  pose B^T a, B^T A B;   point R a, V = sum R A R^T;   mixed W = B^T A R^T.
With V = L L^T and Y = W L^-T the reduced system is  sum B^T A B - Y Y^T  (Triggs et al. 2000, section 6).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from miniloop_cli.refinement.point_equations import PointEquations
from miniloop_cli.refinement.track_rows import TrackRows
from miniloop_cli.typing import Floats

_POINT_PRIOR = 1e-6  # 1/m^2, keeps V regular along a ray seen once


@njit(cache=True, nogil=True, error_model="numpy")
def _add_to_point(
    V: Floats,
    g: Floats,
    M: Floats,
    R: Floats,
    f: int,
    a: Floats,
    A: Floats,
) -> None:
    """V (upper triangle) += R A R^T, g += R a, M = A R^T; a (3,), A (6,) as in PointEquations."""
    a0, a1, a2 = a[0], a[1], a[2]
    A00, A01, A02, A11, A12, A22 = A[0], A[1], A[2], A[3], A[4], A[5]
    for c in range(3):
        r0, r1, r2 = R[f, c, 0], R[f, c, 1], R[f, c, 2]
        g[c] += r0 * a0 + r1 * a1 + r2 * a2
        M[0, c] = A00 * r0 + A01 * r1 + A02 * r2
        M[1, c] = A01 * r0 + A11 * r1 + A12 * r2
        M[2, c] = A02 * r0 + A12 * r1 + A22 * r2
    for i in range(3):
        for j in range(i, 3):
            V[i, j] += R[f, i, 0] * M[0, j] + R[f, i, 1] * M[1, j] + R[f, i, 2] * M[2, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _cholesky3(V: Floats, damping: float) -> tuple[float, float, float, float, float, float]:
    """1/L00, L10, L20, 1/L11, L21, 1/L22 of V + damping diag(V) + prior."""
    grow = 1.0 + damping
    i0 = 1.0 / np.sqrt(V[0, 0] * grow + _POINT_PRIOR)
    l10, l20 = V[0, 1] * i0, V[0, 2] * i0
    i1 = 1.0 / np.sqrt(max(V[1, 1] * grow - l10 * l10, 0.0) + _POINT_PRIOR)
    l21 = (V[1, 2] - l10 * l20) * i1
    i2 = 1.0 / np.sqrt(max(V[2, 2] * grow - l20 * l20 - l21 * l21, 0.0) + _POINT_PRIOR)
    return i0, l10, l20, i1, l21, i2


@njit(cache=True, nogil=True, error_model="numpy")
def _add_to_pose(
    S: Floats,
    g: Floats,
    f: int,
    p_cam: Floats,
    grow: float,
    a: Floats,
    A: Floats,
) -> None:
    """Diagonal block f of S += B^T A B with its diagonal times `grow`; g[f] += B^T a."""
    x, y, z = p_cam[0], p_cam[1], p_cam[2]
    a0, a1, a2 = a[0], a[1], a[2]
    A00, A01, A02, A11, A12, A22 = A[0], A[1], A[2], A[3], A[4], A[5]
    g[f, 0] += a1 * z - a2 * y
    g[f, 1] += a2 * x - a0 * z
    g[f, 2] += a0 * y - a1 * x
    g[f, 3] -= a0
    g[f, 4] -= a1
    g[f, 5] -= a2
    # H = hat(x) A
    h00, h01, h02 = y * A02 - z * A01, y * A12 - z * A11, y * A22 - z * A12
    h10, h11, h12 = z * A00 - x * A02, z * A01 - x * A12, z * A02 - x * A22
    h20, h21, h22 = x * A01 - y * A00, x * A11 - y * A01, x * A12 - y * A02
    S[f, 0, 0] += grow * (h02 * y - h01 * z)
    S[f, 0, 1] += h00 * z - h02 * x
    S[f, 0, 2] += h01 * x - h00 * y
    S[f, 1, 1] += grow * (h10 * z - h12 * x)
    S[f, 1, 2] += h11 * x - h10 * y
    S[f, 2, 2] += grow * (h21 * x - h20 * y)
    S[f, 0, 3] += h00
    S[f, 0, 4] += h01
    S[f, 0, 5] += h02
    S[f, 1, 3] += h10
    S[f, 1, 4] += h11
    S[f, 1, 5] += h12
    S[f, 2, 3] += h20
    S[f, 2, 4] += h21
    S[f, 2, 5] += h22
    S[f, 3, 3] += grow * A00
    S[f, 4, 4] += grow * A11
    S[f, 5, 5] += grow * A22
    S[f, 3, 4] += A01
    S[f, 3, 5] += A02
    S[f, 4, 5] += A12


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def reduce_tracks(
    low: int,
    high: int,
    tracks: TrackRows,
    seen: PointEquations,
    R: Floats,
    damping: float,
    table: NDArray[np.uint32],
    S: Floats,
    g: Floats,
) -> None:
    """Add the tracks low..high - 1 to the reduced system.

    R (n, 3, 3) rotations of the poses; table (n, n) numbers of the upper blocks; S (blocks, 6, 6) and the reduced
    gradient g (n, 6) are added to. Of diagonal blocks only the upper triangle is right; the caller mirrors it.
    """
    longest = 0
    for p in range(low, high):
        longest = max(longest, tracks.start[p + 1] - tracks.start[p])
    x, Ms, Y = np.empty((longest, 3)), np.empty((longest, 3, 3)), np.empty((longest, 18))
    V, gp = np.empty((3, 3)), np.empty(3)
    for p in range(low, high):
        first, length = tracks.start[p], tracks.start[p + 1] - tracks.start[p]
        V[:], gp[:] = 0.0, 0.0
        for k in range(length):
            row = first + k
            f = tracks.frame[row]
            x[k, 0], x[k, 1], x[k, 2] = seen.p_cam[0, row], seen.p_cam[1, row], seen.p_cam[2, row]
            _add_to_point(V, gp, Ms[k], R, f, seen.gradient[row], seen.hessian[row])
            _add_to_pose(S, g, f, x[k], 1.0 + damping, seen.gradient[row], seen.hessian[row])
        i0, l10, l20, i1, l21, i2 = _cholesky3(V, damping)
        e0 = gp[0] * i0
        e1 = (gp[1] - l10 * e0) * i1
        e2 = (gp[2] - l20 * e0 - l21 * e1) * i2
        for k in range(length):
            for r in range(3):  # rows of N = M L^-T; Y = B^T N, so its lower half is -N and its upper N x x
                n0 = Ms[k, r, 0] * i0
                n1 = (Ms[k, r, 1] - l10 * n0) * i1
                n2 = (Ms[k, r, 2] - l20 * n0 - l21 * n1) * i2
                Y[k, 3 + r], Y[k, 9 + r], Y[k, 15 + r] = -n0, -n1, -n2
            for c in range(0, 18, 6):
                b0, b1, b2 = Y[k, c + 3], Y[k, c + 4], Y[k, c + 5]
                Y[k, c] = x[k, 1] * b2 - x[k, 2] * b1
                Y[k, c + 1] = x[k, 2] * b0 - x[k, 0] * b2
                Y[k, c + 2] = x[k, 0] * b1 - x[k, 1] * b0
            f = tracks.frame[first + k]
            for i in range(6):
                g[f, i] -= Y[k, i] * e0 + Y[k, 6 + i] * e1 + Y[k, 12 + i] * e2
        for k in range(length):
            f = tracks.frame[first + k]
            a = Y[k]
            a0, a1, a2, a3, a4, a5, a6, a7, a8 = a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8]
            b0, b1, b2, b3, b4, b5, b6, b7, b8 = a[9], a[10], a[11], a[12], a[13], a[14], a[15], a[16], a[17]
            for m in range(k, length):
                q = table[f, tracks.frame[first + m]]
                for j in range(6):  # the hottest loop: a in registers, j vectorised
                    y0, y1, y2 = Y[m, j], Y[m, 6 + j], Y[m, 12 + j]
                    S[q, 0, j] -= a0 * y0 + a6 * y1 + b3 * y2
                    S[q, 1, j] -= a1 * y0 + a7 * y1 + b4 * y2
                    S[q, 2, j] -= a2 * y0 + a8 * y1 + b5 * y2
                    S[q, 3, j] -= a3 * y0 + b0 * y1 + b6 * y2
                    S[q, 4, j] -= a4 * y0 + b1 * y1 + b7 * y2
                    S[q, 5, j] -= a5 * y0 + b2 * y1 + b8 * y2


@njit(cache=True, nogil=True, error_model="numpy")
def step_tracks(
    low: int,
    high: int,
    tracks: TrackRows,
    seen: PointEquations,
    R: Floats,
    damping: float,
    step: Floats,
    X: Floats,
) -> None:
    """Back-substitute the pose step (n, 6) into the points X (p, 3) of the tracks low..high - 1."""
    V, g, M = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    a = np.empty(3)
    for p in range(low, high):
        V[:], g[:] = 0.0, 0.0
        for k in range(tracks.start[p], tracks.start[p + 1]):
            f, A = tracks.frame[k], seen.hessian[k]
            x, y, z = seen.p_cam[0, k], seen.p_cam[1, k], seen.p_cam[2, k]
            # W^T step = R A q: the gradient the point feels once the pose has moved.
            q0 = y * step[f, 2] - z * step[f, 1] - step[f, 3]
            q1 = z * step[f, 0] - x * step[f, 2] - step[f, 4]
            q2 = x * step[f, 1] - y * step[f, 0] - step[f, 5]
            a[0] = seen.gradient[k, 0] + A[0] * q0 + A[1] * q1 + A[2] * q2
            a[1] = seen.gradient[k, 1] + A[1] * q0 + A[3] * q1 + A[4] * q2
            a[2] = seen.gradient[k, 2] + A[2] * q0 + A[4] * q1 + A[5] * q2
            _add_to_point(V, g, M, R, f, a, A)
        i0, l10, l20, i1, l21, i2 = _cholesky3(V, damping)
        e0 = g[0] * i0
        e1 = (g[1] - l10 * e0) * i1
        e2 = (g[2] - l20 * e0 - l21 * e1) * i2
        d2 = e2 * i2
        d1 = (e1 - l21 * d2) * i1
        X[p, 0] -= (e0 - l10 * d1 - l20 * d2) * i0
        X[p, 1] -= d1
        X[p, 2] -= d2
