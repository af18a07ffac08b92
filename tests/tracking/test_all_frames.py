"""From keyframes to all frames and back."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.averaging.components import average_components
from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.features import NO_FEATURES
from miniloop_cli.scene.priors import Accelerometer, Priors
from miniloop_cli.scene.sequence import Frame, Sequence
from miniloop_cli.scene.tracked import Link, Observations, Tracked, TrackedPart, TrackStatus
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.tracking.all_frames import (
    FOLLOWED,
    in_frames,
    keyframes_only,
    of_all_frames,
    priors_of,
    with_followed,
)

KEYFRAMES = (0, 3, 5, 8, 11)
TORN = 8  # nothing ties this keyframe to those before
POINTS = 20
INFORMATION = np.diag([4.0, 5, 6, 7, 8, 9])


@pytest.fixture
def tracked():
    """Twelve frames; of 20 points of a keyframe, 15 are left at the next, which then has 20 again."""
    part, key = TrackedPart.of(0, 11), 0
    rng, tracks, following = np.random.default_rng(0), np.arange(POINTS), POINTS
    for f in range(12):
        if f not in (0, TORN):
            motion = se3.pose(se3.exp_so3(rng.normal(0, 0.1, 3)), rng.normal(0, 0.1, 3))
            part.link(f, key, Link(motion, f * INFORMATION, 15))
        if f in KEYFRAMES:
            part.set(f, TrackStatus.KEYFRAME)
            kept = tracks[:0] if f == TORN else tracks[:15]
            tracks = np.concatenate([kept, following + np.arange(POINTS - len(kept))])
            following, key = int(tracks.max()) + 1, f
        n = len(tracks)
        part.observe(Observations(np.full(n, f), tracks, *np.zeros((2, n, 2)), np.ones(n), np.zeros((n, 2))))
    part.set(6, TrackStatus.UNREADABLE, "frame 6: is cut off")
    part.key[6] = -1
    return Tracked.of([part])


def edge(i, j, verdict):
    rejection = Rejection.NONE if verdict == Verdict.VERIFIED else Rejection.FEW_INLIERS
    return Edge(i, j, np.zeros((4, 2), np.int64), np.ones(4, bool), verdict=verdict, rejection=rejection)


def test_neighbours_without_a_verified_edge_get_one_of_followed_points(tracked):
    assert tracked.keyframes.tolist() == list(KEYFRAMES)
    table = EdgeTable.of(
        [
            edge(0, 1, Verdict.VERIFIED),
            edge(1, 2, Verdict.REJECTED),
            edge(0, 2, Verdict.REJECTED),
            edge(2, 3, Verdict.WEAK),
            edge(0, 4, Verdict.VERIFIED),
        ]
    )
    found = {e.pair: e for e in with_followed(table, tracked).edges()}
    assert sorted(found) == [(0, 1), (0, 2), (0, 4), (1, 2), (2, 3), (3, 4)]
    assert [pair for pair, e in found.items() if e.solver == FOLLOWED] == [(1, 2), (3, 4)]
    for (i, j), e in found.items():
        if e.solver == FOLLOWED:
            frame = KEYFRAMES[j]
            assert (e.verdict, e.rejection, e.confirmed) == (Verdict.VERIFIED, Rejection.NONE, True)
            assert tracked.key[frame] == KEYFRAMES[i]
            assert np.array_equal(e.T_j_i, tracked.T_cam_key[frame])
            assert np.allclose(e.information, frame * INFORMATION)
            assert np.allclose(e.covariance @ e.information, np.eye(6))
            assert e.followed == e.inlier_count == 15 and len(e.matches) == 0
    kept = {e.pair: e for e in table.edges()}
    for pair in ((0, 1), (0, 2), (2, 3), (0, 4)):
        assert found[pair].verdict == kept[pair].verdict and len(found[pair].matches) == 4


def test_nothing_is_added_where_all_neighbours_are_verified(tracked):
    table = EdgeTable.of([edge(0, 1, Verdict.VERIFIED), edge(1, 2, Verdict.VERIFIED), edge(3, 4, Verdict.VERIFIED)])
    assert with_followed(table, tracked) is table
    alone = with_followed(EdgeTable.of([]), tracked)
    assert [tuple(pair) for pair in alone.pairs.tolist()] == [(0, 1), (1, 2), (3, 4)]
    assert alone.inlier_count.tolist() == [15, 15, 15] and alone.match_count.tolist() == [0, 0, 0]


def test_followed_points_survive_the_table(tracked):
    table = with_followed(EdgeTable.of([edge(0, 1, Verdict.VERIFIED)]), tracked)
    again = EdgeTable.from_arrays(table.arrays())
    assert again.followed.tolist() == table.followed.tolist() == [0, 15, 15]
    assert [e.followed for e in table.subset(table.followed > 0).edges()] == [15, 15]


def test_what_a_motion_leaves_open_is_no_edge(tracked):
    """Its covariance would have to be infinite."""
    frame = KEYFRAMES[2]
    tracked.by_surface[frame], tracked.information[frame] = True, np.diag([1e6, 1e6, 0, 0, 0, 1e6])
    pairs = with_followed(EdgeTable.of([]), tracked).pairs.tolist()
    assert [1, 2] not in pairs and [0, 1] in pairs and [3, 4] in pairs


def test_priors_are_those_of_the_keyframes():
    rng = np.random.default_rng(0)
    T, up = rng.random((12, 4, 4)), rng.random((12, 3))
    accelerometer = Accelerometer(np.arange(50.0), rng.random((50, 3)), up)
    keyframes = np.array(KEYFRAMES)
    found = priors_of(Priors(accelerometer, T), keyframes)
    assert np.array_equal(found.T_world_cam, T[keyframes])
    assert np.array_equal(found.accelerometer.up, up[keyframes])
    assert np.array_equal(found.accelerometer.readings, accelerometer.readings)  # the sensor's, not the frames'
    none = priors_of(Priors(), keyframes)
    assert none.accelerometer is None and none.T_world_cam is None


def test_the_recording_of_the_keyframes():
    frames = tuple(Frame(float(k), None, None) for k in range(12))
    sequence = Sequence("twelve", Path(), Camera(1, 1, 0, 0, 2, 2), frames)
    found = keyframes_only(sequence, np.array(KEYFRAMES))
    assert [f.timestamp_s for f in found.frames] == list(KEYFRAMES) and found.name == "twelve"
    assert found.stamps_s.tolist() == list(KEYFRAMES)


@given(st.sets(st.integers(0, 30), min_size=2), st.data())
def test_edges_between_keyframes_are_edges_between_their_frames(frames, data):
    keyframes = np.array(sorted(frames))
    ends = st.tuples(*[st.integers(0, len(keyframes) - 1)] * 2).filter(lambda pair: pair[0] < pair[1])
    table = EdgeTable.of([edge(i, j, Verdict.VERIFIED) for i, j in data.draw(st.sets(ends, max_size=6))])
    found = in_frames(table, keyframes)
    assert found.pairs.tolist() == keyframes[table.pairs].tolist()
    assert sorted(found.pairs.tolist()) == found.pairs.tolist()
    assert np.array_equal(found.matches, table.matches)


def test_extracted_scans_stand_in_the_rows_of_their_frames(tracked):
    scans = [ExtractedScan(NO_FEATURES, None, 1.0, 2.0, f"scan {k}") for k in KEYFRAMES]
    found = of_all_frames(scans, tracked)
    assert len(found) == 12
    assert {k: scan.key for k, scan in enumerate(found) if scan.key} == {k: f"scan {k}" for k in KEYFRAMES}
    assert {k: scan.problem for k, scan in enumerate(found) if scan.problem} == {6: "frame 6: is cut off"}


def test_a_followed_edge_has_weight_however_little_supports_it(tracked):
    tracked.support[:], tracked.information[:] = 0, 1e6 * np.eye(6)
    found = with_followed(EdgeTable.of([]), tracked)
    assert len(found) and (found.inlier_count == 1).all()
    poses = average_components(found, len(KEYFRAMES), Averaging())
    assert np.isfinite(poses.T_world_cam).all()
