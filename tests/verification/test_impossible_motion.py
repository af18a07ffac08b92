"""Steps of a path that cannot be: which are doubted, and which are not."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.config import Averaging
from miniloop_cli.datasets import open_sequence, read_ground_truth
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.simulation.path import make_path
from miniloop_cli.verification.motion import gaps_before, impossible_steps

REAL = ("freiburg1_xyz_100", "freiburg1_desk_100", "freiburg1_desk_whole")


class Pictures:
    """Stands for the small pictures: every pair shows so many cells that agree and disagree."""

    def __init__(self, agree, against):
        self.cells = agree, against

    def votes(self, pairs, T_j_i):
        return np.tile(self.cells, (len(pairs), 1))


NOTHING_SEEN, ALIKE = Pictures(0, 0), Pictures(900, 50)


def around_a_table(n=36, turned=()):
    """Cameras around a table; those of numbers in `turned` stand on its other side."""
    angle = 2 * np.pi * np.arange(n) / n + np.pi * np.isin(np.arange(n), turned)
    R = se3.exp_so3(angle[:, None] * [0.0, 1.0, 0.0])
    return se3.pose(R, -0.6 * R[:, :, 2])


def doubted(T, pictures, hypotheses=(), stamps_s=None, depth_m=0.8):
    stamps_s = np.arange(len(T)) / 10 if stamps_s is None else stamps_s
    table = EdgeTable.of(list(hypotheses))
    gaps = gaps_before(stamps_s)
    return impossible_steps(T, np.arange(len(T)), stamps_s, gaps, depth_m, [table], Averaging(), pictures)


def hypothesis_on(i, j, T, inliers=60):
    """What matches of scans i and j say, of the poses T."""
    rows = np.zeros((inliers, 2), int)
    return Edge(i, j, rows, np.ones(inliers, bool), se3.inverse(T[j]) @ T[i])


def test_a_turntable_that_is_taken_for_its_other_side_is_doubted_at_both_ends():
    true, T = around_a_table(), around_a_table(turned=range(12, 27))
    both = [hypothesis_on(k, k + 1, true) for k in (11, 26)]
    found = doubted(T, ALIKE, both)
    assert [(step.a, step.b) for step in found] == [(11, 12), (26, 27)]
    assert all(step.contested and step.angle_deg > 165 and abs(step.usual_deg - 10) < 0.1 for step in found)
    words = found[0].sentence(10 * np.arange(36))
    assert words.startswith("between frames 110 and 120 the path turns by 170 deg and moves by 1.20 m")
    assert words.endswith("their images also agree with a step of the usual size")


def test_a_neighbour_of_the_step_may_speak_against_it():
    true, T = around_a_table(), around_a_table(turned=range(12, 36))
    assert [s.contested for s in doubted(T, ALIKE, [hypothesis_on(10, 12, true)])] == [True]
    assert doubted(T, ALIKE, [hypothesis_on(8, 9, true), hypothesis_on(14, 20, true)]) == []


def test_hypotheses_that_agree_with_the_poses_or_that_pictures_deny_contest_nothing():
    true, T = around_a_table(), around_a_table(turned=range(12, 36))
    assert doubted(T, ALIKE, [hypothesis_on(11, 12, T)]) == []
    denied = doubted(T, Pictures(100, 900), [hypothesis_on(11, 12, true)])
    assert [step.contested for step in denied] == [False]


def test_a_jump_stays_if_the_images_overlap_after_it_and_is_doubted_if_they_do_not():
    T = around_a_table(turned=range(20, 36))
    assert doubted(T, ALIKE) == []
    (step,) = doubted(T, NOTHING_SEEN)
    assert (step.a, step.b, step.contested) == (19, 20, False)
    assert "no matches between them confirm it" in step.sentence(np.arange(36))
    assert len(doubted(T, Pictures(300, 400))) == 1


def test_a_gap_in_time_is_no_jump():
    T, stamps_s = around_a_table(turned=range(20, 36)), np.arange(36) / 10
    stamps_s[20:] += 1.0
    assert doubted(T, NOTHING_SEEN, stamps_s=stamps_s) == []


def test_a_jump_of_the_position_alone_is_one():
    T = around_a_table()
    T[18:, 1, 3] += 1.0
    assert [(step.a, step.b) for step in doubted(T, NOTHING_SEEN)] == [(17, 18)]
    small = around_a_table()
    small[18:, 1, 3] += 0.1  # less than noise that a wrong depth could make
    assert doubted(small, NOTHING_SEEN) == []


def test_few_frames_and_photographs_without_order_are_not_judged(rng):
    assert doubted(around_a_table(4, [2, 3]), NOTHING_SEEN) == []
    anywhere = se3.pose(se3.exp_so3(rng.normal(0, 1.5, (60, 3))), rng.normal(size=(60, 3)))
    assert len(doubted(anywhere, NOTHING_SEEN)) <= 1


@settings(max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["loop", "xyz", "rotation", "random-walk", "still"]),
    st.integers(20, 300),
)
def test_smooth_paths_are_not_doubted(seed, name, frames):
    path = make_path(name, "room", 30.0, np.random.default_rng(seed))
    T = path(np.linspace(0, 30, frames))
    assert doubted(T, NOTHING_SEEN, stamps_s=np.linspace(0, 30, frames), depth_m=1.5) == []


@pytest.mark.real
@pytest.mark.parametrize("name", REAL)
def test_hands_do_not_jump(name):
    """True paths of real recordings, though no picture confirms a step."""
    root = os.environ.get("MINILOOP_TUM")
    if not root or not (Path(root) / name).is_dir():
        pytest.skip(f"needs {name} in the folder named by MINILOOP_TUM")
    sequence = open_sequence(Path(root) / name)
    truth = read_ground_truth(sequence)
    T, _ = associate(sequence.stamps_s, truth)
    known = np.isfinite(T).all(axis=(1, 2))
    assert known.sum() > 90
    assert doubted(T[known], NOTHING_SEEN, stamps_s=sequence.stamps_s[known], depth_m=1.0) == []
