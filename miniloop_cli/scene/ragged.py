"""Groups of rows of different sizes, such as the matches of each edge, gathered from several arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.typing import Ints


def rows_of(arrays: Sequence[NDArray[Any]], which: Ints, first: Ints, last: Ints) -> NDArray[Any]:
    """Rows first to last, without it, of arrays[which] (k, ...): m groups, one after the other.

    which, first, last (m,). They are copied in slices, as an index for each row would take longer and more memory.
    """
    follows = (which[1:] == which[:-1]) & (first[1:] == last[:-1])
    edge = np.ones(min(len(first), 1), bool)
    begins, ends = np.concatenate([edge, ~follows]), np.concatenate([~follows, edge])
    slices = zip(which[begins].tolist(), first[begins].tolist(), last[ends].tolist(), strict=True)
    return np.concatenate([arrays[0][:0], *(arrays[a][i:j] for a, i, j in slices)])
