"""The work of an exact sparse factor of a view graph, predicted if counting it could take hours.

Fill depends on how densely the graph is connected: it is small for a recording with loops, and nearly complete for a
random graph. The elimination with sampled fill tells them apart in seconds: it replaces cliques by edges, so a column
of width h in it stands for about h^2 edges, which exact elimination turns into a full front. For random graphs (five
edges a scan, 1000 to 100,000 scans) the widest column is 1.5 times the square root of the number of scans, and the
front has about half of the scans.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.approximate_cholesky import eliminate, sampling_numbers
from miniloop_cli.scene.view_graph import elimination
from miniloop_cli.typing import Ints

COUNTED = 20_000
"""Up to this number of scans the work is counted, which takes a minute for the worst graph."""

SURELY = 10.0
"""The prediction is within this factor of the work."""


def factor_work(count: int, pairs: Ints, allowed: float) -> float:
    """Multiplications of a factor with one row a scan, for `count` scans and pairs (m, 2).

    Counted, or predicted if a large graph would clearly need more than `allowed`.
    """
    if count > COUNTED:
        forecast = predicted_work(count, pairs)
        if forecast > SURELY * allowed:
            return forecast
    return elimination(count, pairs)[1]


def predicted_work(count: int, pairs: Ints) -> float:
    """Predicted multiplications of the widest front, for `count` scans and pairs (m, 2), from the widest column."""
    start = eliminate(count, pairs, np.ones(len(pairs)), sampling_numbers())[1]
    front = (float(np.diff(start).max()) / 1.5) ** 2 / 2
    return front**3 / 6
