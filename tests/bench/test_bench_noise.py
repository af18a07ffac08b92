"""`miniloop bench noise` on few scenes: the scenes are what they say, cycles win, rows do not depend on jobs."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.bench.noise import METHODS, NOISE, OUTLIERS, VARIANTS, edges_of, random_scene, run_trial
from miniloop_cli.cli.bench import bench
from miniloop_cli.geometry import se3


@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_scene_without_noise(outliers, rng):
    T, edges = random_scene(rng, 0.0, outliers)
    assert len(edges) == 10
    for (i, j), edge in edges.items():
        assert 80 <= len(edge) <= 280
        moved = se3.transform(T[j] @ se3.inverse(T[i]), edge.p)
        wrong = np.linalg.norm(moved - edge.q, axis=1) > 1e-9
        # A wrong match may pick the right point by chance.
        assert wrong.sum() == pytest.approx(outliers * len(edge), abs=3)


def test_noise_grows_with_distance(rng):
    T, edges = random_scene(rng, 0.02, 0.0)
    ratios = []
    for (i, j), edge in edges.items():
        error = se3.transform(T[j] @ se3.inverse(T[i]), edge.p) - edge.q
        sigma = 0.02 * np.hypot(np.linalg.norm(edge.p, axis=1), np.linalg.norm(edge.q, axis=1))
        ratios.append(error / sigma[:, None])
    assert np.concatenate(ratios).std() == pytest.approx(1, abs=0.03)


def test_methods_connect_first_and_last_camera():
    for segments in METHODS.values():
        chain = [edge for scans in segments for edge in edges_of(scans)[: len(scans) - 1]]
        assert chain == [(0, 1), (1, 2), (2, 3), (3, 4)]
    assert edges_of((0, 1, 2)) == [(0, 1), (1, 2), (0, 2)]


def test_exact_scene_is_solved_by_all():
    results = run_trial([0, 0, 0], 0.0, 0.2)
    assert results.keys() == {(method, variant) for method in METHODS for variant in VARIANTS}
    for (_, variant), (rot_deg, shift, inliers) in results.items():
        assert rot_deg < (1e-3 if variant == "refined" else 3) and shift < (1e-2 if variant == "refined" else 10)
        assert 79 < inliers < 83


@pytest.mark.slow
def test_refined_5_cycle_beats_pairs():
    results = [run_trial([1, i], 0.03, 0.2) for i in range(15)]
    pairs, cycle = (
        np.median([r[method, "refined"][0] for r in results if (method, "refined") in r])
        for method in ("pairwise", "5-cycle")
    )
    assert cycle < 0.7 * pairs


@pytest.mark.slow
def test_rows_and_files(tmp_path):
    def run(jobs):
        result = CliRunner().invoke(
            bench,
            ["noise", "--trials", "2", "-o", str(tmp_path), "--json", "-", "-j", str(jobs), "-q"],
            catch_exceptions=False,
        )
        assert result.exit_code == 0
        return json.loads(result.stdout)["rows"]

    rows = run(1)
    assert len(rows) == (len(NOISE) + len(OUTLIERS)) * len(METHODS) * len(VARIANTS)
    assert run(2) == rows
    assert {row["method"] for row in rows} == set(METHODS)
    with (tmp_path / "noise.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(rows)
    assert (tmp_path / "noise.png").read_bytes().startswith(b"\x89PNG")
