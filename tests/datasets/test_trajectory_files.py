"""Trajectories in TUM's format, with evo as the oracle."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from miniloop_cli.datasets.trajectory import read_trajectory, write_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.scene.sequence import Trajectory


def random_trajectory(count: int = 20, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    T = se3.pose(Rotation.random(count, random_state=seed).as_matrix(), rng.normal(0, 3, (count, 3)))
    return Trajectory(np.round(1305031102 + np.cumsum(rng.uniform(0.01, 0.1, count)), 6), T)


def test_round_trip(tmp_path):
    trajectory = random_trajectory()
    write_trajectory(tmp_path / "t.txt", trajectory)
    read = read_trajectory(tmp_path / "t.txt")
    np.testing.assert_array_equal(read.timestamps_s, trajectory.timestamps_s)
    np.testing.assert_allclose(read.T_world_cam, trajectory.T_world_cam, atol=1e-8)


def test_evo_reads_the_same(tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    trajectory = random_trajectory()
    write_trajectory(tmp_path / "t.txt", trajectory)
    theirs = file_interface.read_tum_trajectory_file(str(tmp_path / "t.txt"))
    np.testing.assert_allclose(theirs.poses_se3, trajectory.T_world_cam, atol=1e-7)
    np.testing.assert_allclose(theirs.timestamps, trajectory.timestamps_s)


def test_messy_but_sound_files(tmp_path):
    path = tmp_path / "t.txt"
    path.write_bytes(
        b"\xef\xbb\xbf# comment\r\n\r\n"
        b"3.0 7 0 0 0 0 0 1.01\r\n"  # a rounded quaternion
        b"1.0, 1, 0, 0, 0, 0, 0, 1\r\n"  # commas, and earlier
        b"3.0 9 0 0 0 0 0 1\r\n"  # the stamp again
        b"2.0 5 0 0 0 0 1.001 0  # a remark\n"
    )
    read = read_trajectory(path)
    assert read.timestamps_s.tolist() == [1, 2, 3]
    assert read.T_world_cam[:, 0, 3].tolist() == [1, 5, 7]
    np.testing.assert_allclose(read.T_world_cam[2], se3.pose(np.eye(3), [7, 0, 0]))
    np.testing.assert_allclose(read.T_world_cam[1, :3, :3], np.diag([-1, -1, 1]), atol=1e-12)
    assert "sorted by time (line 4 " in read.source and "1 of 4 rows left out (line 5 repeats a stamp" in read.source


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# only\n", "has no poses"),
        ("1 2 3\n", r"t\.txt:1: expected lines .timestamp tx ty tz qx qy qz qw.*found 3 values"),
        ("0 0 0 0 0 0 0 1\n# c\n1 nan 0 0 0 0 0 1\n", r"t\.txt:3: NaN or infinity"),
        ("nan 0 0 0 0 0 0 1\n", r"t\.txt:1: the timestamp is nan"),
        ("1 0 0 0 0 0 inf 1\n", r"t\.txt:1: NaN or infinity"),
        ("1 0 0 0 0 0 0 0\n", r"t\.txt:1: the quaternion is zero"),
        ("1 0 0 0 0 0 0 2\n", r"t\.txt:1: not a unit quaternion \(length 2\)"),
        ("1 0 0 0 0 0 0 1\n2 5 0 0 0 0 1 0 extra\n", r"t\.txt:2: not a number in"),
        ("1 0 0 0 0 0 0 1\n2 5 0 0 0 0 1 0 7\n", r"t\.txt:2: expected 8 values as in the first row, found 9"),
        ("1 0 0 0 0 0 0 1\n2,,5,0,0,0,0,1,0\n", r"t\.txt:2: a value is missing"),
        ("1 0 0 1_0 0 0 0 1\n", r"t\.txt:1: not a number in"),
        ("1 0 0 1e400 0 0 0 1\n", r"t\.txt:1: a number too large to be read"),
        ("1 0 0 0 0 0.1#5 0 1\n", r"t\.txt:1: not a number in"),
        ('1 0 0 0 0 0."5 0 1\n', r"t\.txt:1: not a number in"),
        ("1 0 0 0e12345 0 0 0 1\n", r"t\.txt:1: not a number in"),
        ("\0" * 50, "is not a text file"),
        ("1 0 0 x 0 0 0 1\n", r"t\.txt:1: not a number in"),
        ("1 0 0 1e20 0 0 0 1\n", r"t\.txt:1: a value beyond"),
    ],
)
def test_unsound_files_are_named(tmp_path, text, words):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(InputError, match=words):
        read_trajectory(tmp_path / "t.txt")


@settings(max_examples=50)
@given(st.integers(0, 30), st.integers(0, 10**6))
def test_any_rotation_survives(count, seed):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path, trajectory = Path(folder) / "t.txt", random_trajectory(max(count, 1), seed)
        write_trajectory(path, trajectory)
        read = read_trajectory(path)
    assert (
        se3.rotation_angle_deg(read.T_world_cam[:, :3, :3] @ np.swapaxes(trajectory.T_world_cam[:, :3, :3], 1, 2)).max()
        < 1e-6
    )


def test_poses_that_are_read_only_are_written(tmp_path):
    """scipy 1.15 refused them."""
    poses = Trajectory(np.arange(3.0), np.broadcast_to(np.eye(4), (3, 4, 4)))
    write_trajectory(tmp_path / "t.txt", poses)
    np.testing.assert_array_equal(read_trajectory(tmp_path / "t.txt").T_world_cam, poses.T_world_cam)
    np.testing.assert_array_equal(se3.log_so3(poses.T_world_cam[:, :3, :3]), np.zeros((3, 3)))
