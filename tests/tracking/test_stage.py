"""When a recording is followed, and that the outcome depends neither on jobs nor on what was finished before."""

from dataclasses import replace

import numpy as np
import pytest
from walls import frame, path, recording, wall_frames

from miniloop_cli.config import Depth, Tracking
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.tracked import Repeat, TrackedPart, TrackStatus
from miniloop_cli.stages import track as stage
from miniloop_cli.stages.artifacts import TRACKED
from miniloop_cli.stages.run import Run

N = 160


@pytest.fixture(scope="module")
def truth():
    return path(N)


@pytest.fixture(scope="module")
def dense(truth):
    return recording(wall_frames(truth))


def followed(sequence, folder, enabled="auto", jobs=1, **settings):
    run = Run(Store(folder), Workers(jobs, quiet=True))
    return stage.track(sequence, Depth(), Tracking(enabled=enabled, **settings), run)


def same(one, other):
    assert all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("status", "problem", "key", "T_cam_key", "information")
    )
    seen, others = vars(one.seen), vars(other.seen)
    assert all(np.array_equal(seen[name], others[name], equal_nan=True) for name in seen)
    return True


@pytest.fixture(scope="module")
def tracked(dense, tmp_path_factory):
    folder = tmp_path_factory.mktemp("store")
    return followed(dense, folder), folder


def parts_of(folder):
    return sorted((folder / TRACKED.kind).glob("*.npz"))


def test_a_dense_recording_is_followed_by_itself(tracked, truth):
    found, folder = tracked
    assert len(found) == N and len(parts_of(folder)) == 2
    assert np.isin(found.status, (TrackStatus.FOLLOWED, TrackStatus.KEYFRAME)).all()
    assert found.key[0] == -1 and (found.key[1:] >= 0).all()  # tied also where two parts meet
    assert 80 in found.keyframes and len(found.keyframes) < N / 8
    linked = np.arange(1, N)
    off = found.T_cam_key[linked] @ se3.inverse(se3.inverse(truth[linked]) @ truth[found.key[linked]])
    assert se3.rotation_angle_deg(off[:, :3, :3]).max() < 0.2
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.005


@pytest.mark.slow
def test_scans_without_order_are_left_alone(truth, tmp_path):
    """Few frames, frames far apart in time, frames that show other places."""
    frames = wall_frames(path(100, speed=20))
    assert followed(recording(frames), tmp_path) is None
    assert followed(recording(frames + frames[:60], rate_hz=2), tmp_path) is None
    rng = np.random.default_rng(0)
    T = se3.pose(se3.exp_so3(rng.uniform(-0.5, 0.5, (N, 3))), rng.uniform(-1, 1, (N, 3)))
    assert followed(recording(wall_frames(T)), tmp_path) is None
    assert not (tmp_path / TRACKED.kind).exists()


@pytest.mark.slow
def test_off_is_off_and_on_is_on(dense, tracked, tmp_path):
    assert followed(dense, tmp_path, "off") is None
    assert same(followed(dense, tmp_path, "on"), tracked[0])
    short = recording(dense.frames[:30])
    assert followed(short, tmp_path) is None
    assert len(followed(short, tmp_path, "on")) == 30
    assert followed(recording(dense.frames[:2]), tmp_path, "on") is None


def test_recordings_of_which_hardly_a_frame_can_be_used_are_scans(dense, tmp_path):
    broken = [frame(k, None, None) for k in range(20)]
    assert followed(recording(broken), tmp_path, "on") is None
    assert followed(recording([dense.frames[0], *broken]), tmp_path, "on") is None


def test_finished_parts_are_not_made_again(dense, tracked, monkeypatch):
    def never(*_):
        raise AssertionError("made again")

    found, folder = tracked
    monkeypatch.setattr(stage, "track_arrays", never)
    assert same(followed(dense, folder, "on"), found)
    with pytest.raises(AssertionError, match="made again"):
        followed(dense, folder, "on", points=299)


def test_a_killed_run_goes_on_where_it_was(dense, tracked, tmp_path, monkeypatch):
    class Killed(Exception):
        pass

    make, made = stage.track_arrays, []

    def dies(how, part):
        if made:
            raise Killed
        made.append(part)
        return make(how, part)

    monkeypatch.setattr(stage, "track_arrays", dies)
    with pytest.raises(Killed):
        followed(dense, tmp_path, "on")
    assert len(parts_of(tmp_path)) == 1
    rest = []

    def counts(how, part):
        rest.append(part)
        return make(how, part)

    monkeypatch.setattr(stage, "track_arrays", counts)
    assert same(followed(dense, tmp_path, "on"), tracked[0])
    assert len(rest) == 1 and rest != made


@pytest.mark.slow
def test_a_damaged_part_is_made_again(dense, tracked, tmp_path):
    followed(dense, tmp_path, "on")
    first = parts_of(tmp_path)[0]
    whole = first.read_bytes()
    first.write_bytes(whole[: len(whole) // 2])
    assert same(followed(dense, tmp_path, "on"), tracked[0])
    assert first.read_bytes() == whole


@pytest.mark.slow
def test_jobs_change_nothing(dense, tracked, tmp_path):
    assert same(followed(dense, tmp_path, jobs=2), tracked[0])
    assert [p.name for p in parts_of(tmp_path)] == [p.name for p in parts_of(tracked[1])]
    pairs = zip(parts_of(tmp_path), parts_of(tracked[1]), strict=True)
    assert all(one.read_bytes() == other.read_bytes() for one, other in pairs)


def test_a_changed_image_is_followed_again(dense, tracked):
    """Only the part that it belongs to."""
    found, folder = tracked
    frames = list(dense.frames)
    frames[100] = frame(100, np.zeros((120, 160, 3), np.uint8), np.zeros((120, 160), np.uint16))
    before = set(parts_of(folder))
    changed = followed(recording(frames), folder)
    assert changed.status[100] == TrackStatus.BLANK
    assert np.array_equal(changed.T_cam_key[:81], found.T_cam_key[:81])
    new = [np.load(p) for p in set(parts_of(folder)) - before]
    assert [TrackedPart.from_arrays(arrays).first for arrays in new] == [80]


@pytest.mark.slow
def test_parts_meet_at_a_frame_that_shows_something(dense, truth, tmp_path):
    """Covered and broken frames where the parts would meet, and all that follow are tied nevertheless."""
    frames, nothing = list(dense.frames), np.zeros((120, 160), np.uint16)
    frames[80] = frame(80, np.zeros((120, 160, 3), np.uint8), nothing)
    frames[81] = frame(81, None, None)
    found = followed(recording(frames), tmp_path)
    assert found.status[80:83].tolist() == [TrackStatus.BLANK, TrackStatus.UNREADABLE, TrackStatus.KEYFRAME]
    assert (found.key[82:] >= 0).all()
    off = found.T_cam_key[82] @ se3.inverse(se3.inverse(truth[82]) @ truth[found.key[82]])
    assert se3.rotation_angle_deg(off[:3, :3]) < 0.2 and np.linalg.norm(off[:3, 3]) < 0.005


@pytest.mark.slow
def test_parts_meet_at_a_frame_with_depth_of_its_own(truth, tmp_path):
    """One with the depth of the frame before is no keyframe of the earlier part, but the later one begins with it."""
    frames = wall_frames(truth)
    frames[80] = replace(frames[80], depth=frames[79].depth)
    found = followed(recording(frames), tmp_path)
    assert found.repeat[80] == Repeat.DEPTH
    assert found.status[80:82].tolist() == [TrackStatus.FOLLOWED, TrackStatus.KEYFRAME]
    linked = found.key[1:]
    assert (found.status[linked] == TrackStatus.KEYFRAME).all()
