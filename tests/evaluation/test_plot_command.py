"""`miniloop plot`: figures of results for papers."""

import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.cli.main import cli
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.figure import DASHES, PALETTE, paper_figure
from miniloop_cli.geometry import se3
from miniloop_cli.results.figure_inputs import DIFFERENCE, ERROR, SPEED, figure_lines, labels
from miniloop_cli.scene.sequence import Trajectory

MOVED = se3.pose(se3.exp_so3(np.array([0.2, -1, 0.5])), np.array([3.0, -1, 2]))


@pytest.fixture
def files(tmp_path):
    """A true path, and two estimates of it in other worlds: noisy by 1 cm, and half of it exact."""
    rng = np.random.default_rng(0)
    n = 40
    T = se3.pose(
        se3.exp_so3(np.cumsum(rng.normal(scale=0.1, size=(n, 3)), axis=0)), np.cumsum(rng.normal(size=(n, 3)), axis=0)
    )
    noisy = T.copy()
    noisy[:, :3, 3] += rng.normal(scale=0.01, size=(n, 3))
    stamps = 100 + np.arange(n) / 10
    for name, rows, poses in (
        ("truth.txt", slice(None), T),
        ("a/trajectory.txt", slice(None), MOVED @ noisy),
        ("b/trajectory.txt", slice(0, 20), se3.inverse(MOVED) @ T),
    ):
        write_trajectory(tmp_path / name, Trajectory(stamps[rows], poses[rows]))
    return tmp_path


def test_values_are_errors_differences_or_speeds(files):
    lines, truth, panel = figure_lines([files / "a", files / "b"], files / "truth.txt")
    assert panel == ERROR and len(truth) == 40
    assert 0.01 < np.sqrt((lines[0].values ** 2).mean()) < 0.025 and lines[1].values.max() < 1e-6
    np.testing.assert_allclose(lines[1].positions_m, truth[:20], atol=1e-6)
    assert lines[1].name == "b (0.00 cm RMSE)"
    lines, truth, panel = figure_lines([files / "a", files / "b"], None)
    assert panel == DIFFERENCE and truth is None
    assert (lines[0].values == 0).all() and 0.002 < lines[1].values.mean() < 0.03
    assert np.linalg.norm(lines[1].positions_m - lines[0].positions_m[:20], axis=1).max() < 0.05
    lines, _, panel = figure_lines([files / "truth.txt"], None)
    assert panel == SPEED
    steps = np.linalg.norm(np.diff(lines[0].positions_m, axis=0), axis=1)
    np.testing.assert_allclose(lines[0].values, 10 * steps, rtol=1e-4)


def test_lines_show_what_they_are_given(files):
    lines, truth, panel = figure_lines([files / "a", files / "b"], files / "truth.txt")
    figure = paper_figure(lines, truth, panel)
    top, side, time, often = figure.axes
    np.testing.assert_allclose(top.lines[1].get_xydata(), lines[0].positions_m[:, :2])
    np.testing.assert_allclose(side.lines[2].get_xydata(), lines[1].positions_m[:, [0, 2]])
    np.testing.assert_allclose(time.lines[0].get_ydata(), 100 * lines[0].values)
    assert [patch.get_data().values.sum() for patch in often.patches] == pytest.approx([100, 100])
    assert len(set(PALETTE)) == len(PALETTE) and len(set(DASHES)) == len(DASHES)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pdf", "svg", "png"])
def test_files_are_of_their_kind_and_the_same_each_time(files, kind):
    written = []
    for name in ("one", "two"):
        path = files / f"{name}.{kind}"
        arguments = ["plot", str(files / "a"), str(files / "b"), "--gt", str(files / "truth.txt"), "-o", str(path)]
        assert CliRunner().invoke(cli, arguments, catch_exceptions=False).exit_code == 0
        written.append(path.read_bytes())
    assert written[0] == written[1]
    assert written[0].startswith({"pdf": b"%PDF", "svg": b"<?xml", "png": b"\x89PNG"}[kind])


def test_names_are_names(files):
    odd = files / "$x_{^$ _<script>"
    odd.mkdir()
    (odd / "trajectory.txt").write_bytes((files / "truth.txt").read_bytes())
    arguments = ["plot", str(odd), str(files / "a"), "-o", str(files / "odd.svg")]
    assert CliRunner().invoke(cli, arguments, catch_exceptions=False).exit_code == 0
    assert b"<script>" not in (files / "odd.svg").read_bytes()
    assert labels([files / "a", files / "b"]) == ["a", "b"]
    assert labels([files / "a" / "trajectory.txt", files / "b" / "trajectory.txt"])[1] == "b/trajectory.txt"


def test_what_cannot_be_drawn_is_said(files):
    assert CliRunner().invoke(cli, ["plot", str(files / "a"), "-o", str(files / "x.jpg")]).exit_code == 2
    later = Trajectory(9000.0 + np.arange(5), np.repeat(np.eye(4)[None], 5, axis=0))
    write_trajectory(files / "later.txt", later)
    with pytest.raises(MiniloopError, match=r"later\.txt cannot be aligned to"):
        figure_lines([files / "a", files / "later.txt"], None)
    write_trajectory(files / "one.txt", Trajectory(later.timestamps_s[:1], later.T_world_cam[:1]))
    with pytest.raises(MiniloopError, match="at least 2"):
        figure_lines([files / "one.txt"], None)
