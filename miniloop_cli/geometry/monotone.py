"""Where a function stops growing, and its inverse up to there for many values at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Polynomial

from miniloop_cli.typing import Floats

STEPS = 100  # bisection alone reaches the last bit in so many
NEGLIGIBLE = 1e-30  # coefficients whose term is negligible in any image


def first_root(polynomial: Polynomial) -> float:
    """The smallest positive real root, infinity if there is none."""
    kept = np.where(np.abs(polynomial.coef) < NEGLIGIBLE, 0.0, polynomial.coef)
    roots = Polynomial(kept).trim().roots()
    real = roots.real[(np.abs(roots.imag) <= 1e-7 * np.abs(roots)) & (roots.real > 0)]
    return float(real.min(initial=np.inf))


def invert_increasing(
    value: Callable[[Floats], Floats], slope: Callable[[Floats], Floats], target: Floats, end: float
) -> Floats:
    """x (n,) in [0, end] with value(x) = target (n,), where value(0) = 0 and its slope is positive below `end`.

    `end` may be infinite. Targets that are not reached before `end` give `end`. Newton's method; a step that would
    leave the bracket is replaced by a bisection.
    """
    low, high = np.zeros_like(target), np.minimum(np.full_like(target, end), np.maximum(2 * target, 1.0))
    for _ in range(STEPS):
        short = (high < end) & ~(value(high) >= target)
        if not short.any():
            break
        high[short] = np.minimum(2 * high[short], end)
    x = np.minimum(target, high)
    for _ in range(STEPS):
        difference = value(x) - target
        low, high = np.where(difference < 0, x, low), np.where(difference < 0, high, x)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = x - difference / slope(x)
        following = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        if (np.abs(following - x) <= 1e-15 * np.abs(x)).all():
            break
        x = following
    return x
