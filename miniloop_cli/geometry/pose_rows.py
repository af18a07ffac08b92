"""Rigid transformations as rows (7,): unit quaternion w x y z, then translation. Compiled, for the votes."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry.quaternion_kernels import conjugate, product
from miniloop_cli.geometry.se3 import quaternions
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats

Row = tuple[float, float, float, float, float, float, float]


def rows(T: Floats) -> Floats:
    """Poses (m, 4, 4) as rows (m, 7)."""
    return np.hstack([quaternions(T[:, :3, :3], w_first=True), T[:, :3, 3]])


@njit(cache=True, nogil=True, error_model="numpy")
def load(T: Floats, i: int) -> Row:
    """Row i of T (n, 7)."""
    return T[i, 0], T[i, 1], T[i, 2], T[i, 3], T[i, 4], T[i, 5], T[i, 6]


@njit(cache=True, nogil=True, error_model="numpy")
def store(T: Floats, i: int, a: Row) -> None:
    """Write row i of T (n, 7)."""
    for c in range(7):
        T[i, c] = a[c]


@njit(cache=True, nogil=True, error_model="numpy")
def compose(a: Row, b: Row) -> Row:
    """a b: first b, then a."""
    q = (a[0], a[1], a[2], a[3])
    r = product(q, (b[0], b[1], b[2], b[3]))
    t = product(product(q, (0.0, b[4], b[5], b[6])), conjugate(q))
    return r[0], r[1], r[2], r[3], a[4] + t[1], a[5] + t[2], a[6] + t[3]


@njit(cache=True, nogil=True, error_model="numpy")
def invert(a: Row) -> Row:
    """The inverse of a pose."""
    q = (a[0], -a[1], -a[2], -a[3])
    t = product(product(q, (0.0, a[4], a[5], a[6])), conjugate(q))
    return q[0], q[1], q[2], q[3], -t[1], -t[2], -t[3]
