"""Whether a part of the scans could stand elsewhere, with nearly as much support as it has where it is.

Edges that contradict the poses each propose to move one of their scans, and what hangs on it, by a rigid motion. Those
that propose the same motion are one alternative. A part of the scans is worth moving if the support that this wins
comes near to what it loses: the edges that are cut. With the Laplacians L of the edges that agree with the poses and
L' of the alternative's, both weighted by inliers, that is x'(s L - L')x < 0 for the indicator x of some part; where
the lowest eigenvalue is not negative there is none. Else its eigenvector tells the part, by the best cut along it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.typing import Bools, Floats, Ints
from miniloop_cli.verification.second_modes import NEARLY

MOST_PROPOSALS = 400  # the strongest
MOST_SCANS = 1500  # of a component: the eigenvector is found by dense algebra
MOST_ALTERNATIVES = 5
ALIKE = 3.0  # times the largest residual of an edge: motions that propose the same


@dataclass(frozen=True)
class Elsewhere:
    """A part of the scans (ascending) that another rigid motion suits nearly as well.

    `angle_deg`, `distance_m`: how far it would move (median). `pairs`, `inliers`: what supports that; `pairs_here`,
    `inliers_here`: what joins the part to the others where it is.
    """

    scans: Ints
    angle_deg: float
    distance_m: float
    pairs: int
    inliers: int
    pairs_here: int
    inliers_here: int

    def sentence(self, frames: Ints) -> str:
        """The doubt in words; `frames` (n,): the frame number of each scan."""
        named = frames[self.scans]
        many = (
            f"frame {named[0]} fits" if len(named) == 1 else f"{len(named)} frames from {named[0]} to {named[-1]} fit"
        )
        return (
            f"{many} elsewhere nearly as well, {self.angle_deg:.0f} deg and {self.distance_m:.2f} m away: "
            f"{self.inliers} matches of {self.pairs} pairs agree with that, {self.inliers_here} of {self.pairs_here} "
            "join them to the others where they are"
        )


def placements_elsewhere(
    T_world_cam: Floats, scans: Ints, here: EdgeTable, others: EdgeTable, settings: Averaging, least: int
) -> list[Elsewhere]:
    """Parts of the `scans` of a component that could stand elsewhere; poses (n, 4, 4) of all scans.

    `here`: edges that agree with the poses, `others`: that contradict them, all between the `scans`; `least`: inliers
    that an alternative needs.
    """
    if not len(others) or len(scans) > MOST_SCANS:
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
    """(k, k) whether motion a[e] takes scan T_i[e] to where b[f] takes it."""
    E = se3.inverse(a @ T_i)[:, None] @ (b[None] @ T_i[:, None])
    near = se3.rotation_angle_deg(E[..., :3, :3]) < ALIKE * settings.max_residual_deg
    return near & (np.linalg.norm(E[..., :3, 3], axis=-1) < ALIKE * settings.max_residual_m)


def _worst_cut(
    scans: Ints, here: EdgeTable, others: EdgeTable, weight: Floats, forward: Bools, back: Bools, least: int
) -> Ints | None:
    """The part of the scans that the alternative could move with most support beyond NEARLY what it cuts; else None.

    `forward`: proposals (k,) by which their scan i moves, `back`: by which their scan j does.
    """
    n, alternative = len(scans), forward | back
    here_i, here_j = (np.searchsorted(scans, ends) for ends in (here.i, here.j))
    i, j = (np.searchsorted(scans, ends[alternative]) for ends in (others.i, others.j))
    lost, won = np.asarray(NEARLY * here.inlier_count, float), weight[alternative]
    M = np.zeros((n, n))
    for a, b, w in ((here_i, here_j, lost), (i, j, -won)):
        np.add.at(M, (a, b), -w)
        np.add.at(M, (b, a), -w)
        np.add.at(M, (a, a), w)
        np.add.at(M, (b, b), w)
    values, vectors = np.linalg.eigh(M)
    if values[0] >= 0:
        return None
    order = np.argsort(vectors[:, 0], kind="stable")
    place = np.empty(n, np.int64)
    place[order] = np.arange(n)
    cut = _crossing(place[here_i], place[here_j], lost, n)
    low, high = np.minimum(place[i], place[j]), np.maximum(place[i], place[j])
    i_low = place[i] < place[j]
    low_moves = np.where(i_low, forward[alternative], back[alternative])
    high_moves = np.where(i_low, back[alternative], forward[alternative])
    gain = np.maximum(*(_crossing(low, high, won * moves, n) for moves in (low_moves, high_moves)))
    worth = np.where(gain >= least, gain - cut, -np.inf)
    best = int(worth.argmax())
    if worth[best] < 0:
        return None
    part = order[: best + 1] if best + 1 <= n / 2 else order[best + 1 :]
    return np.sort(scans[part])


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
