"""What an exact sparse factor of a view graph takes, foretold where trying it could take hours.

A factor fills in by as much as the graph holds together in all directions: along a recording with loops little, in a
random graph nearly everywhere. The elimination with sampled fill tells them apart in seconds. It takes edges in place
of cliques, so that what it holds is about a minor of the graph, and a minor with columns of width h needs the h^2 edges
of which exact elimination makes a full front of their size. Of random graphs (five edges a scan, 1000 to 100,000 scans)
the widest column is 1.5 times the root of the scans, and the front about half of these.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.approximate_cholesky import eliminate
from miniloop_cli.scene.view_graph import elimination
from miniloop_cli.typing import Ints

COUNTED = 20_000
"""Scans up to which the factor is made to count its work: a minute for the worst graph."""

SURELY = 10.0
"""Times what is allowed: the forecast is no better than that."""


def factor_work(count: int, pairs: Ints, allowed: float) -> float:
    """Multiplications of a factor with one row a scan, of `count` scans joined by pairs (m, 2).

    Counted; foretold where a large graph would clearly take more than `allowed`.
    """
    if count > COUNTED:
        forecast = foretold_work(count, pairs)
        if forecast > SURELY * allowed:
            return forecast
    return elimination(count, pairs)[1]


def foretold_work(count: int, pairs: Ints) -> float:
    """About the multiplications that the widest front of `count` scans, pairs (m, 2), takes: by the widest column."""
    start = eliminate(count, pairs, np.ones(len(pairs)), np.random.default_rng(0).random(99991))[1]
    front = (float(np.diff(start).max()) / 1.5) ** 2 / 2
    return front**3 / 6
