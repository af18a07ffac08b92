"""Recordings taken for rigid bodies: which could stand elsewhere, which are bent, and what two of them both show."""

import numpy as np
import pytest

from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.verification.joints import bends, bodies_elsewhere, votes_of_joints

K = 6  # keyframes a recording
BODY = np.repeat([0, 1, 2], K)
SHIFT = se3.pose(se3.exp_so3(np.array([0.0, 0.0, 3.0])), np.array([1.5, 0.5, 0.0]))


def building():
    """Three recordings that go on where the one before ends, far from the world's origin."""
    angle = 0.1 * np.arange(3 * K)[:, None] * [0.0, 0.0, 1.0]
    return se3.pose(se3.exp_so3(angle), 0.3 * np.arange(3 * K)[:, None] * [1.0, 0.2, 0.0] + [40.0, -30.0, 1.0])


def shifted_near(T_world_cam):
    """The motion SHIFT about where a camera stands."""
    there = se3.pose(np.eye(3), T_world_cam[:3, 3])
    return there @ SHIFT @ se3.inverse(there)


def said(T, i, j, inliers, rng=None):
    rows, kept = np.zeros((inliers, 2), int), np.ones(inliers, bool)
    T_j_i = se3.inverse(T[j]) @ T[i]
    if rng is not None:  # a degree and a centimetre
        T_j_i = se3.pose(se3.exp_so3(rng.normal(0, 0.01, 3)), rng.normal(0, 0.01, 3)) @ T_j_i
    return Edge(i, j, rows, kept, T_j_i, verdict=Verdict.VERIFIED)


def joints(T, rng=None, inliers=50):
    pairs = [(K - 2, K), (K - 1, K + 1), (K - 1, K), (2 * K - 1, 2 * K), (2 * K - 2, 2 * K), (2 * K - 1, 2 * K + 1)]
    return [said(T, i, j, inliers, rng) for i, j in pairs]


@pytest.mark.parametrize(("moved", "border"), [([2], 2 * K), ([1, 2], K), ([0], K)])
def test_recordings_that_would_fit_elsewhere_nearly_as_well_are_named(moved, border, rng):
    """Three edges of 50 matches join the one side to the other; three of 30 say that it stands elsewhere."""
    T, elsewhere = building(), building()
    elsewhere[np.isin(BODY, moved)] = shifted_near(T[border]) @ elsewhere[np.isin(BODY, moved)]
    others = [
        said(elsewhere, i, j, 30, rng)
        for i, j in [(border - 1, border), (border - 2, border + 1), (border - 1, border + 2)]
    ]
    (found,) = bodies_elsewhere(T, BODY, EdgeTable.of(joints(T, rng)), EdgeTable.of(others), Averaging())
    assert set(found.scans) in (set(moved), {0, 1, 2} - set(moved))
    assert (found.inliers, found.pairs, found.inliers_here, found.pairs_here) == (90, 3, 150, 3)
    assert abs(found.angle_deg - np.degrees(3.0)) < 3


def test_little_support_for_another_place_is_no_doubt(rng):
    T, elsewhere = building(), building()
    elsewhere[BODY == 2] = shifted_near(T[2 * K]) @ elsewhere[BODY == 2]
    here = EdgeTable.of(joints(T, rng))
    weak = EdgeTable.of([said(elsewhere, 2 * K - 1, 2 * K, 60, rng)])  # 60 against 150
    assert bodies_elsewhere(T, BODY, here, weak, Averaging()) == []
    far = [se3.pose(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(4)]
    each = [said(np.where((BODY == 2)[:, None, None], M @ T, T), K + k, 2 * K + k, 60) for k, M in enumerate(far)]
    assert bodies_elsewhere(T, BODY, here, EdgeTable.of(each), Averaging()) == []  # each says something else
    assert bodies_elsewhere(T, BODY, here, EdgeTable.of([]), Averaging()) == []


def test_a_recording_that_the_others_bend_is_named_with_the_step():
    own, T = building(), building()
    T[BODY == 1] = SHIFT @ T[BODY == 1]  # it stands elsewhere as a whole: no bend
    assert bends(T, own, BODY, Averaging()) == {}
    for k, tenths in ((K + 2, 2), (K + 4, 3)):
        T[k : 2 * K] = (
            T[k] @ se3.pose(se3.exp_so3(np.array([0, 0.1 * tenths, 0])), np.zeros(3)) @ se3.inverse(T[k]) @ T[k : 2 * K]
        )
    found = bends(T, own, BODY, Averaging())
    assert set(found) == {1}
    assert (found[1].a, found[1].b) == (K + 3, K + 4)
    assert abs(found[1].angle_deg - np.degrees(0.3)) < 1e-6


class Pictures:
    """Stands for the small pictures: scans of one body and the next see the same, and cells say by their numbers."""

    def neighbours(self, T_world_cam, scans, group):
        pairs = np.array([(i, j) for i in scans for j in scans if i < j and group[j] - group[i] == 1])
        return pairs, se3.inverse(T_world_cam[pairs[:, 1]]) @ T_world_cam[pairs[:, 0]]

    def votes(self, pairs, T_j_i):
        assert T_j_i.shape == (len(pairs), 4, 4)
        return np.stack([np.full(len(pairs), 3), pairs[:, 0] // K], axis=1)


def test_what_two_recordings_both_show_is_counted_for_each_two():
    """Of those that look in similar directions: scans of the path turn by 5.7 degrees, so that they are 15 pairs."""
    found = votes_of_joints(building(), np.arange(3 * K), BODY, Pictures())
    assert {pair: votes.tolist() for pair, votes in found.items()} == {(0, 1): [45, 0], (1, 2): [45, 15]}
    assert list(votes_of_joints(building(), np.arange(2 * K), BODY, Pictures())) == [(0, 1)]
    assert not votes_of_joints(building(), np.arange(K - 2, K + 2), BODY, Pictures())  # four pairs are too few
