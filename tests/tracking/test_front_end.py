"""Points followed through recordings: right motions where there is something to see, and torn where there is a cut."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from walls import CAMERA, frame, path, recording, spotted_frames, wall_frames

from miniloop_cli.config import Depth, Tracking
from miniloop_cli.datasets import open_sequence
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.no_depth import NoDepth
from miniloop_cli.scene.tracked import Tracked, TrackedPart, TrackStatus
from miniloop_cli.simulation import SimulationSettings, true_trajectory, write_sequence
from miniloop_cli.tracking.front_end import track_part

N = 40
FOLLOWED, KEYFRAME, UNREADABLE, BLANK, NO_DEPTH = TrackStatus


@pytest.fixture(scope="module")
def truth():
    return path(N)


@pytest.fixture(scope="module")
def frames(truth):
    return wall_frames(truth)


def tracked(frames, **settings):
    sequence = recording(frames)
    return track_part(sequence, Depth(), Tracking(**settings), 0, len(frames) - 1)


def errors(part, truth):
    """Rotation (deg) and translation (m) errors of the motions since the keyframes."""
    linked = np.flatnonzero(part.key >= 0)
    true = se3.inverse(truth[linked]) @ truth[part.key[linked]]
    off = part.T_cam_key[linked] @ se3.inverse(true)
    return se3.rotation_angle_deg(off[:, :3, :3]), np.linalg.norm(off[:, :3, 3], axis=1)


@pytest.fixture(scope="module")
def part(frames):
    return tracked(frames)


def test_motions_are_those_of_the_camera(part, truth):
    assert part.status[0] == part.status[-1] == KEYFRAME
    assert np.isin(part.status, (FOLLOWED, KEYFRAME)).all()
    assert part.key[0] == -1 and (part.key[1:] >= 0).all()
    deg, m = errors(part, truth)
    assert deg.max() < 0.08 and m.max() < 0.002
    assert (np.linalg.eigvalsh(part.information[1:])[:, 0] > 0).all()


def test_a_thumbnail_is_kept_of_every_frame_that_is_read(part):
    again = Tracked.of([TrackedPart.from_arrays(part.arrays())])
    assert sorted(again.thumbnails) == list(range(N))
    image = cv2.imdecode(again.thumbnails[3], cv2.IMREAD_COLOR)
    assert image.shape == (120, 160, 3)


def without_depth(frames, numbers):
    """The frames, some of which are colour images alone."""
    return [replace(f, depth=NoDepth(f.color)) if k in numbers else f for k, f in enumerate(frames)]


def test_colour_images_without_depth_are_followed_forwards_and_backwards(frames, truth):
    alone = {0, 1, 2, 10, 11, 20, N - 2, N - 1}
    part = tracked(without_depth(frames, alone))
    assert part.status[3] == KEYFRAME and part.key[3] == -1
    assert (part.status[sorted(alone)] == FOLLOWED).all() and (part.key[:3] == 3).all()
    deg, m = errors(part, truth)
    rows = np.delete(np.arange(N), 3)  # all but the first keyframe
    with_depth = ~np.isin(rows, sorted(alone))
    assert len(deg) == N - 1 and deg[with_depth].max() < 0.08 and m[with_depth].max() < 0.002
    assert deg.max() < 0.25 and m.max() < 0.009  # pixels alone, of fewer points where no keyframe could be made
    seen = part.arrays()
    assert np.isnan(seen["seen_z_m"][np.isin(seen["seen_frame"], sorted(alone))]).all()
    rows = np.stack([seen["seen_frame"], seen["seen_track"]], axis=1)
    assert len(np.unique(rows, axis=0)) == len(rows)  # what is followed backwards has tracks of its own


def test_a_colour_image_without_depth_that_shows_another_place_gets_no_pose(frames):
    mixed = without_depth(frames[:10] + wall_frames(path(3), seed=9) + frames[13:20], {10, 11, 12})
    part = tracked(mixed)
    assert (part.status[10:13] == NO_DEPTH).all() and (part.key[10:13] == -1).all()
    assert "no depth" in str(part.problem[11]) and (part.key[13:] >= 0).all()


def test_observations_are_where_the_points_are(part, truth):
    seen = part.arrays()
    frame, track, z_m = seen["seen_frame"], seen["seen_track"], seen["seen_z_m"]
    assert len(np.unique(np.stack([frame, track]), axis=1).T) == len(frame)
    p_cam = CAMERA.backproject(seen["seen_px_ideal"], z_m)
    p_world = np.einsum("kij,kj->ki", truth[frame, :3, :3], p_cam) + truth[frame, :3, 3]
    count = np.bincount(track)
    mean = np.stack([np.bincount(track, axis) / np.maximum(count, 1) for axis in p_world.T], axis=1)
    away_m = np.linalg.norm(p_world - mean[track], axis=1)
    assert np.median(away_m) < 0.002 and np.quantile(away_m, 0.99) < 0.015  # a pixel is 15 mm on the wall
    assert (np.bincount(frame, minlength=N) > 50).all()


def test_a_keyframe_is_made_where_few_points_are_left(frames, part):
    eager, lazy = tracked(frames, min_followed=0.95), tracked(frames, min_followed=0.05)
    count = [(p.status == KEYFRAME).sum() for p in (lazy, part, eager)]
    assert count[0] == 2 <= count[1] < count[2]
    for made in (part, eager):  # each frame is followed from the last keyframe before it
        keys = np.flatnonzero(made.status == KEYFRAME)
        assert np.array_equal(made.key[1:], keys[np.searchsorted(keys, np.arange(1, N)) - 1])


def test_a_black_frame_is_blank_and_its_neighbours_go_on(frames, truth):
    middle, none = N // 2, np.zeros((120, 160), np.uint16)
    black = frame(middle, np.zeros((120, 160, 3), np.uint8), none)
    part = tracked([*frames[:middle], black, *frames[middle + 1 :]])
    assert part.status[middle] == BLANK and "mean grey level 0 of 255" in part.problem[middle]
    assert (part.status == BLANK).sum() == 1 and part.key[middle] == -1
    assert (np.delete(part.key, middle)[1:] >= 0).all()
    assert not (part.arrays()["seen_frame"] == middle).any()
    deg, m = errors(part, truth)
    assert deg.max() < 0.08 and m.max() < 0.002


@pytest.mark.parametrize("broken", [(0,), (N // 2,), (N - 1,), tuple(range(12, 17))])
def test_unreadable_frames_are_named_with_their_reason(frames, truth, broken):
    part = tracked([frame(k, None, None) if k in broken else f for k, f in enumerate(frames)])
    assert np.flatnonzero(part.status == UNREADABLE).tolist() == list(broken)
    assert all(f"frame {k}" in part.problem[k] and "is cut off" in part.problem[k] for k in broken)
    rest = np.setdiff1d(np.arange(N), broken)
    assert (part.problem[rest] == "").all()
    assert (part.key[rest[1:]] >= 0).all() and part.status[rest[0]] == KEYFRAME
    deg, m = errors(part, truth)
    assert deg.max() < 0.08 and m.max() < 0.002


def test_a_frame_without_depth_is_followed_by_its_points(frames, truth):
    middle = N // 2
    frames = list(frames)
    frames[middle] = frame(middle, frames[middle].color.pixels, np.zeros((120, 160), np.uint16))
    part = tracked(frames)
    assert part.status[middle] == FOLLOWED
    deg, m = errors(part, truth)
    assert deg.max() < 0.3 and m.max() < 0.01  # a plane by its pixels alone


def test_a_cut_to_another_scene_tears(frames, truth):
    cut = N // 2
    part = tracked([*frames[:cut], *wall_frames(truth, seed=1)[cut:]])
    assert part.key[cut] == -1 and part.status[cut] == KEYFRAME
    assert np.flatnonzero(part.key < 0).tolist() == [0, cut]
    assert (part.key[cut + 1 :] >= cut).all()
    seen = part.arrays()
    before = np.unique(seen["seen_track"][seen["seen_frame"] < cut])
    assert not np.isin(seen["seen_track"][seen["seen_frame"] >= cut], before).any()
    deg, m = errors(part, truth)
    assert deg.max() < 0.08 and m.max() < 0.002


def test_a_bare_wall_tells_the_distance_and_two_turns(truth):
    """Nothing tells the rest, which is not guessed: each frame is torn from the others, and keeps what is known."""
    part = tracked(spotted_frames(truth, 0))
    assert (part.status == KEYFRAME).all() and not part.determined.any()
    linked = np.flatnonzero(part.key >= 0)
    assert len(linked) > N / 2 and part.by_surface[linked].all()
    true = se3.inverse(truth[linked]) @ truth[part.key[linked]]
    off = part.T_cam_key[linked] @ se3.inverse(true)
    step = np.concatenate([se3.log_so3(off[:, :3, :3]), off[:, :3, 3]], axis=1)
    value, axes = np.linalg.eigh(part.information[linked])
    known = np.einsum("kai,ka->ki", axes, step)
    assert (np.sort(value)[:, 2] < 1e-3 * np.sort(value)[:, 3]).all()  # three of six are open
    assert np.abs(known[value > 1]).max() < 0.01  # rad, m
    assert (np.einsum("ka,kab,kb->k", step, part.information[linked], step) < 10).all()


@pytest.mark.slow
@pytest.mark.parametrize("spots", [2, 4])
def test_a_few_spots_on_a_wall_are_enough(spots):
    """Brightness alone was once 2 cm off on such a wall, and points alone half a centimetre."""
    camera, truth = Camera(525.0, 525.0, 319.5, 239.5, 640, 480), path(30)
    sequence = recording(spotted_frames(truth, spots, 7, camera), camera=camera)
    part = track_part(sequence, Depth(), Tracking(), 0, len(truth) - 1)
    assert part.determined[part.status == FOLLOWED].all() and part.determined.sum() >= len(truth) - 2
    deg, m = errors(part, truth)
    assert deg.max() < 0.15 and m.max() < 0.004


def test_doubled_frames_do_not_move(frames, truth):
    part = tracked([f for f in frames for _ in range(2)])
    assert (part.key[1:] >= 0).all()
    T = [np.eye(4)]
    for k in range(1, 2 * N):
        T.append(T[part.key[k]] @ se3.inverse(part.T_cam_key[k]))
    step = se3.inverse(np.array(T[1::2])) @ np.array(T[::2])
    assert se3.rotation_angle_deg(step[:, :3, :3]).max() < 0.02
    assert np.linalg.norm(step[:, :3, 3], axis=1).max() < 2e-4
    deg, m = errors(part, np.repeat(truth, 2, axis=0))
    assert deg.max() < 0.08 and m.max() < 0.002


def test_a_frozen_camera_stays_where_it_is(frames):
    part = tracked([frames[0]] * 12)
    assert part.status.tolist() == [KEYFRAME, *[FOLLOWED] * 10, KEYFRAME]
    assert np.abs(part.T_cam_key - np.eye(4)).max() < 1e-6


def test_nothing_is_followed_through_blank_or_broken_recordings(frames):
    blank = frame(0, np.full((120, 160, 3), 90, np.uint8), np.full((120, 160), 9000, np.uint16))
    for f, status in ((blank, BLANK), (frame(0, None, None), UNREADABLE)):
        part = tracked([f] * 5)
        assert (part.status == status).all() and (part.key == -1).all()
        assert len(part.arrays()["seen_frame"]) == 0


def test_a_part_does_not_depend_on_what_is_before(frames):
    sequence = recording(frames)
    later = track_part(sequence, Depth(), Tracking(), 15, 30)
    alone = track_part(recording(frames[15:31]), Depth(), Tracking(), 0, 15)
    assert later.first == 15 and np.array_equal(later.key[1:] - 15, alone.key[1:])
    assert np.allclose(later.T_cam_key, alone.T_cam_key, atol=1e-9)  # stamps have other last bits


def test_a_part_comes_back_from_its_arrays(part):
    arrays = part.arrays()
    again = TrackedPart.from_arrays(arrays).arrays()
    assert arrays.keys() == again.keys()
    assert all(np.array_equal(arrays[name], again[name], equal_nan=arrays[name].dtype == float) for name in arrays)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "deg", "m"), [(True, 0.6, 0.025), (False, 0.1, 0.006)])
def test_a_simulated_room_is_followed(tmp_path: Path, noise, deg, m):
    settings = SimulationSettings(frames=N, width=320, height=240, rate_hz=30, path_share=0.06, noise=noise)
    sequence = open_sequence(write_sequence(tmp_path / "room", settings, seed=1))
    true = true_trajectory(settings, np.random.default_rng(1))
    at = np.searchsorted(true.timestamps_s, sequence.stamps_s - 1e-6)
    part = track_part(sequence, Depth(), Tracking(), 0, N - 1)
    assert part.status[0] == part.status[-1] == KEYFRAME and part.key[0] == -1 and (part.key[1:] >= 0).all()
    off = errors(part, true.T_world_cam[at])
    assert off[0].max() < deg and off[1].max() < m


def darkened(folder, dark, image):
    """Errors (deg, m) of following a simulated room whose frames `dark` show what image(k, before) gives."""
    settings = SimulationSettings(frames=N, width=320, height=240, rate_hz=30, path_share=0.06)
    write_sequence(folder, settings, seed=1)
    paths = sorted((folder / "rgb").iterdir())
    for k in dark:
        cv2.imwrite(str(paths[k]), np.clip(image(k, cv2.imread(str(paths[k]))), 0, 255).astype(np.uint8))
    true = true_trajectory(settings, np.random.default_rng(1))
    sequence = open_sequence(folder)
    part = track_part(sequence, Depth(), Tracking(), 0, N - 1)
    return part, *errors(part, true.T_world_cam[np.searchsorted(true.timestamps_s, sequence.stamps_s - 1e-6)])


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [False, True])
def test_noise_in_the_dark_is_not_followed(tmp_path: Path, fixed):
    """Noise has corners. A new keyframe for each dark frame would add up the errors of all their motions.

    A pattern that stands still on the sensor, `fixed`, looks like a camera at rest; depth contradicts it.
    """
    rng, dark = np.random.default_rng(0), range(10, 30)
    pattern = rng.normal(4, 10, (240, 320, 3))
    image = (
        (lambda *_: pattern + rng.normal(0, 1, pattern.shape)) if fixed else lambda *_: rng.normal(4, 10, (240, 320, 3))
    )
    part, deg, m = darkened(tmp_path / "room", dark, image)
    linked = np.isin(np.arange(N), range(11, 30))
    assert (part.status[dark] == KEYFRAME).sum() <= 4
    assert part.by_surface[linked].all() and (part.key[linked] >= 0).all()
    assert deg.max() < 0.3 and m.max() < 0.01


@pytest.mark.slow
def test_where_a_keyframe_tells_nothing_more_the_last_frame_becomes_one(tmp_path: Path):
    """The light fades: the brightness of a frame is nearer to that of the last one than to that of the keyframe."""
    light = np.interp(np.arange(N), [8, 13, 33, 38], [1.0, 0.02, 0.02, 1.0])
    rng = np.random.default_rng(0)
    part, deg, m = darkened(
        tmp_path / "room", range(8, 38), lambda k, before: light[k] * before + 4 + rng.normal(0, 3, before.shape)
    )
    assert part.determined[1:].all()
    assert deg.max() < 0.3 and m.max() < 0.01
    seen = part.arrays()
    places = np.stack([seen["seen_frame"], seen["seen_track"]], axis=1)
    assert len(np.unique(places, axis=0)) == len(places)  # a frame that became a keyframe later sees no point twice
