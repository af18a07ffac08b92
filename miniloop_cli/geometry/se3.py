"""SE(3) in batches of numpy arrays.

A pose is a (..., 4, 4) float64 array. `T_b_a` maps points of frame a into frame b. A tangent vector is
(..., 6) float64, rotation (rad) first, then translation (m), and acts decoupled: Exp(w, v) = [exp(w) | v].
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.typing import Floats


def pose(R: Floats, t: Floats) -> Floats:
    """(..., 3, 3) rotations and (..., 3) translations to (..., 4, 4) poses."""
    R, t = np.asarray(R, float), np.asarray(t, float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Floats) -> Floats:
    """Inverse of (..., 4, 4) rigid transformations."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return pose(Rt, -np.einsum("...ij,...j->...i", Rt, T[..., :3, 3]))


def transform(T: Floats, points: Floats) -> Floats:
    """Apply (..., 4, 4) poses to (..., n, 3) points."""
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def hat(w: Floats) -> Floats:
    """(..., 3) vectors to their (..., 3, 3) cross-product matrices."""
    w = np.asarray(w, float)
    W = np.zeros((*w.shape, 3))
    W[..., 0, 1], W[..., 0, 2], W[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    W[..., 1, 0], W[..., 2, 0], W[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return W


def adjoint(T: Floats) -> Floats:
    """(..., 6, 6) with [exp(w') | v'] T = T [exp(w) | v] to first order, (w', v') = Ad (w, v); T (..., 4, 4)."""
    A = np.zeros((*T.shape[:-2], 6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = T[..., :3, :3]
    A[..., 3:, :3] = hat(T[..., :3, 3]) @ T[..., :3, :3]
    return A


def exp_so3(w: Floats) -> Floats:
    """Rodrigues' formula: (..., 3) rotation vectors (rad) to (..., 3, 3) rotations; exact to first order near 0."""
    w = np.asarray(w, float)
    angle2 = (w * w).sum(-1)[..., None, None]
    angle = np.sqrt(angle2)
    small = angle2 < 1e-12
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1 - angle2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle2 / 24, (1 - np.cos(safe)) / (safe * safe))
    W = hat(w)
    return np.eye(3) + a * W + b * (W @ W)


def log_so3(R: Floats) -> Floats:
    """(..., 3, 3) rotations to (..., 3) rotation vectors (rad), angle in [0, pi], stable at both ends."""
    q = quaternions(R)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)  # of half the angle
    small = sine < 1e-4
    safe = np.where(small, 1.0, sine)
    return q[..., :3] * np.where(small, 2 + sine**2 / 3, 2 * np.arctan2(safe, q[..., 3:]) / safe)


def quaternions(R: Floats, w_first: bool = False) -> Floats:
    """(..., 3, 3) rotations to (..., 4) unit quaternions x y z w (or w x y z) with w >= 0.

    The longest row of 4 q q', which is linear in R, is far from 0 for every rotation.

    Source: F. L. Markley, "Unit quaternion from rotation matrix", J. Guidance, Control, and Dynamics 31(2), 2008.
    """
    R = np.asarray(R, float)
    Q, diagonal = np.empty((*R.shape[:-2], 4, 4)), np.diagonal(R, axis1=-2, axis2=-1)
    trace = diagonal.sum(-1)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        Q[..., i, i] = 1 - trace + 2 * diagonal[..., i]
        Q[..., i, j] = Q[..., j, i] = R[..., i, j] + R[..., j, i]
        Q[..., i, 3] = Q[..., 3, i] = R[..., k, j] - R[..., j, k]
    Q[..., 3, 3] = 1 + trace
    longest = np.diagonal(Q, axis1=-2, axis2=-1).argmax(-1)
    q = np.take_along_axis(Q, longest[..., None, None], axis=-2)[..., 0, :]
    q *= np.where(q[..., 3:] < 0, -1, 1) / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.roll(q, 1, axis=-1) if w_first else q


def rotations(q: Floats, w_first: bool = False) -> Floats:
    """(..., 4) quaternions x y z w (or w x y z) of any length but 0 to (..., 3, 3) rotations."""
    q = np.roll(q, -1, axis=-1) if w_first else np.asarray(q, float)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    V = hat(q[..., :3])
    return np.eye(3) + 2 * (q[..., 3, None, None] * V + V @ V)


def to_rows(T: Floats) -> Floats:
    """(..., 4, 4) poses as rows (..., 7): x y z qx qy qz qw."""
    return np.concatenate([T[..., :3, 3], quaternions(T[..., :3, :3])], axis=-1)


def from_rows(rows: Floats) -> Floats:
    """Rows (..., 7) x y z qx qy qz qw, quaternions of any length but 0, to (..., 4, 4) poses."""
    return pose(rotations(rows[..., 3:]), rows[..., :3])


def rotation_angle_deg(R: Floats) -> Floats:
    """Rotation angle in degrees of (..., 3, 3) rotations; accurate near 0 and near 180."""
    skew = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return np.degrees(np.arctan2(np.linalg.norm(skew, axis=-1), np.trace(R, axis1=-2, axis2=-1) - 1))


def angle_and_distance(T: Floats) -> tuple[Floats, Floats]:
    """Rotation angles (...) in degrees, and lengths (...) of the translations in metres, of poses (..., 4, 4)."""
    return rotation_angle_deg(T[..., :3, :3]), np.linalg.norm(T[..., :3, 3], axis=-1)


def project_so3(M: Floats) -> Floats:
    """Nearest rotations (Frobenius) to (..., 3, 3) matrices."""
    U, _, Vt = np.linalg.svd(M)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return U @ Vt
