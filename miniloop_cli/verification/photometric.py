"""Comparison of the small views of two scans that overlap under a relative pose.

A relative pose can be wrong although many matches support it: a place looks similar, the same poster hangs in two
places, a person walks through the view. Then the rest of the two scans contradicts it: a surface of one scan is in
front of what the other saw behind it, or two surfaces coincide and look different.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from miniloop_cli.features.thumbnail import COLUMNS
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.typing import Floats, Floats32

BLOCK = 8  # cells along a block, in which brightness is compared
MIN_CELLS = 12  # that a block needs for that
MIN_DEVIATION = 4.0  # grey levels; plainer blocks are not compared
ALIKE = 0.5  # correlation of blocks that show the same
SLACK_M, SLACK = 0.03, 0.03  # allowed difference of depths: metres, and share of the depth


def compare_views(views: Iterable[tuple[View, View]], T_j_i: Floats, camera: Camera) -> list[tuple[int, int]]:
    """Numbers of cells for and against T_j_i (m, 4, 4) of each pair of views (i, j), both ways; see `_compare`."""
    lens = np.array([camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]) * (COLUMNS / camera.width)
    found = []
    for (a, b), there, back in zip(views, T_j_i, se3.inverse(T_j_i), strict=True):
        for_ab, against_ab = _compare(a.gray, a.z_m, b.gray, b.low_m, b.high_m, there, lens)
        for_ba, against_ba = _compare(b.gray, b.z_m, a.gray, a.low_m, a.high_m, back, lens)
        found.append((for_ab + for_ba, against_ab + against_ba))
    return found


@njit(cache=True, nogil=True)
def _compare(
    gray_i: Floats32, z_i: Floats32, gray_j: Floats32, low_j: Floats32, high_j: Floats32, T_j_i: Floats, lens: Floats
) -> tuple[int, int]:
    """Numbers of cells of view i for and against T_j_i; lens: fx fy cx cy in cells, cell centres at k + 0.5.

    A cell in front of the surface that j saw counts against, as j saw through it. A cell behind it does not count, nor
    does a cell whose back j sees, as walls have two sides. Cells that coincide with a surface of j are compared block
    by block: they count for if brightness correlates, against if it does not, and not at all if the block is plain in
    either view.
    """
    rows, columns = gray_i.shape
    across = (columns + BLOCK - 1) // BLOCK
    sums = np.zeros((((rows + BLOCK - 1) // BLOCK) * across, 6))
    agree = against = 0
    for y in range(rows):
        for x in range(columns):
            z = float(z_i[y, x])
            if z <= 0:
                continue
            a, b = (x + 0.5 - lens[2]) / lens[0] * z, (y + 0.5 - lens[3]) / lens[1] * z
            depth = T_j_i[2, 0] * a + T_j_i[2, 1] * b + T_j_i[2, 2] * z + T_j_i[2, 3]
            if depth < 0.2:
                continue
            u = lens[0] * (T_j_i[0, 0] * a + T_j_i[0, 1] * b + T_j_i[0, 2] * z + T_j_i[0, 3]) / depth + lens[2]
            v = lens[1] * (T_j_i[1, 0] * a + T_j_i[1, 1] * b + T_j_i[1, 2] * z + T_j_i[1, 3]) / depth + lens[3]
            if not (0.5 <= u < columns - 0.5 and 0.5 <= v < rows - 0.5):
                continue
            column, row = int(u), int(v)
            low, high = low_j[row, column], high_j[row, column]
            if high <= 0:
                continue
            slack = SLACK_M + SLACK * depth
            if depth < low - slack:
                against += 1
            elif depth <= high + slack:
                if _from_behind(z_i, x, y, T_j_i, lens):
                    continue
                u, v = u - 0.5, v - 0.5
                column, row = min(int(u), columns - 2), min(int(v), rows - 2)
                fu, fv = u - column, v - row
                above = (1 - fu) * gray_j[row, column] + fu * gray_j[row, column + 1]
                below = (1 - fu) * gray_j[row + 1, column] + fu * gray_j[row + 1, column + 1]
                p, q = float(gray_i[y, x]), (1 - fv) * above + fv * below
                block = sums[(y // BLOCK) * across + x // BLOCK]
                block[0] += 1
                block[1] += p
                block[2] += q
                block[3] += p * p
                block[4] += q * q
                block[5] += p * q
    for k in range(len(sums)):
        n = sums[k, 0]
        if n < MIN_CELLS:
            continue
        pp, qq = sums[k, 3] / n - (sums[k, 1] / n) ** 2, sums[k, 4] / n - (sums[k, 2] / n) ** 2
        pq = sums[k, 5] / n - sums[k, 1] * sums[k, 2] / n**2
        if min(pp, qq) < MIN_DEVIATION**2:
            continue
        if pq > ALIKE * np.sqrt(pp * qq):
            agree += int(n)
        else:
            against += int(n)
    return agree, against


@njit(cache=True, nogil=True)
def _from_behind(z_i: Floats32, x: int, y: int, T_j_i: Floats, lens: Floats) -> bool:
    """Whether view j sees the back of the surface in cell (x, y) of view i; its normal is from two neighbours."""
    z = float(z_i[y, x])
    a, b = (x + 0.5 - lens[2]) / lens[0], (y + 0.5 - lens[3]) / lens[1]
    n0, n1, n2 = a, b, 1.0  # away from i; along the ray if the neighbours do not give a normal
    if x + 1 < z_i.shape[1] and y + 1 < z_i.shape[0]:
        right, below = float(z_i[y, x + 1]), float(z_i[y + 1, x])
        if max(abs(right - z), abs(below - z)) < SLACK_M + SLACK * z and min(right, below) > 0:
            r0, r1, r2 = a * (right - z) + right / lens[0], b * (right - z), right - z
            d0, d1, d2 = a * (below - z), b * (below - z) + below / lens[1], below - z
            n0, n1, n2 = r1 * d2 - r2 * d1, r2 * d0 - r0 * d2, r0 * d1 - r1 * d0
    facing = 0.0
    for k in range(3):
        p = (T_j_i[k, 0] * a + T_j_i[k, 1] * b + T_j_i[k, 2]) * z + T_j_i[k, 3]
        facing += p * (T_j_i[k, 0] * n0 + T_j_i[k, 1] * n1 + T_j_i[k, 2] * n2)
    return facing < 0
