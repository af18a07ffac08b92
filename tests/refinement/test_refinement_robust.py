import numpy as np
import pytest

from miniloop_cli.refinement.levenberg_marquardt import minimise
from miniloop_cli.refinement.robust import KERNELS, noise_gain, robust, weight_and_curvature


@pytest.mark.parametrize("kernel", list(KERNELS))
@pytest.mark.parametrize("s", [0.0, 1e-12, 0.3, 5.0, 1e4, 1e12])
def test_weight_is_the_derivative_of_the_cost(kernel, s):
    rho, w = robust(KERNELS[kernel], s, 9.0)
    h = 1e-5 * (1 + s)
    slope = (robust(KERNELS[kernel], s + h, 9.0)[0] - rho) / h
    assert w == pytest.approx(slope, rel=1e-3, abs=1e-9)
    assert rho <= s
    assert weight_and_curvature(kernel, np.array([s]), 3.0, 2)[0] == pytest.approx(w)


@pytest.mark.parametrize("kernel", list(KERNELS))
@pytest.mark.parametrize("dimension", [1, 2, 6])
def test_curvature_is_the_mean_second_derivative(kernel, dimension):
    r = np.linspace(0.2, 1.7, dimension)
    h, H = 1e-4, 0.0

    def cost(x):
        return robust(KERNELS[kernel], float(x @ x), 4.0)[0] / 2

    for e in np.eye(dimension):
        H += (cost(r + h * e) - 2 * cost(r) + cost(r - h * e)) / h**2 / dimension
    assert weight_and_curvature(kernel, np.array([r @ r]), 2.0, dimension)[1] == pytest.approx(H, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", list(KERNELS))
def test_noise_gain_is_that_of_a_location_estimate(kernel):
    rng = np.random.default_rng(0)
    dimension, scale, samples, trials = 2, 3.0, 200, 1500
    x = rng.standard_normal((trials, samples, dimension))
    location = np.zeros((trials, 1, dimension))
    for _ in range(40):
        w = weight_and_curvature(kernel, ((x - location) ** 2).sum(axis=2), scale, dimension)[0][..., None]
        location = (w * x).sum(axis=1, keepdims=True) / w.sum(axis=1, keepdims=True)
    promised = noise_gain(kernel, scale, dimension) / w.sum(axis=1).mean()
    assert location.var() == pytest.approx(promised, rel=0.08)


class _Quartic:
    """x^4 by Gauss-Newton on x^2, optionally with equations that fail at small damping."""

    def __init__(self, fails_below=0.0):
        self.x, self.fails_below = 3.0, fails_below

    def propose(self, damping):
        if damping < self.fails_below:
            raise np.linalg.LinAlgError
        self.next = self.x - self.x / 2 / (1 + damping)
        return self.x**4 / 2, self.next**4 / 2

    def accept(self):
        self.x = self.next


def test_descends_until_nothing_changes():
    problem = _Quartic()
    found = minimise(problem, 100, 1e-3)
    assert found.cost_before == 40.5
    assert found.cost_after == problem.x**4 / 2
    assert not minimise(_Quartic(), 2, 1e-3).converged


def test_more_damping_where_the_equations_fail():
    found = minimise(_Quartic(fails_below=1e-2), 60, 0.5)
    assert found.cost_after < found.cost_before
    with pytest.raises(np.linalg.LinAlgError):
        minimise(_Quartic(fails_below=np.inf), 60, 1e-3)
