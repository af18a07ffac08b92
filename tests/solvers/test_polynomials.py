"""Real roots on the circle against planted roots, numpy's companion matrix, and the awkward cases."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from miniloop_cli.solvers._kernels.polynomials import ROWS, roots_on_circle

EXACT = settings(derandomize=True, max_examples=200)


def roots(f, nearly_real=0.0):
    """Sorted angles in [0, 2 pi) at which the trigonometric polynomial f (2d+1,) vanishes."""
    memory = np.empty((ROWS, 12))
    memory[0, : len(f)] = f
    count = roots_on_circle(memory, len(f) // 2, nearly_real)
    np.testing.assert_allclose(np.hypot(memory[1, :count], memory[2, :count]), 1, atol=1e-14)
    return np.sort(np.arctan2(memory[2, :count], memory[1, :count]) % (2 * np.pi))


def from_laurent(c):
    """C_0, C_1, S_1, ... of sum_k c[d + k] e^{ika}, which has to be real."""
    d = len(c) // 2
    f = [c[d].real]
    for k in range(1, d + 1):
        f += [2 * c[d + k].real, -2 * c[d + k].imag]
    return np.array(f)


def planted(angles):
    """The trigonometric polynomial prod_j (cos(a - m_j) - cos h_j) over pairs of roots m_j +- h_j."""
    c = np.array([1.0 + 0j])
    for first, second in np.reshape(angles, (-1, 2)):
        m, h = (first + second) / 2, (first - second) / 2
        c = np.convolve(c, [np.exp(1j * m) / 2, -np.cos(h), np.exp(-1j * m) / 2])
    return from_laurent(c)


def companion_roots(f):
    """All real roots by eigenvalues: z = e^{ia} of the polynomial z^d f."""
    d = len(f) // 2
    up = [(f[2 * k - 1] - 1j * f[2 * k]) / 2 for k in range(1, d + 1)]
    c = np.array([*np.conj(up[::-1]), f[0], *up])
    z = np.roots(c[::-1])
    return z, np.sort(np.angle(z[np.abs(np.abs(z) - 1) < 1e-9]) % (2 * np.pi))


angle = st.floats(0, 2 * np.pi, exclude_max=True)


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 8])
@given(data=st.data())
@EXACT
def test_planted_roots_are_found(count, data):
    gaps = np.array(data.draw(st.lists(st.floats(0.05, 1.0), min_size=count, max_size=count)))
    angles = data.draw(angle) + 2 * np.pi * np.cumsum(gaps) / gaps.sum()
    found = roots(planted(angles))
    assert len(found) == count
    difference = np.exp(1j * found[:, None]) - np.exp(1j * angles)
    assert np.abs(difference).min(axis=0).max() < 1e-7
    assert np.abs(difference).min(axis=1).max() < 1e-7


@pytest.mark.parametrize("size", [5, 9])
def test_agrees_with_companion_matrix(size, rng):
    compared = 0
    for _ in range(1000):
        f = rng.normal(size=size)
        z, expected = companion_roots(f)
        near = np.abs(np.abs(z) - 1)
        if ((near > 1e-9) & (near < 1e-3)).any():
            continue  # whether that pair is real is a matter of rounding
        compared += 1
        np.testing.assert_allclose(roots(f), expected, atol=1e-9)
    assert compared > 900


@pytest.mark.parametrize("first", [0.0, 0.3, np.pi / 2, np.pi, -1e-9, np.pi - 1e-9, 2.0])
@pytest.mark.parametrize("count", [4, 8])
def test_double_root_is_found_at_least_once(count, first):
    others = first + 0.5 + 0.4 * np.arange(count - 2)
    f = planted([first, first, *others])
    found = roots(f, nearly_real=1e-3)
    offset = np.abs(np.exp(1j * found) - np.exp(1j * first))
    assert 1 <= (offset < 1e-6).sum() <= 2
    assert len(found) - (offset < 1e-6).sum() == count - 2


@pytest.mark.parametrize("gap", [1e-1, 1e-3, 1e-5, 1e-6])
def test_nearly_double_roots_are_told_apart(gap):
    found = roots(planted([1.0, 1.0 + gap, 3.0, 4.0]))
    assert len(found) == 4
    np.testing.assert_allclose(found, [1, 1 + gap, 3, 4], atol=1e-15 / gap + 1e-12)


@pytest.mark.parametrize("apart", [0.3, 1e-2, 1e-4])
@pytest.mark.parametrize("middle", [0.0, 1.0, np.pi / 2, np.pi, 4.0])
def test_nearly_real_pair_gives_its_real_part(middle, apart):
    # cos(a - m) - cosh h has the complex roots m +- ih, the other factor two real ones.
    pair = np.array([np.exp(1j * middle) / 2, -np.cosh(apart), np.exp(-1j * middle) / 2])
    real = np.array([np.exp(1j * (middle + 2)) / 2, -np.cos(0.5), np.exp(-1j * (middle + 2)) / 2])
    f = from_laurent(np.convolve(pair, real))
    assert len(roots(f)) == 2
    assert len(roots(f, nearly_real=0.7 * apart)) == 2
    found = roots(f, nearly_real=1.3 * apart)
    assert len(found) == 3
    assert np.abs(np.exp(1j * found) - np.exp(1j * middle)).min() < 2 * apart**2 + 1e-12


@pytest.mark.parametrize("size", [5, 9])
def test_vanishing_leading_coefficient_is_a_root_at_180_degrees(size, rng):
    for _ in range(50):
        f = rng.normal(size=size)
        f[0] -= sum(c * (-1) ** ((k + 1) // 2) for k, c in enumerate(f) if k == 0 or k % 2)
        assert np.abs(roots(f) - np.pi).min() < 1e-12


def test_lower_degree_and_constants():
    np.testing.assert_allclose(roots(np.array([0, 1.0, 0, 0, 0])), [np.pi / 2, 3 * np.pi / 2])
    np.testing.assert_allclose(roots(np.array([-0.5, 1.0, 0, 0, 0, 0, 0, 0, 0])), [np.pi / 3, 5 * np.pi / 3])
    assert len(roots(np.array([1.0, 0, 0, 0, 0]))) == 0
    assert len(roots(np.array([2.0, 1.0, 0, 0.5, 0]))) == 0


@pytest.mark.parametrize("size", [5, 9])
def test_no_roots_of_nonsense(size):
    for value in (0.0, np.nan, np.inf):
        assert len(roots(np.full(size, value))) == 0
    for i in range(size):
        f = np.ones(size)
        f[i] = np.nan
        assert len(roots(f)) == 0


@pytest.mark.parametrize("size", [5, 9])
def test_scale_does_not_matter(size, rng):
    f = rng.normal(size=size)
    expected = roots(f)
    for scale in (1e-200, 1e-30, -1.0, 1e30, 1e200):
        np.testing.assert_allclose(roots(scale * f), expected, atol=1e-12)


@given(shift=angle, seed=st.integers(0, 1000))
@EXACT
def test_turning_the_circle_turns_the_roots(shift, seed):
    f = np.random.default_rng(seed).normal(size=9)
    z, expected = companion_roots(f)
    assume(np.abs(np.abs(z) - 1)[np.abs(np.abs(z) - 1) > 1e-9].min(initial=1) > 1e-3)
    turned = f.copy()
    for k in range(1, 5):
        c, s = f[2 * k - 1], f[2 * k]
        turned[2 * k - 1] = c * np.cos(k * shift) - s * np.sin(k * shift)
        turned[2 * k] = s * np.cos(k * shift) + c * np.sin(k * shift)
    found = roots(turned)
    assert len(found) == len(expected)
    if len(found):
        difference = np.abs(np.exp(1j * found[:, None]) - np.exp(1j * (expected + shift)))
        assert difference.min(axis=0).max() < 1e-8
