"""`miniloop bench minisequences` and `bench tables`: the paper's real experiments, on a small simulated recording."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.api import simulate
from miniloop_cli.bench.minisequences import NEEDED, PAPER_NUMBERS, draw_loops, error_summary
from miniloop_cli.bench.overlaps import overlaps, paper_sequence
from miniloop_cli.bench.tables import PAPER_CYCLES, RUNS
from miniloop_cli.cli.bench import bench
from miniloop_cli.errors import InputError
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.registration import RegistrationError

pytestmark = pytest.mark.usefixtures("own_cache")

FRAMES = 10


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("freiburg1_xyz_like")
    return simulate(root / "freiburg1_xyz_like", frames=FRAMES, width=320, height=240, path="xyz")


@pytest.fixture(scope="module")
def graph(folder):
    return overlaps(folder, load_settings(), Workers(2))


def rows_of(output, name, *arguments):
    result = CliRunner().invoke(bench, [name, *arguments, "-o", str(output), "--json", "-", "-q"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["rows"]
    with (output / f"{name}.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(rows)
    assert (output / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    return rows


@pytest.mark.slow
def test_minisequences(folder, tmp_path):
    rows = rows_of(tmp_path, "minisequences", str(folder), "--loops", "6", "--min-matches", "20", "--config", "default")
    assert [row["method"] for row in rows] == 2 * list(PAPER_NUMBERS)
    for row in rows:
        assert row["loops"] == 6 and row["failed"] == 0 and row["min_matches"] == 20
        assert 0 < row["rot_deg_mean"] < 5 and 0 < row["trans_cm_mean"] < 15
        if row["method"] == "pairwise":
            assert row["rot_better"] is None
        else:
            assert 0 <= row["rot_better"] <= 1 - row["rot_equal"]
    paper, refined = (np.mean([r["trans_cm_mean"] for r in rows if r["variant"] == v]) for v in ("paper", "refined"))
    assert refined < paper
    assert rows[3]["paper_rot_deg_mean"] == 0.77 and rows[3]["paper_trans_better"] == 0.46


@pytest.mark.slow
def test_minisequences_do_not_depend_on_the_jobs(folder, tmp_path):
    arguments = (str(folder), "--loops", "3", "--min-matches", "20", "--config", "default")
    one, two = (rows_of(tmp_path, "minisequences", *arguments, "-j", jobs) for jobs in ("1", "2"))
    assert one == two


def test_loops_have_all_edges_in_order_of_time():
    rng = np.random.default_rng(0)
    pairs = {(i, j): np.zeros((9, 2)) for i in range(12) for j in range(i + 1, 12) if rng.random() < 0.7}
    known = np.ones(12, bool)
    known[5] = False
    loops = draw_loops(pairs, known, 20, rng)
    assert len(set(loops)) == 20
    for loop in loops:
        assert list(loop) == sorted(set(loop)) and 5 not in loop
        assert all((loop[a], loop[b]) in pairs for a, b in NEEDED)
    chain = {(i, i + 1): np.zeros((9, 2)) for i in range(11)}
    with pytest.raises(RegistrationError, match="no five scans"):
        draw_loops(chain, known, 1, rng)
    with pytest.raises(RegistrationError, match="no five scans"):
        draw_loops({}, known, 1, rng)


def test_better_and_equal_are_counted_as_in_the_paper():
    pairs = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [1.0, 2.0]])
    mine = np.array([[0.5, 2.5], [1.00005, 2.00005], [0.9998, 1.9], [3.0, 1.0]])
    row = error_summary(mine, pairs)
    assert (row["rot_better"], row["rot_equal"]) == (0.5, 0.25)
    assert (row["trans_better"], row["trans_equal"]) == (0.5, 0.25)
    assert row["rot_deg_mean"] == pytest.approx(mine[:, 0].mean()) and row["trans_cm_median"] == pytest.approx(1.950025)


@pytest.mark.slow
def test_threshold_is_found_by_the_number_of_edges(graph):
    assert paper_sequence("rgbd_dataset_freiburg1_xyz") == "freiburg1_xyz" and paper_sequence("freiburg1_desk") is None
    for wanted in (10, 25):
        least = graph.least_for(wanted)
        sizes = {T: len(graph.with_matches(T)) for T in (least - 1, least, least + 1)}
        assert all(abs(sizes[least] - wanted) <= abs(size - wanted) for size in sizes.values())
    share = len(graph.with_matches(graph.least_as_in_paper)) / (FRAMES * (FRAMES - 1) / 2)
    assert share == pytest.approx(1751 / 4950, abs=0.03)


@pytest.mark.slow
def test_tables(folder, graph, tmp_path):
    rows = rows_of(tmp_path, "tables", str(folder), "--config", "default")
    cycles, errors = ([row for row in rows if row["table"] == name] for name in ("cycles", "errors"))
    for row in cycles:
        covered = row["pairwise"] + 3 * row["cycle3"] + 4 * row["cycle4"] + 5 * row["cycle5"]
        assert covered == row["edges"] == len(graph.with_matches(row["min_matches"]))
        assert row["as_in_paper"] == (row["min_matches"] == graph.least_as_in_paper)
        paper = tuple(row[f"paper_{name}"] for name in ("pairwise", "cycle3", "cycle4", "cycle5"))
        assert paper == (PAPER_CYCLES["freiburg1_xyz"] if row["as_in_paper"] else (None,) * 4)
    assert any(row["as_in_paper"] for row in cycles) and {row["decomposition"] for row in cycles} == {"dfs", "support"}
    assert [row["run"] for row in errors] == list(RUNS)
    by_run = {row["run"]: row for row in errors}
    default = by_run["default"]
    assert default["registered"] == FRAMES and default["edges_scored"] == default["edges"]
    assert default["rot_deg_mean"] < 0.5 and default["trans_cm_mean"] < 1.5
    assert by_run["paper"]["registered"] < FRAMES or default["trans_cm_mean"] < by_run["paper"]["trans_cm_mean"]
    own = overlaps(folder, load_settings("paper"), Workers(2))
    assert by_run["paper"]["edges_of_run"] == len(own.with_matches(own.least_as_in_paper)), "of its own T"
    assert 0 < default["estimate_rot_deg_mean"] < 3
    assert default["paper_rot_deg_mean"] == 0.740


def test_the_papers_tables_are_its_edges():
    covered = {name: p + 3 * a + 4 * b + 5 * c for name, (p, a, b, c) in PAPER_CYCLES.items()}
    assert covered == {"freiburg1_room": 435, "freiburg1_xyz": 1751, "freiburg2_desk": 687}


@pytest.mark.slow
def test_without_ground_truth_it_says_so(tmp_path):
    without = simulate(tmp_path / "without", frames=2, width=160, height=120)
    (without / "groundtruth.txt").unlink()
    for name in ("minisequences", "tables"):
        result = CliRunner().invoke(bench, [name, str(without), "-o", str(tmp_path)])
        assert isinstance(result.exception, InputError) and "has no ground truth" in str(result.exception)
