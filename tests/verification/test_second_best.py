"""Second-best answers: parts of the scans that fit elsewhere nearly as well, and second modes of matches."""

import numpy as np
import pytest

from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.verification.second_best import placements_elsewhere
from miniloop_cli.verification.second_modes import second_modes

N = 20
SHIFT = se3.pose(se3.exp_so3(np.array([0.0, 2.0, 0.0])), np.array([1.5, 0.0, 0.5]))


def path(count=N):
    angle = 0.15 * np.arange(count)[:, None] * [0.0, 1.0, 0.0]
    return se3.pose(se3.exp_so3(angle), 0.3 * np.arange(count)[:, None] * [1.0, 0.0, 0.2])


def said(T, i, j, inliers):
    i, j = min(i, j), max(i, j)
    rows, kept = np.zeros((inliers, 2), int), np.ones(inliers, bool)
    return Edge(i, j, rows, kept, se3.inverse(T[j]) @ T[i], verdict=Verdict.VERIFIED)


def chain(T, inliers=50, reach=2):
    return [said(T, i, j, inliers) for i in range(len(T)) for j in range(i + 1, min(i + reach + 1, len(T)))]


def doubts(T, here, others, scans=None):
    scans = np.arange(N) if scans is None else scans
    return placements_elsewhere(T, scans, EdgeTable.of(here), EdgeTable.of(others), Averaging(), 20)


@pytest.mark.parametrize("moved", [range(12, N), range(7)])
def test_a_part_that_fits_elsewhere_nearly_as_well_is_named(moved):
    """Three edges of 50 matches join the parts; four of 30 say that one of them stands elsewhere."""
    T, elsewhere = path(), path()
    elsewhere[list(moved)] = SHIFT @ elsewhere[list(moved)]
    border = moved[0] if moved[0] else moved[-1] + 1
    others = [said(elsewhere, border - a, border + b, 30) for a, b in [(1, 0), (2, 1), (3, 2), (1, 3)]]
    (found,) = doubts(T, chain(T), others)
    assert set(found.scans) == set(moved)
    assert (found.pairs, found.inliers, found.pairs_here, found.inliers_here) == (4, 120, 3, 150)
    assert abs(found.angle_deg - np.degrees(2.0)) < 1e-6
    words = found.sentence(10 * np.arange(N))
    assert words.startswith(
        f"{len(moved)} frames from {10 * moved[0]} to {10 * moved[-1]} fit elsewhere nearly as well"
    )
    assert "120 matches of 4 pairs agree with that place, 150 of 3 with" in words


def test_a_part_of_a_long_recording_is_named_too():
    T, elsewhere = path(2000), path(2000)
    elsewhere[1300:] = SHIFT @ elsewhere[1300:]
    others = [said(elsewhere, 1300 - a, 1300 + b, 30) for a, b in [(1, 0), (2, 1), (3, 2), (1, 3)]]
    (found,) = doubts(T, chain(T), others, np.arange(2000))
    assert set(found.scans) == set(range(1300, 2000))
    assert doubts(T, chain(T), others[:2], np.arange(2000)) == []


def test_motions_that_are_their_own_inverse_count_from_both_ends():
    """A part in the middle, half turned about an axis: at one end the earlier scan moves, at the other the later."""
    T, axis = path(), se3.pose(np.eye(3), np.array([3.0, 0.0, 2.0]))
    half_turn = axis @ se3.pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)) @ se3.inverse(axis)
    elsewhere = path()
    elsewhere[6:14] = half_turn @ elsewhere[6:14]
    others = [said(elsewhere, i, j, 40) for i, j in [(5, 6), (4, 7), (5, 7), (13, 14), (12, 15), (13, 15)]]
    (found,) = doubts(T, chain(T), others)
    assert set(found.scans) == set(range(6, 14)) or set(found.scans) == {*range(6), *range(14, N)}
    assert (found.pairs, found.inliers, found.inliers_here) == (6, 240, 300)


def test_little_support_or_none_is_no_doubt(rng):
    T, elsewhere = path(), path()
    elsewhere[12:] = SHIFT @ elsewhere[12:]
    weak = [said(elsewhere, 11, 12, 30), said(elsewhere, 10, 13, 30)]
    assert doubts(T, chain(T), weak) == []  # 60 against 150
    assert doubts(T, chain(T, 30, 1), [said(elsewhere, 11, 12, 19)]) == []  # nearly as well, but hardly anything
    anywhere = [
        said(se3.pose(se3.exp_so3(rng.normal(size=(N, 3))), rng.normal(size=(N, 3))), i, i + 5, 45) for i in range(14)
    ]
    assert doubts(T, chain(T), anywhere) == []  # each says something else
    assert doubts(T, chain(T), []) == []


def test_motions_in_opposite_directions_do_not_add_up():
    """Half of the edges would move the later part there, the other half the earlier one: no part suits both."""
    T, there, back = path(), path(), path()
    there[12:], back[:12] = SHIFT @ there[12:], SHIFT @ back[:12]
    others = [said(there, 11, 12, 40), said(there, 10, 13, 25), said(back, 11, 13, 40), said(back, 10, 12, 25)]
    assert doubts(T, chain(T), others) == []
    assert len(doubts(T, chain(T), [*others[:2], said(there, 11, 13, 40)])) == 1


def test_scans_of_another_component_are_left_alone():
    T, scans = path(), np.arange(5, N)
    elsewhere = path()
    elsewhere[12:] = SHIFT @ elsewhere[12:]
    here = [edge for edge in chain(T) if edge.i >= 5]
    (found,) = doubts(T, here, [said(elsewhere, 11, 12, 80), said(elsewhere, 10, 13, 20)], scans)
    assert set(found.scans) in ({*range(12, N)}, {*range(5, 12)})


def matched(p, q):
    """Two scans with these points (k, 3), row k of each a match."""
    cov = np.tile(np.eye(3) * 1e-5, (len(p), 1, 1))
    return [ScanPoints(x, cov) for x in (p, q)]


@pytest.mark.parametrize(("second", "found"), [(40, True), (20, False)])
def test_the_second_mode_of_matches_is_found_where_it_is_nearly_as_strong(second, found, rng):
    T, other, strays = np.eye(4), SHIFT, 15
    p = rng.uniform([-1, -1, 1], [1, 1, 3], (60 + second + strays, 3))
    q = np.concatenate([p[:60], se3.transform(other, p[60 : 60 + second]), rng.uniform(-1, 3, (strays, 3))])
    rows = np.repeat(np.arange(len(p))[:, None], 2, axis=1)
    edge = Edge(0, 1, rows, np.arange(len(p)) < 60, T, np.eye(6), np.eye(6), verdict=Verdict.VERIFIED)
    modes = second_modes(
        EdgeTable.of([edge]), matched(p, q), load_settings().estimation, Averaging(), 0, Workers(1, True)
    )
    assert len(modes) == found
    if found:
        np.testing.assert_allclose(modes.T_j_i[0], other, atol=0.01)
        assert modes.inlier_count[0] >= 38
        assert np.array_equal(modes.matches[: len(rows) - 60], rows[60:])


def test_a_second_mode_that_is_the_first_again_is_none(rng):
    p = rng.uniform([-1, -1, 1], [1, 1, 3], (80, 3))
    rows = np.repeat(np.arange(80)[:, None], 2, axis=1)
    edge = Edge(0, 1, rows, np.arange(80) < 45, np.eye(4), np.eye(6), np.eye(6), verdict=Verdict.VERIFIED)
    modes = second_modes(
        EdgeTable.of([edge]), matched(p, p), load_settings().estimation, Averaging(), 0, Workers(1, True)
    )
    assert len(modes) == 0
