"""How a map of several recordings is examined: joints that pictures contradict are cut, others are told."""

from dataclasses import replace

import numpy as np
import pytest
from map_scenes import small_part
from scipy.ndimage import gaussian_filter

from miniloop_cli.geometry import se3
from miniloop_cli.mapping.alone import landmarks_of
from miniloop_cli.mapping.pieces import as_one_table
from miniloop_cli.mapping.retrieval import index
from miniloop_cli.presets import load_settings
from miniloop_cli.results.map_arrays import joined_arrays, joined_from
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.scene_map import Joined, SceneMap
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.stages.joints import examined
from miniloop_cli.stages.run import Run

K = 4
SETTINGS = load_settings("default", ("refine=none",))
AWAY = se3.pose(se3.exp_so3(np.array([0.0, 0.0, np.pi])), np.array([0.3, 0.2, 0.0]))  # half turned about the view


@pytest.fixture
def run(tmp_path):
    return Run(Store(tmp_path / "cache"), Workers(1, True), 0)


def recording(name, seed=0):
    """A recording before one wall, the same for one seed, and smooth: its cameras stand a little apart."""
    part = small_part(name, seed)
    wall = gaussian_filter(np.random.default_rng(seed).normal(size=(48, 64)), 8)
    gray = np.float32(128 + 40 * (wall - wall.mean()) / wall.std())
    images = tuple(f"{name}{k}" for k in range(K))
    return replace(part, images=images, views=tuple(replace(view, gray=gray) for view in part.views))


def between(a, b, pairs, elsewhere=None, inliers=60):
    """Edges of keyframes of b with such of a, as their own worlds have them, or with b moved by `elsewhere`."""
    T_b = b.T_world_key if elsewhere is None else elsewhere @ b.T_world_key
    rows = np.repeat(np.arange(inliers)[:, None], 2, axis=1)
    return EdgeTable.of(
        [
            Edge(i, K + j, rows, np.ones(inliers, bool), se3.inverse(T_b[j]) @ a.T_world_key[i], 1e4 * np.eye(6),
                 1e-4 * np.eye(6), verdict=Verdict.VERIFIED, rejection=Rejection.NONE)
            for i, j in pairs
        ]
    )  # fmt: skip


def joined_map(a, b, solved):
    """A map in which b lies as the first edges say, whatever its pictures show."""
    used = as_one_table([K, K], [], {(0, 1): solved.subset(np.arange(len(solved)) < 3)})
    T = np.concatenate([a.T_world_key, b.T_world_key])
    parts, covariance = (a, b), np.concatenate([part.covariance[part.keyframe] for part in (a, b)])
    seen, found = landmarks_of(parts, T, used), index([*a.features, *b.features], "sift", K)
    joined = Joined(T, covariance, np.zeros(2, int), {(0, 1): solved}, used, seen, found)
    return SceneMap(parts, joined, SETTINGS.model_dump(), 0)


THREE = [(0, 0), (1, 1), (2, 2)]


def test_one_place_in_two_recordings_is_certified_and_not_doubted(run):
    a = recording("hall")
    b = recording("again")
    found = examined(joined_map(a, b, between(a, b, THREE)), SETTINGS, run).joined
    assert found.doubts == found.notes == () and found.certified and found.relative_gap <= 1e-4
    again = joined_from(joined_arrays(found))
    assert (again.doubts, again.certified, again.relative_gap) == ((), True, found.relative_gap)


def test_a_joint_of_which_the_pictures_tell_nothing_is_noted(run):
    a, b = recording("hall"), recording("again")
    scene_map = joined_map(a, b, between(a, b, THREE, AWAY))
    T = np.concatenate([a.T_world_key, AWAY @ b.T_world_key])
    found = examined(replace(scene_map, joined=replace(scene_map.joined, T_world_cam=T)), SETTINGS, run).joined
    assert found.doubts == ()
    (note,) = joined_from(joined_arrays(found)).notes
    assert note.startswith("too few frames of hall and again show the same place from similar directions")


def test_a_joint_that_the_pictures_contradict_is_cut_and_told(run):
    a, b = recording("hall", 0), recording("attic", 1)
    scene_map = joined_map(a, b, between(a, b, THREE))
    found = examined(scene_map, SETTINGS, run)
    assert found.joined.piece.tolist() == [0, 1] and len(found.joined.edges) == 0
    assert (found.joined.solved[0, 1].rejection == Rejection.JOINT_LOOKS_DIFFERENT).all()
    (doubt,) = found.joined.doubts
    assert doubt.startswith("hall (frames 0 to 6) and attic (frames 0 to 6) have 3 edges, but only ")
    assert doubt.endswith("places were confused, and the edges are not used")
    assert np.array_equal(found.joined.T_world_cam[K:], b.T_world_key)
    # What was cut stays cut, and is told again, also after the map was read back.
    back = replace(found, joined=joined_from(joined_arrays(found.joined)))
    assert examined(back, SETTINGS, run).joined.doubts == (doubt,)
    # Without pictures nobody knows.
    blind = load_settings("default", ("refine=none", "averaging.min_photo_consistency=0"))
    assert examined(scene_map, blind, run).joined.piece.tolist() == [0, 0]


def test_a_recording_that_would_fit_elsewhere_is_told_with_the_frames_on_both_sides(run):
    a, b = recording("hall"), recording("again")
    solved = EdgeTable.of([*between(a, b, THREE).edges(), *between(a, b, [(3, 0), (3, 1)], AWAY, 80).edges()])
    blind = load_settings("default", ("refine=none", "averaging.min_photo_consistency=0"))
    found = examined(joined_map(a, b, solved), blind, run).joined
    (doubt,) = found.doubts
    sides = ("hall (frames 0 to 9)", "again (frames 0 to 6)")
    assert doubt.split(" nearly as well")[0] in [f"{p} would fit elsewhere to {q}" for p, q in (sides, sides[::-1])]
    assert doubt.endswith("160 matches of 2 pairs agree with that, 180 of 3 with where it is")
    less = EdgeTable.of([*between(a, b, THREE).edges(), *between(a, b, [(3, 0)], AWAY, 80).edges()])
    assert examined(joined_map(a, b, less), blind, run).joined.doubts == ()  # 80 against 180


def test_a_recording_that_is_bent_is_told_with_the_step(run):
    a, b = recording("hall"), recording("again")
    scene_map = joined_map(a, b, between(a, b, THREE))
    T = scene_map.joined.T_world_cam.copy()
    T[-1, :3, 3] += [0.0, 0.3, 0.0]
    (doubt,) = examined(
        replace(scene_map, joined=replace(scene_map.joined, T_world_cam=T)), SETTINGS, run
    ).joined.doubts
    assert doubt.startswith("joined to the others, again is bent between frames 6 and 9 by 0 deg and 0.30 m")
