"""Frames that lie on the path in another order than their stamps say, and images that repeat those before them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from walls import path, recording, wall_frames

from miniloop_cli.config import Depth, Tracking
from miniloop_cli.geometry import se3
from miniloop_cli.scene.sequence import NoteKind
from miniloop_cli.scene.tracked import Repeat, Tracked, TrackStatus
from miniloop_cli.tracking.front_end import track_part
from miniloop_cli.tracking.order import exchanged, followed_path, notes_on_order
from miniloop_cli.tracking.repeated import notes_on_repeats

N = 40


@pytest.fixture(scope="module")
def truth():
    return path(N)


@pytest.fixture(scope="module")
def frames(truth):
    return wall_frames(truth)


def tracked(frames):
    return Tracked.of([track_part(recording(frames), Depth(), Tracking(), 0, len(frames) - 1)])


def with_color(frames, changes):
    return [replace(f, color=frames[changes.get(k, k)].color) for k, f in enumerate(frames)]


def with_depth(frames, changes):
    return [replace(f, depth=frames[changes.get(k, k)].depth) for k, f in enumerate(frames)]


@given(st.sets(st.integers(2, 30), max_size=4), st.integers(0, 2**32 - 1))
def test_exchanged_neighbours_are_found_on_any_path(chosen, seed):
    rng = np.random.default_rng(seed)
    speed, turn = rng.normal(size=3), rng.normal(size=3)
    speed, turn = 0.012 * speed / np.linalg.norm(speed), 0.01 * turn / np.linalg.norm(turn)
    k = np.arange(40)[:, None]
    T = se3.pose(se3.exp_so3(k * turn), k * speed)
    first = [f for f in sorted(chosen) if not chosen & {f - 1, f - 2, f - 3}]
    order = np.arange(40)
    for f in first:
        order[[f, f + 1]] = f + 1, f
    assert exchanged(T[order]).tolist() == first


def test_a_hand_that_shakes_is_no_exchange(truth):
    assert not len(exchanged(truth))
    s = np.arange(120) / 30
    shake = 0.02 * np.sin(2 * np.pi * 6 * s)[:, None] * [0.0, 1.0, 0.0]
    assert not len(exchanged(se3.pose(se3.exp_so3(shake), 0.3 * s[:, None] * [1.0, 0.0, 0.0])))


def test_where_nothing_is_known_nothing_is_said(truth):
    gaps = truth.copy()
    gaps[::3] = np.nan
    assert not len(exchanged(gaps)) and not len(exchanged(truth[:2]))


def test_exchanged_images_of_a_recording(frames, truth):
    swapped = [frames[k] for k in (*range(10), 11, 10, 13, 12, *range(14, N))]
    found = tracked(swapped)
    assert np.isfinite(followed_path(found)).all()
    (note,) = notes_on_order(found)
    assert note.text.startswith("2 pairs") and "(the first: 10 and 11)" in note.text
    assert note.kind == NoteKind.CONTRADICTED  # 4 of 40 frames
    assert not notes_on_order(tracked(frames))
    found = tracked([frames[k] for k in (*range(10), 11, 10, *range(12, N))])
    (note,) = notes_on_order(found)
    assert note.text.startswith("the neighbouring frames 10 and 11 are in the wrong order")
    by_depth = replace(found, by_surface=np.isin(np.arange(N), (10, 11)))
    assert not notes_on_order(by_depth), "a motion by depth alone is too inaccurate to say so"


def test_a_motion_known_in_part_is_no_step_of_the_path(frames):
    found = tracked(frames)
    information = found.information.copy()
    information[10] = np.diag([1e6, 1e6, 0, 0, 0, 1e6])
    path = followed_path(replace(found, information=information, by_surface=np.arange(N) == 10))
    assert np.isnan(path[10]).all() and np.isfinite(np.delete(path, 10, axis=0)).all()


def test_a_frozen_image_is_told(frames):
    found = tracked(with_color(with_depth(frames, {7: 6, 8: 6, 9: 6}), {7: 6, 8: 6, 9: 6}))
    assert np.flatnonzero(found.repeat == Repeat.COLOR).tolist() == [7, 8, 9]
    (note,) = notes_on_repeats(found)
    assert note.kind == NoteKind.CONTRADICTED and note.text.startswith("3 of 40 frames (the first: 7) repeat")
    assert not notes_on_repeats(tracked(frames))


def test_depth_that_stands_still_is_not_used(frames, truth):
    found = tracked(with_depth(frames, {20: 18, 19: 18}))
    assert np.flatnonzero(found.repeat == Repeat.DEPTH).tolist() == [19, 20]
    assert np.isnan(found.seen.z_m[np.isin(found.seen.frame, (19, 20))]).all()
    assert (found.status[[19, 20]] == TrackStatus.FOLLOWED).all()
    (note,) = notes_on_repeats(found)
    assert note.kind == NoteKind.DROPPED and "that depth is not used" in note.text
    linked = np.flatnonzero(found.key >= 0)
    off = found.T_cam_key[linked] @ se3.inverse(se3.inverse(truth[linked]) @ truth[found.key[linked]])
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.009  # by pixels alone, as of frames without depth
