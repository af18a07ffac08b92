"""The Levenberg-Marquardt loop that the pose graph and the bundle adjustment share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

_DAMPING_START, _DAMPING_MAX = 1e-4, 1e6
_DAMPING_MIN = 1e-9  # never zero, as it alone determines motions of the whole, which are not measured


class Problem(Protocol):
    """A problem for the loop; it keeps its own state."""

    def propose(self, damping: float) -> tuple[float, float]:
        """Cost here, and cost after the step solved with `damping` times the diagonal added (the step is kept).

        Raises numpy.linalg.LinAlgError if the equations are not positive definite.
        """
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
    """Descend until a step changes the cost by less than the tolerance, or no damping gives a lower cost.

    An iteration is one proposal, accepted or not. Only a lower cost is accepted, so cost_after <= cost_before.
    Raises numpy.linalg.LinAlgError if the equations are not positive definite for any damping.
    """
    damping, costs, converged, iterations = _DAMPING_START, [], False, 0
    while iterations < max_iterations and not converged:
        iterations += 1
        try:
            cost, proposed = problem.propose(damping)
        except np.linalg.LinAlgError:
            damping *= 10
            if damping > _DAMPING_MAX:
                raise
            continue
        converged = abs(cost - proposed) <= relative_tolerance * cost
        costs += [cost]
        if proposed < cost:
            problem.accept()
            costs += [proposed]
            damping = max(damping / 10, _DAMPING_MIN)
        else:
            damping *= 10
            converged = converged or damping > _DAMPING_MAX
    return Descent(iterations, *((costs[0], costs[-1]) if costs else (np.nan, np.nan)), converged)
