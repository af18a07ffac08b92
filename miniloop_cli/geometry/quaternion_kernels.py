"""Compiled loops of rotation averaging, on unit quaternions (w, x, y, z), (n, 4) float64.

The residual of an edge (i, j) in the world frame is E = R_j R_j_i R_i', the identity if the edge agrees. With
updates R <- exp(x) R it becomes exp(x_j) E exp(-x_i), so that to first order x_i - x_j = log(E) closes it.
"""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats, Ints

Quaternion = tuple[float, float, float, float]


@njit(cache=True, nogil=True, error_model="numpy")
def load(q: Floats, i: int) -> Quaternion:
    """Row i of q (n, 4), w first."""
    return q[i, 0], q[i, 1], q[i, 2], q[i, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def conjugate(a: Quaternion) -> Quaternion:
    """The inverse of a unit quaternion."""
    return a[0], -a[1], -a[2], -a[3]


@njit(cache=True, nogil=True, error_model="numpy")
def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton's product a b: first b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def angle(a: Quaternion) -> float:
    """Rotation angle in rad, 0..pi, accurate at both ends."""
    return 2 * math.atan2(math.sqrt(a[1] * a[1] + a[2] * a[2] + a[3] * a[3]), abs(a[0]))


@njit(cache=True, nogil=True, error_model="numpy")
def residuals(q: Floats, pairs: Ints, q_j_i: Floats) -> Floats:
    """log(R_j R_j_i R_i') of every edge: (m, 3) rotation vectors, rad, world frame.

    q (n, 4), pairs (m, 2), q_j_i (m, 4).
    """
    out = np.empty((len(pairs), 3))
    for e in range(len(pairs)):
        a = product(product(load(q, pairs[e, 1]), load(q_j_i, e)), conjugate(load(q, pairs[e, 0])))
        norm = math.sqrt(a[1] * a[1] + a[2] * a[2] + a[3] * a[3])
        scale = 2.0 if norm < 1e-12 else 2 * math.atan2(norm, abs(a[0])) / norm
        if a[0] < 0:
            scale = -scale
        out[e, 0], out[e, 1], out[e, 2] = scale * a[1], scale * a[2], scale * a[3]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def update(q: Floats, x: Floats) -> None:
    """R_i <- exp(x_i) R_i, q (n, 4) in place; x (n, 3) rad, world frame."""
    for i in range(len(q)):
        norm = math.sqrt(x[i, 0] ** 2 + x[i, 1] ** 2 + x[i, 2] ** 2)
        s = 0.5 if norm < 1e-12 else math.sin(norm / 2) / norm
        a = product((math.cos(norm / 2), s * x[i, 0], s * x[i, 1], s * x[i, 2]), load(q, i))
        length = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3])
        q[i, 0], q[i, 1], q[i, 2], q[i, 3] = a[0] / length, a[1] / length, a[2] / length, a[3] / length


@njit(cache=True, nogil=True, error_model="numpy")
def chain(pairs: Ints, q_j_i: Floats, order: Ints, via: Ints) -> Floats:
    """Rotations (n, 4) along a tree: scans in order (n,), root first, each by its edge via (n,) to a placed one.

    pairs (m, 2), q_j_i (m, 4).
    """
    q = np.zeros((len(order), 4))
    q[:, 0] = 1.0
    for k in range(1, len(order)):
        v = order[k]
        e = via[v]
        if pairs[e, 0] == v:
            a = product(load(q, pairs[e, 1]), load(q_j_i, e))
        else:
            a = product(load(q, pairs[e, 0]), conjugate(load(q_j_i, e)))
        q[v, 0], q[v, 1], q[v, 2], q[v, 3] = a
    return q
