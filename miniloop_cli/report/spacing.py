"""Evenly spaced rows, where a page cannot show all."""

from __future__ import annotations

from functools import cache

import numpy as np

from miniloop_cli.typing import Ints


@cache
def evenly_spaced(count: int, most: int) -> Ints:
    """Rows (k,) of `count`: all, or `most` evenly spaced ones; ascending, none twice."""
    return np.linspace(0, max(count - 1, 0), min(most, count)).round().astype(np.int64)
