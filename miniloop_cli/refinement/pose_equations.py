"""From the residuals of pose terms to blocks of the system of the poses."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.terms import PoseTerm
from miniloop_cli.typing import Bools, Floats, Ints

_STAYING = 1e-8  # of a pose's mean curvature, in directions that no term measures


def term_pairs(terms: Sequence[PoseTerm]) -> Ints:
    """(m, 2) the pairs of poses that a term has in common."""
    found = [np.zeros((0, 2), np.int64)]
    for term in terms:
        found += [term.frames[:, [a, b]] for a, b in combinations(range(term.frames.shape[1]), 2)]
    return np.concatenate(found)


def touched(terms: Sequence[PoseTerm], count: int) -> Bools:
    """Which poses, (count,), the terms depend on."""
    found = np.zeros(count, bool)
    for term in terms:
        found[term.frames.ravel()] = True
    return found


def add_pose_terms(
    terms: Sequence[PoseTerm],
    T_world_cam: Floats,
    loose: Bools,
    damping: float,
    system: BlockSystem,
    S: Floats,
    g: Floats,
) -> None:
    """Add the terms at the poses T_world_cam (n, 4, 4) to the blocks S of the system and to the gradient g (n, 6).

    The diagonal grows by `damping` times itself. Poses that no measurement joins to others are `loose` (n,): they do
    not move in directions that no term measures.
    """
    for term in terms:
        residual, jacobian = term.linearise(T_world_cam)
        weight = term.robust.weight((residual**2).sum(axis=1))
        weighted = weight[:, None, None, None] * jacobian
        frames = term.frames
        for a in range(frames.shape[1]):
            np.add.at(g, frames[:, a], np.einsum("mdi,md->mi", weighted[:, a], residual))
            own = np.einsum("mdi,mdj->mij", weighted[:, a], jacobian[:, a])
            own[:, range(6), range(6)] *= 1 + damping
            np.add.at(S, frames[:, a], own)
        for a, b in combinations(range(frames.shape[1]), 2):
            across = np.einsum("mdi,mdj->mij", weighted[:, a], jacobian[:, b])
            turned = frames[:, a] > frames[:, b]  # blocks are those of the upper triangle
            across[turned] = across[turned].transpose(0, 2, 1)
            np.add.at(S, system.block_of(frames[:, a], frames[:, b]), across)
    if terms:
        scale = np.einsum("nii->n", S[: len(g)]) / 6 * loose
        S[: len(g)] += _STAYING * scale[:, None, None] * np.eye(6)


def pose_cost(terms: Sequence[PoseTerm], T_world_cam: Floats) -> float:
    """Half the robust cost of the terms at the poses (n, 4, 4)."""
    cost = 0.0
    for term in terms:
        residual = term.linearise(T_world_cam)[0]
        cost += 0.5 * float(term.robust.cost((residual**2).sum(axis=1)).sum())
    return cost
