"""The Levenberg-Marquardt loop that the pose graph and the bundle adjustment share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

_DAMPING_START, _DAMPING_MIN, _DAMPING_MAX = 1e-4, 1e-10, 1e6


class Problem(Protocol):
    """What the loop needs of a problem, which keeps its own state."""

    def propose(self, damping: float) -> tuple[float, float]:
        """Cost here, and cost after the step solved with `damping` times the diagonal added (the step is kept)."""
        ...

    def accept(self) -> None:
        """Move to the last proposal."""
        ...


@dataclass(frozen=True)
class Descent:
    """How a minimisation went: costs are half the sum of robust squared residuals."""

    iterations: int
    cost_before: float
    cost_after: float
    converged: bool


def minimise(problem: Problem, max_iterations: int, relative_tolerance: float) -> Descent:
    """Descend until a step changes the cost by less than the tolerance, or no damping helps any more.

    An iteration is one proposal, accepted or not. Only a lower cost is accepted, so cost_after <= cost_before.
    """
    damping, first, cost, converged, iterations = _DAMPING_START, None, 0.0, False, 0
    while iterations < max_iterations and not converged:
        cost, proposed = problem.propose(damping)
        iterations += 1
        first = cost if first is None else first
        converged = abs(cost - proposed) <= relative_tolerance * cost
        if proposed < cost:
            problem.accept()
            cost = proposed
            damping = max(damping / 10, _DAMPING_MIN)
        else:
            damping *= 10
            converged = converged or damping > _DAMPING_MAX
    return Descent(iterations, cost if first is None else first, cost, converged)
