"""A solved pair of scans, and all pairs of a recording as one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from miniloop_cli.scene.ragged import rows_of
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.typing import Bools, Floats, Ints, Pair

FOLLOWED = "followed"  # instead of a solver's name: the edge comes from tracked points or surfaces


@dataclass(frozen=True)
class Edge:
    """One pair of scans, i < j, and the result of a solver.

    `matches` (k, 2) feature rows in i and j, `inliers` (k,); `T_j_i` (4, 4) maps points of scan i into scan j;
    `information` and `covariance` (6, 6) of the perturbation [exp(w) | v] T_j_i; `cycle`: number of the cycle that was
    solved, -1 for a pair; `loops`: loops over verified edges whose agreement verified it; `confirmed`: a prior confirms
    it, so that it needs no loop of edges; `followed`: number of tracked points from i to j that agree (they are not
    features, and have no rows).
    """

    i: int
    j: int
    matches: Ints
    inliers: Bools
    T_j_i: Floats = field(default_factory=lambda: np.eye(4))
    information: Floats = field(default_factory=lambda: np.zeros((6, 6)))
    covariance: Floats = field(default_factory=lambda: np.full((6, 6), np.inf))
    solver: str = "pairwise"
    cycle: int = -1
    hypotheses: int = 0
    verdict: Verdict = Verdict.REJECTED
    rejection: Rejection = Rejection.NO_HYPOTHESIS
    detail: tuple[float, float] = (0.0, 0.0)
    loops: int = 0
    confirmed: bool = False
    followed: int = 0

    @property
    def pair(self) -> Pair:
        """The two scans."""
        return self.i, self.j

    @property
    def inlier_count(self) -> int:
        """Number of inliers, or of tracked points that agree."""
        return int(self.inliers.sum()) + self.followed


RAGGED = ("start", "matches", "inliers")  # columns with rows of their own


@dataclass(frozen=True)
class EdgeTable:
    """m edges as columns, sorted by (i, j): see Edge for their meaning.

    i, j, cycle, hypotheses, loops (m,) int; T_j_i (m, 4, 4); information, covariance (m, 6, 6); solver (m,) names;
    verdict, rejection (m,) numbers of Verdict and Rejection; detail (m, 2) the numbers of the rejection;
    confirmed (m,) bool; followed (m,) int. `matches` (k, 2) and `inliers` (k,) of all edges one after the other, those
    of edge e from start[e] to start[e + 1].
    """

    i: Ints
    j: Ints
    T_j_i: Floats
    information: Floats
    covariance: Floats
    solver: NDArray[np.str_]
    cycle: Ints
    hypotheses: Ints
    verdict: Ints
    rejection: Ints
    detail: Floats
    loops: Ints
    confirmed: Bools
    followed: Ints
    start: Ints
    matches: Ints
    inliers: Bools

    @staticmethod
    def of(edges: Sequence[Edge]) -> EdgeTable:
        """The table of single edges, sorted by (i, j)."""
        edges = sorted(edges, key=lambda edge: edge.pair)
        ends = np.cumsum([0, *(len(edge.matches) for edge in edges)], dtype=np.int64)

        def column(name: str, dtype: Any, *shape: int) -> NDArray[Any]:
            return np.array([getattr(edge, name) for edge in edges], dtype).reshape(len(edges), *shape)

        return EdgeTable(
            column("i", np.int64),
            column("j", np.int64),
            column("T_j_i", float, 4, 4),
            column("information", float, 6, 6),
            column("covariance", float, 6, 6),
            column("solver", np.str_) if edges else np.zeros(0, "<U8"),
            column("cycle", np.int64),
            column("hypotheses", np.int64),
            column("verdict", np.int64),
            column("rejection", np.int64),
            column("detail", float, 2),
            column("loops", np.int64),
            column("confirmed", bool),
            column("followed", np.int64),
            ends,
            np.concatenate([np.zeros((0, 2), np.int64), *(edge.matches for edge in edges)]),
            np.concatenate([np.zeros(0, bool), *(edge.inliers for edge in edges)]),
        )

    @staticmethod
    def concatenated(tables: Sequence[EdgeTable]) -> EdgeTable:
        """All edges of tables that share no pair, sorted by (i, j)."""
        tables = [table for table in tables if len(table)] or list(tables[:1])
        if len(tables) == 1:
            return tables[0]
        columns = {
            column.name: np.concatenate([getattr(table, column.name) for table in tables])
            for column in fields(EdgeTable)
            if column.name not in RAGGED
        }
        order = np.lexsort((columns["j"], columns["i"]))
        columns = {name: column[order] for name, column in columns.items()}
        table = np.repeat(np.arange(len(tables)), [len(one) for one in tables])[order]
        first, last = (np.concatenate([one.start[k : len(one) + k] for one in tables])[order] for k in (0, 1))
        return EdgeTable(**columns, **_matches_of(tables, table, first, last))

    @staticmethod
    def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> EdgeTable:
        """The table that `arrays` gave."""
        return EdgeTable(**{column.name: arrays[column.name] for column in fields(EdgeTable)})

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All columns by name."""
        return {column.name: getattr(self, column.name) for column in fields(self)}

    def __len__(self) -> int:
        return len(self.i)

    @property
    def pairs(self) -> Ints:
        """(m, 2) scans of each edge."""
        return np.stack([self.i, self.j], axis=1)

    @property
    def match_count(self) -> Ints:
        """(m,) matches."""
        return np.diff(self.start)

    @property
    def inlier_count(self) -> Ints:
        """(m,) numbers of inliers, or of tracked points that agree."""
        inliers = np.diff(np.concatenate([np.zeros(1, np.int64), np.cumsum(self.inliers)])[self.start])
        return inliers + self.followed

    @property
    def verified(self) -> Bools:
        """(m,) whether an edge is verified."""
        return self.verdict == Verdict.VERIFIED

    @property
    def open(self) -> Bools:
        """(m,) whether an edge is verified or weak."""
        return self.verdict != Verdict.REJECTED

    def inlier_rows(self, edge: int) -> Ints:
        """(k, 2) feature rows of an edge's inliers."""
        part = slice(self.start[edge], self.start[edge + 1])
        return self.matches[part][self.inliers[part]]

    def edge(self, k: int) -> Edge:
        """One row."""
        part = slice(self.start[k], self.start[k + 1])
        return Edge(
            int(self.i[k]),
            int(self.j[k]),
            self.matches[part],
            self.inliers[part],
            self.T_j_i[k],
            self.information[k],
            self.covariance[k],
            str(self.solver[k]),
            int(self.cycle[k]),
            int(self.hypotheses[k]),
            Verdict(int(self.verdict[k])),
            Rejection(int(self.rejection[k])),
            (float(self.detail[k, 0]), float(self.detail[k, 1])),
            int(self.loops[k]),
            bool(self.confirmed[k]),
            int(self.followed[k]),
        )

    def edges(self) -> list[Edge]:
        """All rows, for the few places that replace single edges."""
        return self.edges_of(np.ones(len(self), bool))

    def edges_of(self, which: Bools) -> list[Edge]:
        """The rows of a mask (m,)."""
        return [self.edge(k) for k in np.flatnonzero(which).tolist()]

    def subset(self, which: ArrayLike) -> EdgeTable:
        """The edges of a mask (m,) or of ascending row numbers."""
        rows = np.arange(len(self))[np.asarray(which)]
        if len(rows) == len(self):
            return self
        columns = {name: column[rows] for name, column in self.arrays().items() if name not in RAGGED}
        one = np.zeros(len(rows), np.int64)
        return EdgeTable(**columns, **_matches_of([self], one, self.start[rows], self.start[rows + 1]))

    def rounded(self) -> EdgeTable:
        """With T_j_i to seven decimals, as the last bits depend on how this process compiled the kernels."""
        return replace(self, T_j_i=np.round(self.T_j_i, 7) + 0.0, detail=np.round(self.detail, 7) + 0.0)

    def inliers_only(self) -> EdgeTable:
        """The table with inlier matches only."""
        kept = np.concatenate([np.zeros(1, np.int64), np.cumsum(self.inliers)])[self.start]
        return replace(self, start=kept, matches=self.matches[self.inliers], inliers=self.inliers[self.inliers])

    def replaced(self, edges: Sequence[Edge]) -> EdgeTable:
        """The table with these edges in place of those of the same pairs, or added to it."""
        return EdgeTable.of(list({edge.pair: edge for edge in (*self.edges(), *edges)}.values()))

    def judged_as(self, other: EdgeTable, which: Bools) -> EdgeTable:
        """The table with verdicts and reasons of another one of the same edges, for the edges of a mask (m,)."""
        return replace(
            self,
            verdict=np.where(which, other.verdict, self.verdict),
            rejection=np.where(which, other.rejection, self.rejection),
            detail=np.where(which[:, None], other.detail, self.detail),
        )

    def reject(self, which: Bools, why: Rejection, a: ArrayLike = 0.0, b: ArrayLike = 0.0) -> EdgeTable:
        """The table with the edges of a mask (m,) rejected; one that was rejected before keeps its reason.

        a, b: the numbers of the reason, for all edges (m,) or one for all of them.
        """
        which = which & self.open
        detail = np.stack(np.broadcast_arrays(np.asarray(a, float), np.asarray(b, float), np.zeros(len(self)))[:2], 1)
        return replace(
            self,
            verdict=np.where(which, Verdict.REJECTED, self.verdict),
            rejection=np.where(which, why, self.rejection),
            detail=np.where(which[:, None], detail, self.detail),
        )

    def reasons(self) -> list[str]:
        """A sentence for each edge: why it is not verified, or what verified it besides its inliers; else ""."""
        counts = zip(self.inlier_count.tolist(), self.match_count.tolist(), strict=True)
        said = zip(self.verdict, self.rejection, self.detail.tolist(), self.loops, counts, strict=True)
        return [
            f"{Rejection.FEW_INLIERS.sentence(*count)}; {loops} loops over verified edges agree"
            if loops and verdict == Verdict.VERIFIED
            else Rejection(int(rejection)).sentence(*detail)
            for verdict, rejection, detail, loops, count in said
        ]


def _matches_of(tables: Sequence[EdgeTable], table: Ints, first: Ints, last: Ints) -> dict[str, NDArray[Any]]:
    """The RAGGED columns of m edges, each with the matches first..last (m,) of tables[table]."""
    return {
        "start": np.concatenate([np.zeros(1, np.int64), np.cumsum(last - first)]),
        "matches": rows_of([one.matches for one in tables], table, first, last),
        "inliers": rows_of([one.inliers for one in tables], table, first, last),
    }
