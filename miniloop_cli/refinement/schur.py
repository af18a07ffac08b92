"""The Schur complement of the bundle adjustment: points eliminated track by track.

For a point at x in a camera's frame (pose T_world_cam = (R, t), x = R^T (X - t)), a step [exp(w) | v] of the pose and
d of the point change x by B (w, v) + R^T d with B = [hat(x) | -I]. Every block therefore follows from two quantities
in the camera frame, the gradient a = J^T W r (3) and the Hessian A = J^T W J (3 x 3) with respect to x:
  pose B^T a, B^T A B;   point R a, V = sum R A R^T;   mixed W = B^T A R^T.
With V = L L^T and Y = W L^-T the reduced system is  sum B^T A B - Y Y^T  (Triggs et al. 2000, section 6).

Loops over 3 and 6 are not unrolled by hand: the compiler does it, and compiles loops several times faster.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.refinement.block_system import BlockIndex
from miniloop_cli.refinement.point_equations import PointEquations
from miniloop_cli.refinement.track_rows import TrackRows
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats

_POINT_PRIOR = 1e-6  # 1/m^2; keeps V regular along a ray that is seen once


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def reduce_tracks(
    low: int,
    high: int,
    tracks: TrackRows,
    seen: PointEquations,
    R: Floats,
    damping: float,
    index: BlockIndex,
    S: Floats,
    g: Floats,
    L: Floats,
) -> None:
    """Add the tracks low..high - 1 to the reduced system.

    R (n, 3, 3) rotations of the poses; index of the upper blocks; S (blocks, 6, 6) and the reduced gradient
    g (n, 6) are added to, for free poses. Of diagonal blocks only the upper triangle counts; the caller mirrors it.
    L (p, 3, 3) gets the factors of the points' own blocks, damped; on its diagonals are the inverses of the factors'.
    """
    longest = 0
    for p in range(low, high):
        longest = max(longest, tracks.start[p + 1] - tracks.start[p])
    x, M, Y = np.empty((longest, 3)), np.empty((longest, 3, 3)), np.empty((longest, 18))
    V, B, AB, e = np.empty((3, 3)), np.zeros((3, 6)), np.empty((3, 6)), np.empty((3, 3))
    for i in range(3):
        B[i, 3 + i] = -1.0
    for p in range(low, high):
        first, length = tracks.start[p], tracks.start[p + 1] - tracks.start[p]
        for i in range(3):
            e[0, i] = 0.0
            for j in range(3):
                V[i, j] = 0.0
        for k in range(length):
            f, A, a = tracks.frame[first + k], seen.hessian[first + k], seen.gradient[first + k]
            for i in range(3):
                x[k, i] = seen.p_cam[i, first + k]
            for i in range(3):
                u, v = (i + 1) % 3, (i + 2) % 3
                B[u, i], B[v, i] = x[k, v], -x[k, u]
            for i in range(3):
                for j in range(3):
                    M[k, i, j] = A[i, 0] * R[f, j, 0] + A[i, 1] * R[f, j, 1] + A[i, 2] * R[f, j, 2]
            for i in range(3):
                for c in range(3):
                    e[0, i] += R[f, i, c] * a[c]
                    for j in range(i + 1):
                        V[i, j] += R[f, i, c] * M[k, c, j]
            if not index.free[f]:
                continue
            for i in range(3):
                for j in range(6):
                    AB[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
            for i in range(6):
                for c in range(3):
                    g[f, i] += B[c, i] * a[c]
                    for j in range(i, 6):
                        S[f, i, j] += B[c, i] * AB[c, j]
                    S[f, i, i] += damping * B[c, i] * AB[c, i]
        for i in range(3):
            for j in range(i + 1):
                rest = V[i, j] * (1.0 + damping) if i == j else V[i, j]
                for c in range(j):
                    rest -= L[p, i, c] * L[p, j, c]
                L[p, i, j] = 1.0 / np.sqrt(max(rest, 0.0) + _POINT_PRIOR) if i == j else rest * L[p, j, j]
            for c in range(i):
                e[0, i] -= L[p, i, c] * e[0, c]
            e[0, i] *= L[p, i, i]
        for k in range(length):
            f = tracks.frame[first + k]
            if not index.free[f]:
                continue
            for r in range(3):  # rows of N = M L^-T; Y = B^T N, so its lower half is -N and its upper N x x
                for i in range(3):
                    rest = M[k, r, i]
                    for c in range(i):
                        rest += L[p, i, c] * Y[k, 6 * c + 3 + r]
                    Y[k, 6 * i + 3 + r] = -rest * L[p, i, i]
            for i in range(3):
                for c in range(3):
                    u, v = (i + 1) % 3, (i + 2) % 3
                    Y[k, 6 * c + i] = x[k, u] * Y[k, 6 * c + 3 + v] - x[k, v] * Y[k, 6 * c + 3 + u]
            for i in range(6):
                for c in range(3):
                    g[f, i] -= Y[k, 6 * c + i] * e[0, c]
        for k in range(length):
            a = Y[k]
            a0, a1, a2, a3, a4, a5, a6, a7, a8 = a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8]
            b0, b1, b2, b3, b4, b5, b6, b7, b8 = a[9], a[10], a[11], a[12], a[13], a[14], a[15], a[16], a[17]
            i = tracks.frame[first + k]
            if not index.free[i]:
                continue
            q, end = i, index.start[i + 1]
            following = index.start[i]
            for m in range(k, length):
                j = tracks.frame[first + m]
                if not index.free[j]:
                    continue
                if j != i:
                    q = following
                    if index.columns[q] != j:  # mostly it is the next block, as tracks run through neighbouring frames
                        q += np.searchsorted(index.columns[q:end], j)
                    following = q + 1
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
    low: int, high: int, tracks: TrackRows, seen: PointEquations, R: Floats, L: Floats, step: Floats, X: Floats
) -> None:
    """Back-substitute the pose step (n, 6) into the points X (p, 3) of the tracks low..high - 1.

    R (n, 3, 3) of the poses, L (p, 3, 3) as `reduce_tracks` left it.
    """
    q, g = np.empty((1, 3)), np.empty((1, 3))
    for p in range(low, high):
        for i in range(3):
            g[0, i] = 0.0
        for k in range(tracks.start[p], tracks.start[p + 1]):
            f = tracks.frame[k]
            for i in range(3):
                u, v = (i + 1) % 3, (i + 2) % 3
                q[0, i] = seen.p_cam[u, k] * step[f, v] - seen.p_cam[v, k] * step[f, u] - step[f, 3 + i]
            for c in range(3):  # W^T step = R A q: the gradient of the point after the step of the pose
                felt = seen.gradient[k, c]
                for i in range(3):
                    felt += seen.hessian[k, c, i] * q[0, i]
                for i in range(3):
                    g[0, i] += R[f, i, c] * felt
        for i in range(3):
            for c in range(i):
                g[0, i] -= L[p, i, c] * g[0, c]
            g[0, i] *= L[p, i, i]
        for i in range(2, -1, -1):
            for c in range(i + 1, 3):
                g[0, i] -= L[p, c, i] * g[0, c]
            g[0, i] *= L[p, i, i]
            X[p, i] -= g[0, i]
