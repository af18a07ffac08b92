"""The one-to-one association of two lists of time stamps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.typing import Floats, Ints

MAX_DIFFERENCE_S = 0.02
NEIGHBOURS = 32  # candidates on either side of a stamp; a depth camera of 1600 Hz would need more


def associate(
    first_s: Sequence[float] | Floats,
    second_s: Sequence[float] | Floats,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> Ints:
    """One-to-one association of stamps `first_s` (a,) and `second_s` (b,), both sorted: (m, 2) indices, by the first.

    All pairs within `max_difference_s` are taken in the order of their difference, each stamp at most once
    (what the TUM benchmark's association does); of equal differences the earlier pair wins.
    """
    a, b = np.asarray(first_s, float), np.asarray(second_s, float)
    if not len(a) or not len(b):
        return np.zeros((0, 2), np.int64)
    j = np.searchsorted(b, a)[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS)
    i = np.broadcast_to(np.arange(len(a))[:, None], j.shape)
    valid = (j >= 0) & (j < len(b))
    i, j = i[valid], j[valid]
    difference = np.abs(a[i] - b[j])
    near = difference <= max_difference_s
    i, j, difference = i[near], j[near], difference[near]
    taken_a, taken_b = np.zeros(len(a), bool), np.zeros(len(b), bool)
    pairs = []
    for k in np.lexsort((j, i, difference)):
        if not taken_a[i[k]] and not taken_b[j[k]]:
            taken_a[i[k]] = taken_b[j[k]] = True
            pairs.append((i[k], j[k]))
    return np.array(sorted(pairs), np.int64).reshape(-1, 2)
