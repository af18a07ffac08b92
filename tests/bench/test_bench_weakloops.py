"""`miniloop bench weakloops` on a small simulated recording: cycles are cycles, edges are judged by the truth."""

import csv
import json
import shutil
from itertools import pairwise, permutations

import networkx as nx
import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.api import simulate
from miniloop_cli.bench.known_overlaps import read_overlaps, right
from miniloop_cli.bench.weakloops import LENGTHS, MAX_MATCHES, MIN_MATCHES, STRONG, draw_loops, random_cycle, solve_loop
from miniloop_cli.cli.bench import bench
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.parallel import Workers

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return simulate(tmp_path_factory.mktemp("weakloops") / "sim", frames=9, width=320, height=240, path="xyz")


@pytest.fixture(scope="module")
def overlaps(folder):
    return read_overlaps(folder, load_settings(), None, Workers(1))


@pytest.mark.parametrize("seed", range(20))
def test_a_cycle_is_found_if_there_is_one(seed):
    rng = np.random.default_rng(seed)
    graph = nx.gnp_random_graph(8, 0.35, seed=seed)
    for pair in [(0, 1), (2, 5)]:
        for length in range(3, 8):
            cycle = random_cycle(graph, pair, length, rng)
            others = [k for k in graph if k not in pair]
            there = any(
                all(graph.has_edge(a, b) for a, b in zip((pair[0], *middle), (*middle, pair[1]), strict=True))
                for middle in permutations(others, length - 2)
            )
            assert bool(cycle) == there
            if there:
                assert len(set(cycle)) == length and (cycle[0], cycle[-1]) == pair
                assert all(graph.has_edge(a, b) for a, b in pairwise(cycle))


@pytest.mark.parametrize("partners", ["strong", "weak"])
def test_loops_are_as_weak_as_asked(overlaps, partners, rng):
    loops = draw_loops(overlaps, "thinned", partners, 10, rng)
    assert len(loops) == 10 == len({loop.pair for loop in loops})
    for loop in loops:
        assert loop.cycles.keys() == set(LENGTHS)
        kept = {tuple(row) for row in loop.matches[loop.pair]}
        assert MIN_MATCHES <= len(kept) <= MAX_MATCHES and kept < {tuple(row) for row in overlaps.matches[loop.pair]}
        for cycle in loop.cycles.values():
            for pair in pairwise(cycle):
                count = len(loop.matches[min(pair), max(pair)])
                assert count >= STRONG if partners == "strong" else MIN_MATCHES <= count <= MAX_MATCHES


def test_solved_edges_are_those_asked_for(overlaps, rng):
    for loop in draw_loops(overlaps, "thinned", "strong", 5, rng):
        results = solve_loop(loop, overlaps, 200, 0)
        assert list(results) == ["pairwise", *(f"cycle{n}" for n in LENGTHS)]
        for good, deg, metres, seconds in list(results.values())[1:]:
            assert good and deg < 2 and metres < 0.05 and seconds >= 0


def test_truth_decides(overlaps):
    T = se3.inverse(overlaps.T_world_cam[3]) @ overlaps.T_world_cam[1]
    assert right(*overlaps.errors([(1, 3)], T))
    for w, t in [([0, 0, np.radians(5.1)], [0, 0, 0]), ([0, 0, 0], [0.101, 0, 0])]:
        moved = T @ se3.pose(se3.exp_so3(np.array(w)), np.array(t))
        (deg,), (metres,) = overlaps.errors([(1, 3)], moved)
        assert not right(deg, metres) and max(deg / 5.1, metres / 0.101) == pytest.approx(1, rel=1e-6)
    edge = overlaps.matches[1, 3]
    assert overlaps.true_matches((1, 3), edge) > 0.8 * len(edge)
    assert overlaps.true_matches(
        (1, 3), np.stack([edge[:, 0], np.roll(edge[:, 1], len(edge) // 2)], axis=1)
    ) < 0.2 * len(edge)


@pytest.mark.slow
def test_rows_do_not_depend_on_jobs(folder, tmp_path):
    def run(jobs):
        arguments = ["weakloops", str(folder), "--edges", "6", "--hypotheses", "100", "-o", str(tmp_path)]
        result = CliRunner().invoke(bench, [*arguments, "--json", "-", "-j", str(jobs), "-q"], catch_exceptions=False)
        assert result.exit_code == 0
        return [{k: v for k, v in row.items() if k != "cpu_ms"} for row in json.loads(result.stdout)["rows"]]

    rows = run(1)
    assert run(2) == rows
    whole = [
        r
        for r in rows
        if (r["weak"], r["partners"], r["matches"]) == ("thinned", "strong", f"{MIN_MATCHES}-{MAX_MATCHES}")
    ]
    assert [row["edges"] for row in whole] == [6] * 6 and whole[1]["solver"] == "cycle3"
    with (tmp_path / "weakloops.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(rows)
    assert (tmp_path / "weakloops.png").read_bytes().startswith(b"\x89PNG")


def test_a_recording_without_truth_is_refused(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "bare", ignore=shutil.ignore_patterns("groundtruth.txt"))
    with pytest.raises(InputError, match="has no ground truth"):
        read_overlaps(tmp_path / "bare", load_settings(), None, Workers(1))
