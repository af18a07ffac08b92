"""Scans that match others by outlines only: of things before a wall, where no surface has any texture.

What is seen where one thing ends before another lies on either of both, and elsewhere on them when seen from
elsewhere. A few such matches among many do little harm; where there is little else, they agree well enough to pass for
an overlap, and its pose is centimetres off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.scene.edge import Edge
from miniloop_cli.typing import Bools

MAX_SHARE = 0.5  # of a scan's matches, if there are few others; 0.53 to 1 without texture, else 0.05 to 0.35
MIN_OTHER_MATCHES = 20  # other matches in one overlap: then outlines do not decide


def by_outlines(edges: Sequence[Edge], outline: Sequence[Bools]) -> dict[int, str]:
    """Scans that the inliers of these edges place by outlines, with this reason; `outline`: of each scan's features."""
    total, on, others = np.zeros((3, len(outline)), np.int64)
    for edge in edges:
        rows = edge.matches[edge.inliers]
        count = len(rows)
        on_outline = np.count_nonzero(outline[edge.i][rows[:, 0]] | outline[edge.j][rows[:, 1]])
        for scan in (edge.i, edge.j):
            total[scan] += count
            on[scan] += on_outline
            others[scan] = max(others[scan], count - on_outline)
    share = on / np.maximum(total, 1)
    return {
        int(scan): f"scan {scan}: {100 * share[scan]:.0f} % of its matches lie on outlines, which move with the "
        f"view, and no overlap has {MIN_OTHER_MATCHES} others"
        for scan in np.flatnonzero((share > MAX_SHARE) & (others < MIN_OTHER_MATCHES))
    }
