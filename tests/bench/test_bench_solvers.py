"""`miniloop bench solvers` on few problems: rows, files, determinism."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.bench.problems import noisy_cycle, random_problems, random_rotations
from miniloop_cli.bench.solvers import solver_rows
from miniloop_cli.cli.bench import bench
from miniloop_cli.geometry import se3
from miniloop_cli.solvers import SOLVERS
from miniloop_cli.solvers.batch import match_residuals

KEYS = {
    "solver", "problems", "truth_found_share", "max_solutions", "solutions_histogram", "max_residual",
    "us_per_call_batch", "us_per_call_single", "ransac_ms",
}  # fmt: skip


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("matches", [(3,), (2, 2, 1), (1, 1, 1, 2)])
def test_problems_are_exact(matches, upright, rng):
    p, q, T = random_problems(rng, matches, 50, side=400.0, upright=upright)
    assert p.shape == q.shape == (50, sum(matches), 3)
    assert match_residuals(T, p, q, matches).max() < 1e-10
    np.testing.assert_allclose(np.linalg.det(T[..., :3, :3]), 1)
    assert upright == bool(np.allclose(T[..., 2, :3], [0, 0, 1]))


def test_random_rotations_are_uniform(rng):
    R = random_rotations(rng, (20000,))
    np.testing.assert_allclose(R.mean(axis=0), 0, atol=0.03)
    np.testing.assert_allclose((R**2).mean(axis=0), 1 / 3, atol=0.02)


@pytest.mark.slow
def test_rows_and_files(tmp_path):
    result = CliRunner().invoke(
        bench, ["solvers", "--problems", "300", "-o", str(tmp_path), "--json", "-", "-q"], catch_exceptions=False
    )
    assert result.exit_code == 0
    rows = json.loads(result.stdout)["rows"]
    assert [row["solver"] for row in rows] == list(SOLVERS)
    for row in rows:
        assert row.keys() >= KEYS
        assert row["problems"] == 300 == sum(row["solutions_histogram"].values())
        assert row["truth_found_share"] >= 0.99
        assert row["max_solutions"] == max(map(int, row["solutions_histogram"])) <= row["solutions_bound"]
        assert row["us_per_call_batch"] > 0 and row["us_per_call_single"] > 0 and row["ransac_ms"] > 0
    with (tmp_path / "solvers.csv").open() as file:
        assert [row["solver"] for row in csv.DictReader(file)] == list(SOLVERS)
    assert (tmp_path / "solvers.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_table_names_the_paper(tmp_path):
    result = CliRunner().invoke(bench, ["solvers", "--problems", "50", "-o", str(tmp_path)], catch_exceptions=False)
    assert "us paper" in result.stdout and "2.495e+04" in result.stdout


def test_same_seed_same_numbers():
    first, again, other = (solver_rows(200, seed, ["cycle4"])[0] for seed in (1, 1, 2))
    assert first["solutions_histogram"] == again["solutions_histogram"]
    assert first["max_residual"] == again["max_residual"] != other["max_residual"]


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("scans", [2, 3, 5])
def test_noisy_cycles_are_what_they_say(scans, upright, rng):
    edges, T = noisy_cycle(rng, scans, matches=100, outliers=0.3, sigma_m=0.002, upright=upright)
    assert len(edges) == len(T) == (1 if scans == 2 else scans)
    for edge, pose in zip(edges, T, strict=True):
        distance = np.linalg.norm(se3.transform(pose, edge.p) - edge.q, axis=1)
        assert (distance < 0.02).sum() == pytest.approx(70, abs=1)
        assert upright == bool(np.allclose(pose[2, :3], [0, 0, 1]))
    if scans > 2:
        np.testing.assert_allclose(np.linalg.multi_dot([*T[-2::-1], np.eye(4)]), T[-1], atol=1e-12)
