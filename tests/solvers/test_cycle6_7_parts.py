"""The steps of the six-revolute solver: equations, resultant of degree 8, real roots, Newton."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from miniloop_cli.geometry import se3
from miniloop_cli.solvers.long_cycles.six_revolute import solve_chain
from miniloop_cli.solvers.long_cycles.six_revolute_closure import closing_error, solve_in_place
from miniloop_cli.solvers.long_cycles.six_revolute_equations import axis_equations, reduce_equations
from miniloop_cli.solvers.long_cycles.six_revolute_resultant import angles_at, half_angle_forms, resultant
from miniloop_cli.solvers.long_cycles.six_revolute_roots import DEGREE, MAX_ROOTS, real_roots

EXACT = settings(derandomize=True, max_examples=100)


def about_z(angle):
    return se3.pose(Rotation.from_euler("z", angle).as_matrix(), np.zeros(3))


def random_chain(rng):
    """Links K (6, 3, 4) of a closed chain and its angles (6,)."""
    K = se3.pose(Rotation.random(6, random_state=int(rng.integers(2**31))).as_matrix(), rng.normal(size=(6, 3)))
    a = rng.uniform(-np.pi, np.pi, 6)
    rest = about_z(a[0])
    for k in range(1, 6):
        rest = about_z(a[k]) @ K[k] @ rest
    K[0] = se3.inverse(rest)
    return np.ascontiguousarray(K[:, :3]), a


def one_cos_sin(a):
    return np.array([1.0, np.cos(a), np.sin(a)])


def test_axis_coordinates_move_as_points_and_lines_do(rng):
    K, a = random_chain(rng)
    left, right = axis_equations(K)
    expected = se3.pose(K[..., :3], K[..., 3])
    expected = expected[2] @ about_z(a[1]) @ expected[1] @ about_z(a[0]) @ expected[0]
    p, l = expected[:3, 3], expected[:3, 2]
    coordinates = np.r_[p, l, np.cross(p, l), p @ p * l - 2 * (p @ l) * p, p @ p, p @ l]
    np.testing.assert_allclose(np.kron(one_cos_sin(a[0]), one_cos_sin(a[1])) @ left, coordinates, atol=1e-12)
    # The other way round the chain one arrives there too, but for the rotation about the third joint.
    there = np.kron(one_cos_sin(a[4]), one_cos_sin(a[3])) @ right
    R = about_z(a[2])[:3, :3]
    np.testing.assert_allclose(there[:12].reshape(4, 3), coordinates[:12].reshape(4, 3) @ R.T, atol=1e-12)
    np.testing.assert_allclose(there[12:], coordinates[12:], atol=1e-12)


def test_reduced_equations_hold_at_the_solution(rng):
    for _ in range(20):
        K, a = random_chain(rng)
        S = reduce_equations(*axis_equations(K))
        m12 = np.kron(one_cos_sin(a[0]), one_cos_sin(a[1]))[1:]
        m54 = np.kron(one_cos_sin(a[4]), one_cos_sin(a[3]))
        np.testing.assert_allclose(S @ np.r_[-m12, np.kron(one_cos_sin(a[2]), m54)], 0, atol=1e-12)
        assert np.abs(np.tril(S[:, :8], -1)).max() < 1e-13


def test_resultant_is_the_determinant_of_degree_8_and_gives_the_angles(rng):
    for _ in range(20):
        K, a = random_chain(rng)
        E = half_angle_forms(reduce_equations(*axis_equations(K)))
        largest, c = resultant(E)
        samples = 41
        angles = 2 * np.pi / samples * np.arange(samples)
        M = np.zeros((samples, 12, 12))
        M[:, :6, :9] = np.einsum("bs,brc->src", [np.ones(samples), np.cos(angles), np.sin(angles)], E)
        M[:, 6:, 3:] = M[:, :6, :9]
        determinants = np.linalg.det(M) / largest
        assert np.abs(np.fft.rfft(determinants)[DEGREE + 1 :]).max() < 1e-10 * np.abs(determinants).max()
        k = np.arange(1, DEGREE + 1)
        waves = angles[:, None] * k
        np.testing.assert_allclose(
            c[0] + np.cos(waves) @ c[k] + np.sin(waves) @ c[DEGREE + k], determinants, atol=1e-10
        )
        assert abs(c[0] + np.cos(a[2] * k) @ c[k] + np.sin(a[2] * k) @ c[DEGREE + k]) < 1e-10
        found = np.array(angles_at(E, a[2]))
        np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * a[3:5]), atol=1e-6)


def test_derivative_of_the_closing_error(rng):
    K, a = random_chain(rng)
    J, e = np.empty((6, 6)), np.empty(6)
    assert closing_error(K, a, J, e)[0] < 1e-13
    for k in range(6):
        b, ahead = a.copy(), np.empty(6)
        b[k] += 1e-6
        closing_error(K, b, np.empty((6, 6)), ahead)
        np.testing.assert_allclose((ahead - e) / 1e-6, J[:, k], atol=1e-5)
    b = a.copy()
    b[5] = 0.0
    assert np.isclose(np.exp(1j * closing_error(K, b, J, e)[1]), np.exp(1j * a[5]))


def test_linear_solver_against_numpy(rng):
    for _ in range(50):
        M, x = rng.normal(size=(6, 6)), rng.normal(size=6)
        expected = np.linalg.solve(M, x)
        assert solve_in_place(M.copy(), x) > 0
        np.testing.assert_allclose(x, expected, rtol=1e-8)
    assert solve_in_place(np.zeros((6, 6)), x) == 0.0
    assert solve_in_place(np.outer(np.arange(1.0, 7), np.arange(2.0, 8)), x) < 1e-15


def test_turning_a_link_about_its_axis_turns_an_angle(rng):
    K, a = random_chain(rng)
    turned = K.copy()
    turned[3] = (about_z(0.7) @ np.vstack([K[3], [0, 0, 0, 1]]))[:3]
    angles, others = np.zeros((2, 16, 6))
    count = solve_chain(K, 0.0, angles)
    assert solve_chain(turned, 0.0, others) == count > 0
    others[:, 3] += 0.7
    apart = np.abs(np.exp(1j * angles[:count, None]) - np.exp(1j * others[None, :count])).max(axis=2)
    assert apart.min(axis=1).max() < 1e-8
    assert np.abs(np.exp(1j * angles[:count]) - np.exp(1j * a)).max(axis=1).min() < 1e-9


def coefficients(laurent):
    """c (17,) of sum_k laurent[8 + k] e^{ika}."""
    upper = laurent[DEGREE + 1 :]
    return np.r_[laurent[DEGREE].real, 2 * upper.real, -2 * upper.imag]


def planted(angles):
    """prod over pairs of roots m +- h of cos(a - m) - cos h; complex h makes a complex pair."""
    laurent = np.array([1.0 + 0j])
    for m, h in angles:
        laurent = np.convolve(laurent, [np.exp(1j * m) / 2, -np.cos(h), np.exp(-1j * m) / 2])
    return coefficients(laurent)


def roots(c, near=0.0):
    out = np.zeros((MAX_ROOTS, 2))
    return out[: real_roots(np.asarray(c, float), near, out)]


@given(gaps=st.lists(st.floats(0.2, 1), min_size=16, max_size=16), start=st.floats(0, 2 * np.pi))
@EXACT
def test_sixteen_planted_roots_are_found(gaps, start):
    angles = start + 2 * np.pi * np.cumsum(gaps) / np.sum(gaps)
    pairs = angles.reshape(8, 2)
    found = roots(planted(np.c_[pairs.mean(axis=1), np.diff(pairs, axis=1)[:, 0] / 2]))
    assert len(found) == 16 and not found[:, 1].any()
    apart = np.abs(np.exp(1j * found[:, :1]) - np.exp(1j * angles))
    assert apart.min(axis=0).max() < 1e-6 and apart.min(axis=1).max() < 1e-6


def test_real_roots_agree_with_the_companion_matrix(rng):
    compared = 0
    for _ in range(500):
        c = rng.normal(size=17)
        upper = (c[1:9] - 1j * c[9:]) / 2
        z = np.roots(np.r_[upper[::-1], c[0], upper.conj()])
        off = np.abs(np.abs(z) - 1)
        if ((off > 1e-9) & (off < 1e-3)).any():
            continue  # whether that pair is real is a matter of rounding
        compared += 1
        expected = np.sort(np.angle(z[off < 1e-9]) % (2 * np.pi))
        np.testing.assert_allclose(np.sort(roots(c)[:, 0] % (2 * np.pi)), expected, atol=1e-9)
    assert compared > 450


@pytest.mark.parametrize("gap", [1e-2, 1e-4])
@pytest.mark.parametrize("middle", [0.0, 1.0, np.pi, 5.0, 0.2718 + np.pi / 2])
def test_close_roots_are_told_apart(middle, gap):
    others = [(middle + 2, 0.5), (middle + 3.5, 0.4), *[(middle + 1, 2j)] * 5]
    found = roots(planted([(middle, gap / 2), *others]))
    assert len(found) == 6 and not found[:, 1].any()
    apart = np.abs(np.exp(1j * found[:, 0]) - np.exp(1j * middle))
    assert (apart < gap).sum() == 2


@pytest.mark.parametrize("imaginary", [3e-2, 1e-2, 1e-4])
@pytest.mark.parametrize("middle", [0.0, 1.0, np.pi, 5.0, 0.2718 + np.pi / 2, 0.2718])
def test_nearly_real_pair_gives_its_real_part(middle, imaginary):
    c = planted([(middle, 1j * imaginary), (middle + 2, 0.5), (middle + 3.5, 0.4), *[(middle + 1, 2j)] * 5])
    assert len(roots(c)) == len(roots(c, near=0.7 * imaginary)) == 4
    found = roots(c, near=1.4 * imaginary)
    pair = found[found[:, 1] > 0]
    assert (found[:, 1] == 0).sum() == 4 and 1 <= len(pair) <= 2
    assert np.abs(np.exp(1j * pair[:, 0]) - np.exp(1j * middle)).max() < 0.1 * imaginary
    assert np.abs(pair[:, 1] / imaginary - 1).max() < 0.2


def test_double_root_is_found_at_least_once():
    found = roots(planted([(1.0, 0.0), (3.0, 0.5), *[(4.0, 2j)] * 6]), near=1e-3)
    assert 1 <= (np.abs(found[:, 0] - 1.0) < 1e-6).sum() <= 2


def test_no_roots_of_constants_and_nonsense():
    for c in (np.r_[1.0, np.zeros(16)], np.zeros(17), np.full(17, np.nan), np.r_[5.0, np.full(16, 0.1)]):
        assert len(roots(c)) == 0
