"""Scans that match others at depth discontinuities only, as with objects before a wall and no texture anywhere.

A feature at the outline of an object has the depth of either surface, and its position on the surfaces changes with the
viewpoint. A few such matches among many do little harm. Alone, they can agree well enough for an edge whose pose is
wrong by centimetres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.typing import Bools, Floats

MAX_SHARE = 0.5  # of a scan's matches, if there are few others; 0.53 to 1 without texture, else 0.05 to 0.35
MIN_OTHER_MATCHES = 20  # other matches in one overlap: then discontinuities do not decide


def share_on_discontinuities(edges: EdgeTable, outline: Sequence[Bools]) -> Floats:
    """(n,) share of a scan's inliers that lie at depth jumps, for scans whose edges depend on them; else 0.

    `outline`: whether depth jumps at each feature, of each scan.
    """
    total, jumps, others = np.zeros((3, len(outline)), np.int64)
    for edge, pair in enumerate(edges.pairs):
        rows = edges.inlier_rows(edge)
        on_jump = np.count_nonzero(outline[pair[0]][rows[:, 0]] | outline[pair[1]][rows[:, 1]])
        total[pair] += len(rows)
        jumps[pair] += on_jump
        others[pair] = np.maximum(others[pair], len(rows) - on_jump)
    share = jumps / np.maximum(total, 1)
    return np.where((share > MAX_SHARE) & (others < MIN_OTHER_MATCHES), share, 0.0)
