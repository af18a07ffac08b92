"""Known answers, gauge properties, and evo as an independent oracle."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.evaluation.errors import pairs_apart, relative_errors
from miniloop_cli.evaluation.evaluate import Protocol, edge_rows, evaluate
from miniloop_cli.geometry import se3
from miniloop_cli.results.folder import Results, newest_result, read_edge_list
from miniloop_cli.scene.interpolation import associate, interpolate, nearest
from miniloop_cli.scene.sequence import Trajectory


def random_trajectory(rng, n=60, start=1305031102.0, step=0.05):
    w = np.cumsum(rng.normal(scale=0.1, size=(n, 3)), axis=0)
    T = se3.pose(se3.exp_so3(w), np.cumsum(rng.normal(scale=0.05, size=(n, 3)), axis=0))
    return Trajectory(start + step * np.arange(n) + rng.uniform(0, 0.02, n), T)


def noisy(trajectory, rng, rot_rad=0.02, trans_m=0.02):
    n = len(trajectory.timestamps_s)
    noise = se3.pose(se3.exp_so3(rng.normal(scale=rot_rad, size=(n, 3))), rng.normal(scale=trans_m, size=(n, 3)))
    T_gauge = se3.pose(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    return Trajectory(trajectory.timestamps_s + rng.uniform(-0.008, 0.008, n), T_gauge @ trajectory.T_world_cam @ noise)


def evo_path(trajectory):
    evo = pytest.importorskip("evo.core.trajectory")
    return evo.PoseTrajectory3D(poses_se3=list(trajectory.T_world_cam), timestamps=trajectory.timestamps_s)


@pytest.mark.parametrize("scale", [False, True])
def test_same_numbers_as_evo(scale):
    rng = np.random.default_rng(3)
    truth = random_trajectory(rng, 90)
    estimate = noisy(truth, rng)
    keep = np.r_[0:20, 25:90]
    estimate = Trajectory(estimate.timestamps_s[keep], estimate.T_world_cam[keep])
    metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.sync import associate_trajectories

    ref, est = associate_trajectories(evo_path(truth), evo_path(estimate), max_diff=0.02)
    est.align(ref, correct_scale=scale)
    protocol = Protocol("Sim3" if scale else "SE3", "nearest", max_diff_s=0.02)
    numbers = evaluate(estimate, truth, protocol=protocol).numbers
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((ref, est))
    for key, value in ape.get_all_statistics().items():
        if key in ("rmse", "mean", "median", "max"):
            assert numbers[f"ate_{key}_m"] == pytest.approx(value, abs=1e-6)
    relations = {"rot_deg": metrics.PoseRelation.rotation_angle_deg, "trans_m": metrics.PoseRelation.translation_part}
    for name, relation in relations.items():
        rpe = metrics.RPE(relation, delta=1, delta_unit=metrics.Unit.frames, all_pairs=False)
        rpe.process_data((ref, est))
        for key in ("mean", "median", "rmse", "max"):
            ours = numbers["rpe"]["consecutive"][f"{name}_{key}"]
            assert ours == pytest.approx(rpe.get_all_statistics()[key], abs=1e-6)
    assert numbers["rpe"]["consecutive"]["pairs"] == len(keep) - 1


def test_interpolation_is_slerp_and_linear():
    from scipy.spatial.transform import Rotation, Slerp

    rng = np.random.default_rng(0)
    trajectory = random_trajectory(rng)
    query = np.sort(rng.uniform(trajectory.timestamps_s[0], trajectory.timestamps_s[-1], 200))
    T = interpolate(trajectory, query)
    R = Slerp(trajectory.timestamps_s, Rotation.from_matrix(trajectory.T_world_cam[:, :3, :3]))(query).as_matrix()
    x = [np.interp(query, trajectory.timestamps_s, trajectory.T_world_cam[:, k, 3]) for k in range(3)]
    np.testing.assert_allclose(T[:, :3, :3], R, atol=1e-9)
    np.testing.assert_allclose(T[:, :3, 3], np.stack(x, axis=1), atol=1e-9)


def test_association_respects_gaps_and_distances():
    truth = Trajectory(np.array([0.0, 0.05, 1.0, 1.05]), np.repeat(np.eye(4)[None], 4, 0))
    stamps = np.array([-0.5, 0.025, 0.5, 0.99, 1.06, 1.2])
    assert associate(stamps, truth)[1].tolist() == [False, True, False, True, True, False]
    assert associate(stamps, truth, "nearest", 0.02)[1].tolist() == [False, False, False, True, True, False]
    assert associate(stamps, truth, "nearest", 0.6)[1].tolist() == [True] * 6
    assert associate(stamps, truth, max_gap_s=1)[1].tolist() == [False, True, True, True, True, False]
    assert nearest(truth.timestamps_s, np.array([0.025, 9.0, -9.0])).tolist() == [0, 3, 0]


def test_one_ground_truth_sample_is_enough_at_its_stamp():
    truth = Trajectory(np.array([5.0]), np.eye(4)[None])
    T, known = associate(np.array([5.0, 6.0]), truth)
    assert known.tolist() == [True, False]
    np.testing.assert_array_equal(T[0], np.eye(4))


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_errors_do_not_depend_on_the_world_frames(seed):
    rng = np.random.default_rng(seed)
    truth = random_trajectory(rng, 20)
    estimate = noisy(truth, rng)
    A = se3.pose(se3.exp_so3(rng.normal(size=3)), 10 * rng.normal(size=3))
    B = se3.pose(se3.exp_so3(rng.normal(size=3)), 10 * rng.normal(size=3))
    moved = evaluate(
        Trajectory(estimate.timestamps_s, A @ estimate.T_world_cam),
        Trajectory(truth.timestamps_s, B @ truth.T_world_cam),
    )
    here = evaluate(estimate, truth)
    assert moved.numbers["ate_rmse_m"] == pytest.approx(here.numbers["ate_rmse_m"], abs=1e-9)
    for key, value in here.numbers["rpe"]["consecutive"].items():
        if key not in ("pairs", "protocol"):
            assert moved.numbers["rpe"]["consecutive"][key] == pytest.approx(value, abs=1e-5)


def test_relative_error_known_answer():
    truth = np.repeat(np.eye(4)[None], 2, 0)
    estimate = truth.copy()
    estimate[1] = se3.pose(se3.exp_so3(np.radians([0, 3.0, 0])), np.array([0.03, 0, 0.04]))
    rot, trans = relative_errors(estimate, truth, np.array([[0, 1]]))
    assert rot[0] == pytest.approx(3)
    assert trans[0] == pytest.approx(0.05)


def test_pairs_one_second_apart():
    stamps = np.array([0, 0.3, 0.95, 1.31, 1.6, 3.0])
    assert pairs_apart(stamps, 1.0).tolist() == [[0, 2], [1, 3]]
    assert pairs_apart(stamps[:1], 1.0).shape == (0, 2)


def test_edges_are_found_by_stamp_and_lost_frames_left_out():
    stamps = np.array([1.0, 2.0, 4.0])
    rows = edge_rows(stamps, np.array([[1.0, 2.00001], [1.0, 3.0], [2.0, 4.0], [4.0, 9.0]]))
    assert rows.tolist() == [[0, 1], [1, 2]]
    assert edge_rows(stamps, np.empty((0, 2))).shape == (0, 2)


def test_edges_over_the_graph_are_the_mean_of_their_relative_errors():
    rng = np.random.default_rng(5)
    truth = random_trajectory(rng, 30)
    estimate = Trajectory(truth.timestamps_s, noisy(truth, rng).T_world_cam)
    pairs = np.array([[0, 3], [2, 9], [4, 29]])
    row = evaluate(estimate, truth, truth.timestamps_s[pairs]).numbers["rpe"]["edges"]
    rot, trans = relative_errors(estimate.T_world_cam, truth.T_world_cam, pairs)
    assert row["pairs"] == 3
    assert row["rot_deg_mean"] == pytest.approx(rot.mean(), abs=1e-5)
    assert row["trans_m_median"] == pytest.approx(np.median(trans), abs=1e-9)


def test_no_edges_gives_null_not_nan():
    rng = np.random.default_rng(6)
    truth = random_trajectory(rng, 5)
    numbers = evaluate(truth, truth).numbers
    assert numbers["rpe"]["edges"] | {"protocol": 0} == numbers["rpe"]["edges"] | {
        "protocol": 0,
        "pairs": 0,
        "rot_deg_mean": None,
    }
    json.dumps(numbers, allow_nan=False)
    assert numbers["ate_rmse_m"] == pytest.approx(0, abs=1e-7)


def test_wrong_ground_truth_says_so():
    rng = np.random.default_rng(7)
    with pytest.raises(MiniloopError, match="0 of 60 poses have ground truth"):
        evaluate(random_trajectory(rng), random_trajectory(rng, start=0.0))


def test_newest_result(tmp_path):
    with pytest.raises(InputError, match="miniloop register"):
        newest_result(tmp_path)
    for age, name in enumerate(["b", "a"]):
        (tmp_path / name).mkdir()
        (tmp_path / name / "trajectory.txt").write_text("")
        import os

        os.utime(tmp_path / name / "trajectory.txt", (age, age))
    assert newest_result(tmp_path).name == "a"


def test_the_graph_is_its_verified_edges(tmp_path):
    header = "i,j,timestamp_i,timestamp_j,verdict\n"
    (tmp_path / "edges.csv").write_text(
        header + "0,1,1.5,2.5,verified\n0,2,1.5,3.5,rejected: few inliers\n1,2,2.5,3.5,weak\n"
    )
    assert Results(tmp_path).edge_stamps_s.tolist() == [[1.5, 2.5]]
    (tmp_path / "edges.csv").write_text(header + "0,1,x,2.5,verified\n")
    with pytest.raises(InputError, match="timestamp_i"):
        _ = Results(tmp_path).edge_stamps_s
    (tmp_path / "edges.csv").write_text(header + "0,1\n")
    with pytest.raises(InputError, match="row 2"):
        _ = Results(tmp_path).edges


def test_edge_list(tmp_path):
    path = tmp_path / "edges.txt"
    path.write_text("# i j\n0 1 55\n1,2\n\n")
    assert read_edge_list(path, np.array([1.0, 2.0, 3.0])).tolist() == [[1, 2], [2, 3]]
    path.write_text("0 3\n")
    with pytest.raises(InputError, match=r"line 1: frame numbers must be 0 to 2"):
        read_edge_list(path, np.array([1.0, 2.0, 3.0]))
    path.write_text("0 1\nzero one\n")
    with pytest.raises(InputError, match="line 2"):
        read_edge_list(path, np.array([1.0, 2.0, 3.0]))


@pytest.mark.parametrize("text", ["[1]", "{", "[" * 100_000, "\x00"])
def test_broken_summary_is_one_line(tmp_path, text):
    (tmp_path / "summary.json").write_text(text)
    with pytest.raises(InputError, match="JSON"):
        _ = Results(tmp_path).summary
