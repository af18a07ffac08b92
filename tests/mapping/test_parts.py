"""What a map keeps of a recording: features at one instant, the best of them, points, poses of all frames."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from map_scenes import CAMERA, small_part, some_pose

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.camera_parameters import DISTORTION, INTRINSICS, NAMES
from miniloop_cli.geometry.depth_model import rho
from miniloop_cli.mapping.alone import landmarks_of
from miniloop_cli.mapping.carry import carried_poses
from miniloop_cli.mapping.common_camera import same_rays, view_in
from miniloop_cli.mapping.part import at_one_instant, between_rows, by_calibration, chosen_features, of_rows
from miniloop_cli.mapping.pieces import in_the_first_world, pieces_of
from miniloop_cli.scene.calibration import Calibration, Status
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.timing import Timing
from miniloop_cli.scene.verdict import Verdict

WIDE = replace(CAMERA, fx=400.0, fy=410.0, cx=300.0, cy=250.0)


def test_features_lie_where_a_camera_at_rest_would_have_seen_them(rng):
    """Each row from the pose of its own time; what is undone must give the image of the middle row's pose."""
    readout_s, w, v = 0.02, np.array([0.4, -0.3, 0.5]), np.array([0.2, 0.1, -0.2])
    p = np.stack([rng.uniform(-1, 1, 200), rng.uniform(-0.7, 0.7, 200), rng.uniform(1.5, 3, 200)], axis=1)
    still = CAMERA.project(p)
    row_s = readout_s * (still[:, 1] - 239.5) / 480
    R = se3.exp_so3(row_s[:, None] * w)
    moved = np.einsum("nji,nj->ni", R, p - row_s[:, None] * v)
    px = CAMERA.project(moved)
    features = ScanFeatures(px, px, moved[:, 2], np.zeros((200, 2)), np.zeros(200, bool), np.zeros((200, 8)))
    found = at_one_instant(features, np.concatenate([w, v]), Timing(readout_s, 0.0), 0.0, CAMERA)
    before, after = (np.linalg.norm(f.px_ideal - still, axis=1) for f in (features, found))
    assert np.median(before) > 0.5
    assert np.median(after) < 0.05 * np.median(before)
    assert at_one_instant(features, np.zeros(6), Timing(readout_s, 0.0), 0.0, CAMERA) is features


def test_features_that_are_found_again_are_kept_first():
    part = small_part()
    features = replace(part.features[0], z_m=np.where(np.arange(120) < 100, 2.0, np.nan))
    uses = np.zeros(120, int)
    uses[[7, 90]] = 3
    rows = chosen_features(features, uses, 10)
    assert rows.tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 8, 90]
    assert np.array_equal(of_rows(features, rows).descriptors, features.descriptors[rows])
    assert len(chosen_features(features, uses)) == 100


def test_edges_follow_their_features():
    matches = np.array([[5, 6], [7, 8], [9, 1]])
    edge = Edge(2, 4, matches, np.array([True, True, False]), verdict=Verdict.VERIFIED)
    found = between_rows(EdgeTable.of([edge]), np.array([2, 4]), [np.array([5, 7, 9]), np.array([1, 8])])
    assert found.pairs.tolist() == [[0, 1]]
    assert found.matches.tolist() == [[1, 1]]


def test_points_lie_where_their_keyframes_saw_them():
    part = small_part()
    found = landmarks_of([part], part.T_world_key, EdgeTable.of([]))
    assert len(found.points_m) == 120
    assert (found.of_feature.reshape(4, 120) == found.of_feature[:120]).all()
    p = part.T_world_key[2][:3, :3].T @ (found.points_m - part.T_world_key[2][:3, 3]).T
    assert np.allclose(CAMERA.project(p.T)[np.argsort(found.of_feature[:120])], part.features[2].px_ideal, atol=1e-6)


def test_an_observation_that_contradicts_the_others_makes_no_point():
    part = small_part()
    features = list(part.features)
    z = features[1].z_m.copy()
    z[5] += 0.5
    features[1] = replace(features[1], z_m=z)
    found = landmarks_of([replace(part, features=tuple(features))], part.T_world_key, EdgeTable.of([]))
    assert found.of_feature[120 + 5] == -1
    assert found.of_feature[5] >= 0


@given(st.integers(0, 1000))
def test_all_frames_move_as_their_keyframes_do(seed):
    part, rng = small_part(), np.random.default_rng(seed)
    G = some_pose(rng)
    assert np.allclose(carried_poses(part, G @ part.T_world_key), G @ part.T_world_cam)
    bent = G @ part.T_world_key @ np.stack([some_pose(rng, 0.01, 0.01) for _ in range(len(part))])
    found = carried_poses(part, bent)
    assert np.allclose(found[part.keyframe], bent)
    steps = np.linalg.norm(np.diff(found[:, :3, 3], axis=0), axis=1)
    assert steps.max() < 0.1


def test_another_camera_sees_the_same_rays(rng):
    px = rng.uniform(0, 400, (20, 2))
    assert np.allclose(same_rays(same_rays(px, CAMERA, WIDE), WIDE, CAMERA), px)
    p = np.array([[0.3, -0.2, 2.0]])
    assert np.allclose(same_rays(CAMERA.project(p), CAMERA, WIDE), WIDE.project(p))
    view = small_part().views[0]
    assert view_in(view, CAMERA, replace(CAMERA, depth_scale=1.0)) is view
    other = view_in(view, CAMERA, WIDE)
    assert set(np.unique(other.gray)) <= {0.0, *np.unique(view.gray)}


def test_a_piece_lies_in_the_world_of_its_first_recording(rng):
    part = small_part()
    G = some_pose(rng)
    assert np.allclose(in_the_first_world(G @ part.T_world_key, part), part.T_world_key)


def test_recordings_hang_together_by_edges_of_several_keyframes():
    of_part = np.repeat([0, 1, 2], [4, 4, 6])
    none = np.zeros((0, 2), int), np.zeros(0, bool)

    def table(pairs):
        return EdgeTable.of([Edge(i, j, *none, verdict=Verdict.VERIFIED) for i, j in pairs])

    alone = table([(0, 4), (1, 4), (2, 4)])  # one keyframe of the second recording looks like three of the first
    assert pieces_of(alone, of_part, 3, np.zeros(14, int)).tolist() == [1, 2, 0]
    joined = table([(0, 4), (1, 5), (2, 6)])
    assert pieces_of(joined, of_part, 3, np.zeros(14, int)).tolist() == [0, 0, 1]
    apart = np.where(of_part == 1, 1, 0)
    assert pieces_of(joined, of_part, 3, apart).tolist() == [1, 2, 0]


def test_features_of_a_calibrated_run_are_those_of_the_new_camera():
    """Extracted with a guess of the camera, kept as the one that was found sees them."""
    given = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)
    theta = np.zeros(len(NAMES))
    theta[[0, 2, 3, 4]] = 0.02, 4.0, -6.0, 0.1
    theta[len(INTRINSICS) + len(DISTORTION)] = 0.01
    status = np.where(theta != 0, Status.ESTIMATED, Status.NO_GAIN)
    found = Calibration(given, theta, np.eye(len(theta)), status, 1.5, 0.1, 0.01, 0.01)
    rng = np.random.default_rng(0)
    px, z_m = rng.uniform((20, 20), (620, 460), (50, 2)), rng.uniform(0.8, 3, 50)
    z_m[:5] = np.nan
    nothing = np.zeros((50, 2)), np.zeros(50, bool), np.zeros((50, 8), np.uint8)
    kept = by_calibration(ScanFeatures(px, given.undistort(px), z_m, *nothing), found)
    camera = found.camera
    np.testing.assert_allclose(kept.px_ideal[5:], camera.undistort(px)[5:], atol=1e-6)
    corrected = camera.depth_model.corrected(z_m, rho(px, 640, 480))
    np.testing.assert_allclose(kept.z_m, corrected, rtol=1e-9)
    assert np.nanmax(np.abs(kept.z_m - z_m)) > 0.003 and np.isnan(kept.z_m[:5]).all()
    assert by_calibration(kept, None) is kept
    assert by_calibration(kept, replace(found, beforehand=True)) is kept  # extracted with the new camera already
