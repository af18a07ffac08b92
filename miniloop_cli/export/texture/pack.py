"""Rectangles packed into one image, row by row."""

from __future__ import annotations

import numpy as np

from miniloop_cli.typing import Ints

SLACK = 1.06  # area of the image over that of its rectangles, as rows leave gaps


def pack(sizes: Ints) -> tuple[Ints, int, int]:
    """Left top corners (n, 2) of rectangles (n, 2: width, height) in a roughly square image, and its width and height.

    Rows of decreasing height leave small gaps.
    """
    if not len(sizes):
        return np.zeros((0, 2), np.int64), 1, 1
    width = max(int(sizes[:, 0].max()), int(np.ceil(np.sqrt(SLACK * float((sizes[:, 0] * sizes[:, 1]).sum())))))
    corners = np.zeros((len(sizes), 2), np.int64)
    x = y = row_height = 0
    for k in np.lexsort((-sizes[:, 0], -sizes[:, 1])).tolist():
        w, h = sizes[k].tolist()
        if x + w > width:
            x, y, row_height = 0, y + row_height, 0
        corners[k] = x, y
        x, row_height = x + w, max(row_height, h)
    return corners, width, y + row_height
