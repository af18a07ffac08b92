"""`miniloop eval --gt FILE` with ground truths as other tools write them: the same numbers, or one line."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from miniloop_cli.cli.main import cli
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.results.evaluation_inputs import ground_truth
from miniloop_cli.results.folder import Results
from miniloop_cli.scene.sequence import Trajectory

COUNT, RATE_HZ = 40, 30.0
EUROC = "#timestamp [{}],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n"


@pytest.fixture
def truth():
    rng = np.random.default_rng(0)
    w = np.cumsum(rng.normal(scale=0.05, size=(COUNT, 3)), axis=0)
    return se3.pose(se3.exp_so3(w), np.cumsum(rng.normal(scale=0.05, size=(COUNT, 3)), axis=0))


@pytest.fixture
def numbers_of(tmp_path, truth):
    """What eval says of a file's content, for a run of a recording that begins at a time: numbers, or the message."""

    def run(content, start_s, *options):
        rng = np.random.default_rng(1)
        noise = se3.pose(se3.exp_so3(rng.normal(scale=0.01, size=(COUNT, 3))), rng.normal(scale=0.01, size=(COUNT, 3)))
        stamps, result = start_s + np.arange(COUNT) / RATE_HZ, tmp_path / "result"
        write_trajectory(result / "trajectory.txt", Trajectory(stamps, truth @ noise))
        rows = [f"{k},{stamp:.6f}" for k, stamp in enumerate(stamps)]
        (result / "frames.csv").write_text("index,timestamp\n" + "\n".join(rows) + "\n")
        (tmp_path / "gt.txt").write_text(content)
        arguments = ["eval", str(result), "--gt", str(tmp_path / "gt.txt"), "--json", "-", *options]
        outcome = CliRunner().invoke(cli, arguments)
        return json.loads(outcome.stdout) if outcome.exit_code == 0 else str(outcome.exception)

    return run


def lines(stamps, truth, w_first=False, separator=" "):
    q = Rotation.from_matrix(truth[:, :3, :3]).as_quat()
    q = np.roll(q, 1, axis=1) if w_first else q
    values = np.column_stack([truth[:, :3, 3], q])
    rows = [separator.join([str(t), *(f"{v:.9f}" for v in row)]) for t, row in zip(stamps, values, strict=True)]
    return "\n".join(rows) + "\n"


def matrices(truth, rows):
    return "".join(" ".join(f"{v:.9e}" for v in T[:rows].ravel()) + "\n" for T in truth)


EPOCH_S = 1305031102.0
TIMES_S = np.round(np.arange(COUNT) / RATE_HZ, 6)
MICROSECONDS = [round(t * 1e6) for t in TIMES_S]
EPOCH_NS = [int(EPOCH_S) * 10**9 + t * 1000 for t in MICROSECONDS]
FILES = {
    "TUM": (lambda T: lines([f"{EPOCH_S + t:.6f}" for t in TIMES_S], T), EPOCH_S, "TUM, stamps in s"),
    "w first": (
        lambda T: EUROC.format("s") + lines([f"{EPOCH_S + t:.6f}" for t in TIMES_S], T, True, ","),
        EPOCH_S,
        "EuRoC CSV, quaternion w first, stamps in s",
    ),
    "EuRoC": (
        lambda T: EUROC.format("ns") + lines(EPOCH_NS, T, True, ","),
        EPOCH_S,
        "EuRoC CSV, quaternion w first, stamps in ns",
    ),
    "ms": (lambda T: lines([t / 1e6 for t in EPOCH_NS], T), EPOCH_S, "TUM, stamps in ms"),
    "us since the start": (lambda T: lines(MICROSECONDS, T), 0.0, "TUM, stamps in us"),
    "KITTI": (
        lambda T: matrices(T, 3),
        EPOCH_S,
        f"KITTI (3 x 4), by frame number ({COUNT}: frames of frames.csv)",
    ),
    "KITTI beside numbers": (
        lambda T: matrices(T, 3),
        0.0,
        f"KITTI (3 x 4), by frame number ({COUNT}: frames of frames.csv)",
    ),
    "Replica": (
        lambda T: matrices(T, 4),
        0.0,
        f"matrices (4 x 4), by frame number ({COUNT}: frames of frames.csv)",
    ),
    "row numbers": (
        lambda T: lines(range(COUNT), T),
        0.0,
        f"TUM, first column counts rows, by frame number ({COUNT}: frames of frames.csv)",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_the_same_numbers_from_every_format(numbers_of, truth, name):
    write, start_s, words = FILES[name]
    tum = lines([f"{start_s + t:.6f}" for t in TIMES_S], truth)
    expected, found = numbers_of(tum, start_s), numbers_of(write(truth), start_s)
    assert 0.005 < expected["ate_rmse_m"] < 0.03
    assert found["poses_with_ground_truth"] == COUNT
    for key in ("rmse", "mean", "median", "max"):
        assert found[f"ate_{key}_m"] == pytest.approx(expected[f"ate_{key}_m"], abs=2e-5)
    for key in ("rot_deg_mean", "trans_m_mean"):
        assert found["rpe"]["consecutive"][key] == pytest.approx(expected["rpe"]["consecutive"][key], abs=2e-3)
    assert found["protocol"]["ground_truth"] == words


@pytest.mark.parametrize("rows", [3, 4])
@pytest.mark.parametrize("start_s", [0.0, EPOCH_S])
def test_matrices_of_another_number_of_frames_are_refused(numbers_of, truth, rows, start_s):
    message = numbers_of(matrices(truth[:-1], rows), start_s)
    assert f"{COUNT - 1} poses are not one a frame ({COUNT} frames of frames.csv)" in message


def test_w_first_without_a_header_is_told_by_the_motions(numbers_of, truth):
    content = lines([f"{EPOCH_S + t:.6f}" for t in TIMES_S], truth, w_first=True)
    assert "give --gt-convention w-first" in numbers_of(content, EPOCH_S)
    right = numbers_of(lines([f"{EPOCH_S + t:.6f}" for t in TIMES_S], truth), EPOCH_S)
    found = numbers_of(content, EPOCH_S, "--gt-convention", "w-first")
    assert found["ate_rmse_m"] == pytest.approx(right["ate_rmse_m"], abs=1e-6)


def test_a_start_of_its_own_is_refused(numbers_of, truth):
    dense = np.repeat(truth, 2, axis=0)  # not one pose a frame
    assert "Its clock starts at 0" in numbers_of(lines(np.arange(2 * COUNT) / 60, dense), EPOCH_S)


def test_a_recording_knows_its_frames_by_number(tmp_path, truth):
    """Of a result of fewer frames, by the recording that it names."""
    import cv2

    for kind in ("color", "depth"):
        (tmp_path / "scan" / kind).mkdir(parents=True)
        for k in range(COUNT):
            cv2.imwrite(str(tmp_path / "scan" / kind / f"{k:06d}.png"), np.zeros((480, 640), np.uint16))
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "summary.json").write_text(json.dumps({"recording": str(tmp_path / "scan")}))
    (tmp_path / "result" / "frames.csv").write_text("index,timestamp\n0,0.0\n1,0.1\n")
    (tmp_path / "gt.txt").write_text(matrices(truth, 3))
    read = ground_truth(tmp_path / "gt.txt", np.array([0.0, 0.1]), Results(tmp_path / "result"))
    np.testing.assert_allclose(read.timestamps_s, np.arange(COUNT) / RATE_HZ)
    (tmp_path / "gt.txt").write_text(matrices(truth[:7], 3))
    with pytest.raises(InputError, match=r"\(40 frames of the recording, 2 frames of frames.csv\)"):
        ground_truth(tmp_path / "gt.txt", np.array([0.0, 0.1]), Results(tmp_path / "result"))
