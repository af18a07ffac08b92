"""Whether a part of the scans could have another pose with nearly as much support.

Each edge that contradicts the poses proposes a rigid motion of one of its scans and of the scans joined to it. Edges
that propose the same motion form one alternative. Moving a part of the scans gains the edges of the alternative and
loses the edges that are cut. With the Laplacians L of the edges that agree with the poses and L' of the alternative's,
both weighted by inliers, the ratio of gain to loss is x'L'x / x'Lx for the indicator x of the part. The largest ratio
of any x, a generalised eigenvalue, bounds that of every part, and the best cut along its vector x gives the part. This
does not depend on the number of scans on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.typing import Bools, Floats, Ints
from miniloop_cli.verification.second_modes import NEARLY

if TYPE_CHECKING:
    from scipy.sparse import coo_array

Weighted = tuple[Ints, Ints, Floats]  # edges (i, j, weight)
MOST_PROPOSALS = 400  # the strongest ones
LOOSE = 1e-9  # of an edge's weight, at each scan, so that L is regular
MOST_ALTERNATIVES = 5
ALIKE = 3.0  # times the largest residual of an edge: more similar motions are the same


@dataclass(frozen=True)
class Elsewhere:
    """A part of the scans (ascending) that fits at another place nearly as well.

    `angle_deg`, `distance_m`: how far it would move (median). `pairs`, `inliers`: support of that place; `pairs_here`,
    `inliers_here`: support of the present one.
    """

    scans: Ints
    angle_deg: float
    distance_m: float
    pairs: int
    inliers: int
    pairs_here: int
    inliers_here: int

    @property
    def matches_there(self) -> str:
        """The evidence for the other place in words."""
        return f"{self.inliers} matches of {self.pairs} pair{'s' if self.pairs != 1 else ''}"

    def sentence(self, frames: Ints) -> str:
        """The doubt in words; `frames` (n,): the frame number of each scan."""
        named = frames[self.scans]
        many = (
            f"frame {named[0]} fits" if len(named) == 1 else f"{len(named)} frames from {named[0]} to {named[-1]} fit"
        )
        return (
            f"{many} elsewhere nearly as well, {self.angle_deg:.0f} deg and {self.distance_m:.2f} m away: "
            f"{self.matches_there} agree with that place, {self.inliers_here} of "
            f"{self.pairs_here} with the present one"
        )


def placements_elsewhere(
    T_world_cam: Floats, scans: Ints, here: EdgeTable, others: EdgeTable, settings: Averaging, least: int
) -> list[Elsewhere]:
    """Parts of the `scans` of a component that fit at another place; T_world_cam (n, 4, 4) of all scans.

    `here`: edges that agree with the poses; `others`: those that contradict them; all between the `scans`. `least`: the
    smallest number of inliers of an alternative.
    """
    if not len(others):
        return []
    if len(others) > MOST_PROPOSALS:
        others = others.subset(np.sort(np.argsort(-others.inlier_count, kind="stable")[:MOST_PROPOSALS]))
    T_i = T_world_cam[others.i]
    motion = T_world_cam[others.j] @ others.T_j_i @ se3.inverse(T_i)
    same = _alike(motion, motion, T_i, settings)
    inverse = _alike(motion, se3.inverse(motion), T_i, settings)
    weight, left, found = others.inlier_count.astype(float), np.ones(len(others), bool), []
    for _ in range(MOST_ALTERNATIVES):
        support = ((same | inverse) & left) @ weight * left
        best = int(support.argmax())
        if support[best] < least:
            break
        ways = same[best] & left, inverse[best] & left
        part = _worst_cut(scans, here, others, weight, *ways, least)
        if part is not None:
            found.append(_described(part, motion[best], T_world_cam, here, others, ways))
        left &= ~(ways[0] | ways[1])
    return found


def _alike(a: Floats, b: Floats, T_i: Floats, settings: Averaging) -> Bools:
    """(k, k) whether the motions a[e] and b[f] move scan T_i[e] to the same pose."""
    E = se3.inverse(a @ T_i)[:, None] @ (b[None] @ T_i[:, None])
    near = se3.rotation_angle_deg(E[..., :3, :3]) < ALIKE * settings.max_residual_deg
    return near & (np.linalg.norm(E[..., :3, 3], axis=-1) < ALIKE * settings.max_residual_m)


def _worst_cut(
    scans: Ints, here: EdgeTable, others: EdgeTable, weight: Floats, forward: Bools, back: Bools, least: int
) -> Ints | None:
    """The part of the scans with the largest gain beyond NEARLY times its loss; None if there is none.

    `forward`: proposals (k,) by which their scan i moves, `back`: by which their scan j does.
    """
    n, alternative = len(scans), forward | back
    here_i, here_j = (np.searchsorted(scans, ends) for ends in (here.i, here.j))
    i, j = (np.searchsorted(scans, ends[alternative]) for ends in (others.i, others.j))
    lost, won = np.asarray(NEARLY * here.inlier_count, float), weight[alternative]
    cuts = [
        _best_cut(along, (here_i, here_j, lost), (i, j, won), forward[alternative], back[alternative], least)
        for along in _large_ratios(n, (here_i, here_j, lost), (i, j, won)).T
    ]
    worth, part = max(cuts, key=lambda cut: cut[0], default=(-np.inf, scans[:0]))
    return np.sort(scans[part]) if worth >= 0 else None


def _best_cut(
    along: Floats, lost: Weighted, won: Weighted, forward: Bools, back: Bools, least: int
) -> tuple[float, Ints]:
    """Gain of the best part (may be negative), and the part: one end of the scans as sorted by `along` (n,).

    Of both ends, the smaller one.
    """
    n = len(along)
    order = np.argsort(along, kind="stable")
    place = np.empty(n, np.int64)
    place[order] = np.arange(n)
    cut = _crossing(place[lost[0]], place[lost[1]], lost[2], n)
    i, j, weight = won
    low, high = np.minimum(place[i], place[j]), np.maximum(place[i], place[j])
    i_low = place[i] < place[j]
    low_moves, high_moves = np.where(i_low, forward, back), np.where(i_low, back, forward)
    gain = np.maximum(*(_crossing(low, high, weight * moves, n) for moves in (low_moves, high_moves)))
    worth = np.where(gain >= least, gain - cut, -np.inf)
    best = int(worth.argmax())
    return float(worth[best]), order[: best + 1] if best + 1 <= n / 2 else order[best + 1 :]


def _large_ratios(n: int, cut: Weighted, won: Weighted) -> Floats:
    """Vectors x (n, k) that span those whose x'L'x / x'Lx is 1 at least; L: Laplacian of `cut`, L' = B B': of `won`.

    L' has few edges: the ratios are the eigenvalues of the small matrix B' L^-1 B. Vectors of equal ratio are sorted by
    gain for their length, so that two joints of one part are found together.
    """
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    A, B = _incidence(n, *cut).tocsr(), _incidence(n, *won).toarray()
    L = A @ A.T + LOOSE * max(float(cut[2].max(initial=0.0)), 1.0) * eye_array(n)
    X = splu(L.tocsc(), permc_spec="MMD_AT_PLUS_A").solve(B)
    ratios, vectors = np.linalg.eigh(B.T @ X)
    Q = np.linalg.qr(X @ vectors[:, ratios >= 1])[0]
    gains, turned = np.linalg.eigh((B.T @ Q).T @ (B.T @ Q) - (A.T @ Q).T @ (A.T @ Q))
    return np.asarray(Q @ turned[:, np.argsort(-gains)])


def _incidence(n: int, i: Ints, j: Ints, weight: Floats) -> coo_array:
    """(n, m) matrix C of m weighted edges whose Laplacian is C C'."""
    from scipy.sparse import coo_array

    root, edge = np.sqrt(weight), np.arange(len(i))
    return coo_array((np.concatenate([root, -root]), (np.concatenate([i, j]), np.tile(edge, 2))), shape=(n, len(i)))


def _crossing(a: Ints, b: Ints, weight: Floats, n: int) -> Floats:
    """(n - 1,) weight of the edges (a, b) that a cut after each place 0..n - 2 crosses."""
    change = np.zeros(n)
    np.add.at(change, np.minimum(a, b), weight)
    np.add.at(change, np.maximum(a, b), -weight)
    return np.cumsum(change)[:-1]


def _described(
    part: Ints, motion: Floats, T_world_cam: Floats, here: EdgeTable, others: EdgeTable, ways: tuple[Bools, Bools]
) -> Elsewhere:
    T = T_world_cam[part]
    E = se3.inverse(T) @ motion @ T
    across = [np.isin(edges.i, part) != np.isin(edges.j, part) for edges in (here, others)]
    moved = across[1] & (ways[0] | ways[1])
    return Elsewhere(
        part,
        float(np.median(se3.rotation_angle_deg(E[:, :3, :3]))),
        float(np.median(np.linalg.norm(E[:, :3, 3], axis=1))),
        int(moved.sum()),
        int(others.inlier_count[moved].sum()),
        int(across[0].sum()),
        int(here.inlier_count[across[0]].sum()),
    )
