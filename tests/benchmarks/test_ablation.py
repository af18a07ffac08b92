"""`python -m benchmarks ablation` on a small simulated recording."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from benchmarks.experiments.ablation import PROTOCOL, VARIANTS, ablation_rows, draw
from benchmarks.experiments.feature_store import FeatureStore
from miniloop_cli.api import evaluate, register, simulate
from miniloop_cli.errors import ConfigError, InputError
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.stages.artifacts import EDGES, FEATURES

pytestmark = pytest.mark.usefixtures("own_cache")

LENS = (0.26, -0.95, 0.0, 0.0, 1.16)
NAMES = ["ROS camera", "pairwise only", "averaging only"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("ablation")
    return simulate(root / "sim", frames=8, width=320, height=240, path="xyz", distortion=LENS)


@pytest.fixture(scope="module")
def rows(folder, tmp_path_factory):
    output = tmp_path_factory.mktemp("output")
    only = [option for name in NAMES for option in ("--only", name)]
    arguments = ["ablation", str(folder), *only, "-o", str(output), "--json", "-", "-q"]
    result = CliRunner().invoke(benchmarks, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    with (output / "ablation.csv").open() as file:
        assert [row["variant"] for row in csv.DictReader(file)] == ["default", *NAMES]
    assert (output / "ablation.png").read_bytes().startswith(b"\x89PNG")
    return {row["variant"]: row for row in json.loads(result.stdout)["rows"]}


@pytest.mark.slow
def test_rows_say_what_was_measured(rows):
    for row in rows.values():
        assert row["frames"] == 8 == row["registered"]
        assert row["edges_scored"] == rows["default"]["edges"] > 7
        assert row["seconds"] == pytest.approx(
            sum(row[f"{s}_s"] for s in ("matching", "edges", "averaging", "refinement")),
            abs=0.005,  # each is rounded to milliseconds
        )
        assert row["cpu_s"] > 0 and row["problem"] == ""
        assert 0 < row["estimate_deg"] < 2 and 0 < row["estimate_cm"] < 5 and row["wrong_share"] == 0


@pytest.mark.slow
def test_a_step_taken_away_costs_accuracy(rows):
    assert rows["default"]["ate_cm"] < 2
    assert rows["ROS camera"]["ate_cm"] > 1.5 * rows["default"]["ate_cm"]


@pytest.mark.slow
def test_every_stage_is_timed_in_every_row(rows):
    for row in rows.values():
        assert min(row[f"{stage}_s"] for stage in ("matching", "edges", "averaging")) > 0
    assert rows["averaging only"]["refinement_s"] < rows["default"]["refinement_s"]


@pytest.mark.slow
def test_agrees_with_register_and_eval(rows, folder, tmp_path):
    register(folder, tmp_path / "result")
    numbers = evaluate(tmp_path / "result", folder, protocol=PROTOCOL).numbers
    assert rows["default"]["ate_cm"] == pytest.approx(100 * numbers["ate_rmse_m"], abs=1e-3)
    assert rows["default"]["edge_cm"] == pytest.approx(100 * numbers["rpe"]["edges"]["trans_m_mean"], abs=1e-3)
    assert rows["default"]["edge_deg"] == pytest.approx(numbers["rpe"]["edges"]["rot_deg_mean"], abs=1e-3)


@pytest.mark.slow
def test_edges_of_a_file(folder, tmp_path):
    (tmp_path / "edges.txt").write_text("0 1\n1 2  # all\n0 7\n")
    (row,) = ablation_rows([folder], ["default"], [tmp_path / "edges.txt"])
    assert row["edges_scored"] == 3


@pytest.mark.slow
def test_nothing_registered_is_a_row_with_its_reason(tmp_path):
    blank = simulate(tmp_path / "blank", frames=4, width=160, height=120, scene="textureless", noise=False)
    (row,) = ablation_rows([blank], ["default"])
    assert (row["registered"], row["ate_cm"], row["edges_scored"]) == (0, None, None)
    assert "no scan was registered" in row["problem"]
    assert row["refinement_s"] is None and row["matching_s"] > 0 and row["seconds"] > 0
    assert len(draw([row]).axes) == 4


@pytest.mark.slow
def test_what_cannot_be_done_is_said(folder, tmp_path):
    with pytest.raises(ConfigError, match="no variant 'pairs'"):
        list(ablation_rows([folder], ["pairs"]))
    with pytest.raises(ConfigError, match="2 edge lists for 1"):
        list(ablation_rows([folder], edge_files=[tmp_path, tmp_path]))
    without = simulate(tmp_path / "without", frames=2, width=160, height=120)
    (without / "groundtruth.txt").unlink()
    with pytest.raises(InputError, match="has no ground truth"):
        list(ablation_rows([without]))


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_is_made_of_known_settings(name):
    variant = VARIANTS[name]
    settings = load_settings(variant.preset, variant.changes)
    changed = settings != load_settings() or variant.ros_camera
    assert changed == (name != "default")


def test_list_needs_no_recording():
    result = CliRunner().invoke(benchmarks, ["ablation", "--list"], catch_exceptions=False)
    assert [line.split("  ")[0] for line in result.stdout.splitlines()] == list(VARIANTS)


def test_only_features_are_kept(tmp_path):
    store = FeatureStore(tmp_path)
    for artifact in (FEATURES, EDGES):
        store.save(artifact, "k", {"x": np.arange(3)})
    assert store.load(FEATURES, "k")["x"].tolist() == [0, 1, 2]
    assert store.load(EDGES, "k") is None
    assert Store(tmp_path).load(EDGES, "k") is None
    Store(tmp_path).save(EDGES, "k", {"x": np.arange(3)})
    assert store.load(EDGES, "k") is None
