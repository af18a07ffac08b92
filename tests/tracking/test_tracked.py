"""Parts of a recording that were followed, joined to the whole."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.geometry import se3
from miniloop_cli.scene.partial_motion import PartialMotion
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.tracked import Link, Observations, Tracked, TrackedPart, TrackStatus


def observations(frame, track, rng):
    k = len(frame)
    return Observations(
        np.array(frame, np.int64),
        np.array(track, np.int64),
        rng.random((k, 2)),
        rng.random((k, 2)),
        rng.random(k),
        rng.random((k, 2)),
    )


def random_part(first, last, rng):
    """A part in which frames are followed from keyframes, and some show nothing."""
    part, key = TrackedPart.of(first, last), first
    for f in range(first, last + 1):
        blank = rng.random() < 0.2 and first < f < last
        if f > first and not blank:
            motion = se3.pose(se3.exp_so3(rng.normal(0, 0.1, 3)), rng.normal(0, 0.1, 3))
            shape = PartialMotion(np.eye(4), rng.random() * np.eye(6)) if rng.integers(2) else None
            part.link(
                f, key, Link(motion, rng.random() * np.eye(6), int(rng.integers(9)), shape, bool(rng.integers(2)))
            )
        if blank:
            part.set(f, TrackStatus.BLANK, f"blank {f}")
        elif f in (first, last) or rng.random() < 0.3:
            part.set(f, TrackStatus.KEYFRAME)
            key = f
        if not blank:
            tracks = np.flatnonzero(rng.random(6) < 0.6)
            part.observe(observations(np.full(len(tracks), f), tracks, rng))
    return part


@st.composite
def recordings(draw):
    """Parts that share their ends, and a generator."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    ends = np.cumsum([0, *draw(st.lists(st.integers(1, 8), min_size=1, max_size=4))]).tolist()
    return [random_part(a, b, rng) for a, b in pairwise(ends)]


@given(recordings())
def test_joined_parts_are_the_recording(parts):
    whole = Tracked.of(parts)
    assert len(whole) == parts[-1].first + len(parts[-1].status)
    for f in range(len(whole)):
        # The first part that holds a frame knows the motion that leads to it.
        part = next(p for p in parts if p.first <= f < p.first + len(p.status))
        row = f - part.first
        for name in ("status", "problem", "key"):
            assert getattr(whole, name)[f] == getattr(part, name)[row]
        assert np.array_equal(whole.T_cam_key[f], part.T_cam_key[row])
        assert np.array_equal(whole.information[f], part.information[row])
    keyframes = set(whole.keyframes.tolist())
    assert all(part.first in keyframes for part in parts) and len(whole) - 1 in keyframes
    assert all(int(key) in keyframes for key in whole.key[whole.key >= 0])


@given(recordings())
def test_joined_tracks_are_those_of_the_parts(parts):
    whole = Tracked.of(parts).seen
    own = [Observations.joined(part.seen) for part in parts]
    names = [(p, t) for p, seen in enumerate(own) for t in seen.track.tolist()]
    for name in ("frame", "px", "px_ideal", "z_m", "slope"):
        assert np.array_equal(getattr(whole, name), np.concatenate([getattr(seen, name) for seen in own]))
    number_of = dict(zip(names, whole.track.tolist(), strict=True))
    assert [number_of[name] for name in names] == whole.track.tolist()  # one number a track ...
    assert len(set(number_of.values())) == len(number_of)  # ... and one track a number


@given(recordings())
def test_a_part_comes_back_from_its_arrays(parts):
    for part in parts:
        arrays = part.arrays()
        again = TrackedPart.from_arrays(arrays)
        assert again.first == part.first
        assert all(np.array_equal(again.arrays()[name], array) for name, array in arrays.items())


@given(recordings())
def test_all_poses_are_composed_from_keyframes(parts):
    whole, rng = Tracked.of(parts), np.random.default_rng(0)
    n = len(whole)
    T = se3.pose(se3.exp_so3(rng.normal(0, 1, (n, 3))), rng.normal(0, 1, (n, 3)))
    linked = whole.key >= 0
    whole.T_cam_key[linked] = se3.inverse(T[linked]) @ T[whole.key[linked]]
    component = rng.integers(-1, 2, n)
    keyframes = whole.keyframes
    found = whole.all_poses(Poses(T[keyframes], component[keyframes]))
    for f in range(n):
        if whole.status[f] == TrackStatus.KEYFRAME:
            assert found.component[f] == component[f]
        elif whole.status[f] == TrackStatus.FOLLOWED:
            assert found.component[f] == component[whole.key[f]]
        else:
            assert found.component[f] == -1
    placed = found.component >= 0
    assert np.allclose(found.T_world_cam[placed], T[placed])
    assert np.isfinite(found.T_world_cam).all()


def test_long_words_about_a_frame_are_cut():
    part = TrackedPart.of(3, 5)
    part.set(4, TrackStatus.UNREADABLE, "x" * 5000)
    assert part.problem[1] == "x" * 400 and part.status.tolist() == [0, 2, 0]
