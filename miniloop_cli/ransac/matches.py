"""3D matches: edge by edge, as callers give them, and packed into arrays for the compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.typing import Floats, Ints, Pair

if TYPE_CHECKING:
    pass
from typing import NamedTuple

from miniloop_cli.errors import MiniloopError
from miniloop_cli.scene.points import ScanPoints


@dataclass(frozen=True)
class EdgeMatches:
    """3D-3D matches from one scan to another: p (m, 3) and q (m, 3) metres, covariances (m, 3, 3) m^2."""

    p: Floats
    q: Floats
    cov_p: Floats
    cov_q: Floats

    def __len__(self) -> int:
        return len(self.p)

    @property
    def reversed(self) -> EdgeMatches:
        """The same matches seen from the other scan."""
        return EdgeMatches(self.q, self.p, self.cov_q, self.cov_p)


class Packed(NamedTuple):
    """Matches of all edges of a pair or a cycle, one column a match.

    P, Q (3, N) points (m); CP, CQ (6, N) their covariances as xx xy xz yy yz zz (m^2); start (edges + 1,): the
    matches of edge e are the columns [start[e], start[e + 1]); with more than one edge the last is the closing one.
    """

    P: Floats
    Q: Floats
    CP: Floats
    CQ: Floats
    start: Ints


def pack(edges: Sequence[EdgeMatches]) -> Packed:
    """Structure of arrays for the kernels. Raises MiniloopError for shapes that do not fit and for NaN or infinity."""
    for number, edge in enumerate(edges):
        m = len(edge.p)
        shapes = [np.shape(x) for x in (edge.p, edge.q, edge.cov_p, edge.cov_q)]
        if shapes != [(m, 3), (m, 3), (m, 3, 3), (m, 3, 3)]:
            raise MiniloopError(f"matches of edge {number}: expected p, q (m, 3), cov_p, cov_q (m, 3, 3), got {shapes}")
    rows, columns = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
    P, Q = (
        np.ascontiguousarray(np.concatenate(x, dtype=float).T) for x in ([e.p for e in edges], [e.q for e in edges])
    )
    CP, CQ = (
        np.ascontiguousarray(np.concatenate(x, dtype=float)[:, rows, columns].T)
        for x in ([e.cov_p for e in edges], [e.cov_q for e in edges])
    )
    packed = Packed(P, Q, CP, CQ, np.cumsum([0] + [len(e) for e in edges], dtype=np.int64))
    if not all(np.isfinite(x).all() for x in packed[:4]):
        bad = ~(np.isfinite(P) & np.isfinite(Q)).all(axis=0) | ~(np.isfinite(CP) & np.isfinite(CQ)).all(axis=0)
        e = int(np.searchsorted(packed.start, bad.argmax(), "right")) - 1
        raise MiniloopError(f"matches of edge {e}: point or covariance {bad.argmax() - packed.start[e]} is not finite")
    return packed


def edge_matches(points: Sequence[ScanPoints], pair: Pair, rows: Ints) -> EdgeMatches:
    """Matches of a pair in space, from scan pair[0] to scan pair[1]; rows (k, 2) number the features."""
    a, b = points[pair[0]], points[pair[1]]
    return EdgeMatches(
        a.points_m[rows[:, 0]], b.points_m[rows[:, 1]], a.covariances_m2[rows[:, 0]], b.covariances_m2[rows[:, 1]]
    )
