"""Followed points as measurements: enough of them for every frame, and rows of the right frames."""

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.followed import (
    MIN_LENGTH,
    chosen_tracks,
    followed_measurements,
    joined,
    motions,
    surface_motions,
    weakly_measured,
)
from miniloop_cli.refinement.inputs import Between
from miniloop_cli.refinement.joint import untied
from miniloop_cli.refinement.timing import Measurements
from miniloop_cli.scene.tracked import Observations

CAMERA = Camera(525.0, 520.0, 319.5, 239.5, 640, 480)


@st.composite
def followed(draw):
    """frame, track (k,) of tracks that begin somewhere and last for some frames, in any order."""
    spans = draw(st.lists(st.tuples(st.integers(0, 12), st.integers(1, 9)), min_size=1, max_size=40))
    rows = [(f, t) for t, (first, length) in enumerate(spans) for f in range(first, first + length)]
    frame, track = np.array(draw(st.permutations(rows))).T
    return frame, track


@given(followed(), st.integers(1, 8))
def test_every_frame_has_enough_or_all_of_the_long_tracks(seen, per_frame):
    frame, track = seen
    chosen = chosen_tracks(frame, track, per_frame)
    length = np.bincount(track)
    assert len(chosen) == len(length) and not chosen[length < MIN_LENGTH].any()
    long = (length >= MIN_LENGTH)[track]
    has, could = (np.bincount(frame[rows], minlength=frame.max() + 1) for rows in (chosen[track], long))
    assert (has >= np.minimum(per_frame, could)).all()
    # None is there for nothing: without the last one chosen, one of its frames would have too few.
    if chosen.any():
        order = sorted(np.flatnonzero(chosen), key=lambda t: (-length[t], t))
        last = frame[track == order[-1]]
        assert (has[last] - 1 < per_frame).any()


@given(followed())
def test_all_long_tracks_take_part_where_there_are_few(seen):
    frame, track = seen
    assert np.array_equal(chosen_tracks(frame, track, 1000), np.bincount(track) >= MIN_LENGTH)


def test_no_tracks_are_no_measurements():
    none = np.zeros(0, np.int64)
    assert len(chosen_tracks(none, none, 10)) == 0


def observed(frame, track, px, z_m):
    slope = np.stack([z_m, -z_m], axis=1)
    seen = Observations(np.array(frame), np.array(track), px, px + 0.5, z_m, slope)
    stamps_s = 10.0 + np.arange(4)
    return Between(SimpleNamespace(seen=seen), stamps_s, stamps_s + 0.01 * np.arange(4))


def test_measurements_are_rows_of_what_was_seen():
    rng = np.random.default_rng(0)
    frame, track = [0, 1, 2, 0, 1, 1, 2, 3], [0, 0, 0, 1, 1, 2, 2, 2]
    px, z_m = rng.uniform(0, 480, (8, 2)), rng.uniform(1, 2, 8)
    px[0, 1], px[2, 1] = 0.0, 479.0
    found = followed_measurements(observed(frame, track, px, z_m), np.ones(4, bool), CAMERA, 5)
    rows = [0, 1, 2, 5, 6, 7]  # track 1 is too short
    assert found.frame.tolist() == [0, 1, 2, 1, 2, 3] and found.track.tolist() == [0, 0, 0, 1, 1, 1]
    assert np.array_equal(found.px_ideal, px[rows] + 0.5) and np.array_equal(found.z_m, z_m[rows])
    assert np.allclose(found.row_share[[0, 2]], [-239.5 / 480, 239.5 / 480])
    assert np.allclose(found.stamp_lag_s, [0, 0.01, 0.02, 0.01, 0.02, 0.03])
    # Frames without a pose would draw the points they share with others to nowhere.
    without = followed_measurements(observed(frame, track, px, z_m), np.array([False, True, True, True]), CAMERA, 5)
    assert without.frame.tolist() == [1, 2, 3] and without.track.tolist() == [0, 0, 0]


def test_features_of_keyframes_and_followed_points_are_told_apart():
    def some(frame, track):
        k = len(frame)
        ends = np.array(frame, np.int64), np.array(track, np.int64)
        return Measurements(*ends, np.zeros(k), np.zeros((k, 2)), np.ones(k), np.zeros((k, 2)), np.zeros(k))

    found = joined(some([0, 1, 2], [0, 0, 1]), np.array([0, 7, 9]), some([6, 7, 8], [0, 0, 0]))
    assert found.frame.tolist() == [0, 7, 9, 6, 7, 8]
    assert found.track.tolist() == [0, 0, 1, 2, 2, 2]
    none = some([], [])
    alone = joined(none, np.array([0, 7, 9]), some([6, 7], [0, 0]))
    assert alone.frame.tolist() == [6, 7] and alone.track.tolist() == [0, 0]
    assert joined(some([0, 2], [0, 0]), np.array([0, 7, 9]), none).frame.tolist() == [0, 9]


def pieces():
    """Frames 0 to 2 share tracks, frame 3 has none; its motion is known from keyframe 0."""
    frame = np.tile(np.arange(3), 12)
    track = np.repeat(np.arange(12), 3)
    k = len(frame)
    measured = Measurements(frame, track, np.zeros(k), np.zeros((k, 2)), np.ones(k), np.zeros((k, 2)), np.zeros(k))
    tracked = SimpleNamespace(
        key=np.array([-1, 0, 0, 0]),
        T_cam_key=np.tile(np.eye(4), (4, 1, 1)),
        information=np.tile(np.eye(6), (4, 1, 1)),
        T_by_surface=np.tile(np.eye(4), (4, 1, 1)),
        surface_information=np.array([0, 0, 0, 1])[:, None, None] * np.eye(6),
    )
    return measured, Between(tracked, np.arange(4.0), np.arange(4.0))


def test_a_frame_without_tracks_is_untied_until_a_motion_joins_it():
    measured, between = pieces()
    known = np.ones(4, bool)
    assert untied(measured.track, measured.frame, known).tolist() == [3]
    assert weakly_measured(between, known, measured).tolist() == [3]
    assert untied(measured.track, measured.frame, known, motions(between, known, np.array([3]))).tolist() == []
    assert untied(measured.track, measured.frame, np.array([True, True, True, False])).tolist() == []


def test_a_motion_counts_only_between_frames_that_have_poses():
    _, between = pieces()
    assert motions(between, np.array([False, True, True, True]), np.array([3])) == []
    assert motions(between, np.array([True, True, True, False]), np.array([3])) == []
    (term,) = motions(between, np.ones(4, bool), np.array([0, 3]))  # frame 0 was followed from none
    assert term.frames.tolist() == [[0, 3]]


def test_a_motion_known_in_part_takes_part_but_does_not_tie():
    measured, between = pieces()
    known = np.ones(4, bool)
    between.tracked.surface_information[3] = np.diag([1e6, 1e6, 0, 0, 0, 1e6])
    (term,) = surface_motions(between, known, weakly_measured(between, known, measured))
    assert term.frames.tolist() == [[0, 3]] and not term.full.any()
    assert untied(measured.track, measured.frame, known, [term]).tolist() == [3]


def test_depth_alone_weighs_where_points_are_measured_themselves():
    """The motion of a frame comes from points and depth; its points must not count twice."""
    _, between = pieces()
    between.tracked.information[3] *= 7
    (whole,), (by_surface,) = (f(between, np.ones(4, bool), np.array([3])) for f in (motions, surface_motions))
    assert np.allclose(whole.root[0].T @ whole.root[0], 7 * np.eye(6))
    assert np.allclose(by_surface.root[0].T @ by_surface.root[0], np.eye(6))
