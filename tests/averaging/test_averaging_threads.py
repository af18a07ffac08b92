"""Averaging in blocks on several threads: the same bytes for any number of them."""

import numpy as np
import pytest

from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.averaging.rotations import average_rotations
from miniloop_cli.averaging.translations import average_translations
from miniloop_cli.runtime import blocks as of_blocks
from miniloop_cli.runtime.blocks import Blocks
from miniloop_cli.scene.view_graph import GraphError


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(of_blocks, "BLOCK", 64)


@pytest.mark.parametrize("kind", ["video", "expander"])
def test_same_bytes_for_any_number_of_jobs(kind):
    graph = view_graph(kind, 400, 2000, 0.1, 0.5, 0.01, np.random.default_rng(1))
    results = []
    for jobs in (1, 2, 5):
        with Blocks(jobs) as blocks:
            rotations = average_rotations(400, graph.pairs, graph.T_j_i[:, :3, :3], blocks=blocks)
            R = rotations.R_world_cam
            translations = average_translations(R, graph.pairs, graph.T_j_i[:, :3, 3], blocks=blocks)
        arrays = R, rotations.residual_deg, translations.t_world_cam, translations.residual_m
        results.append([array.tobytes() for array in arrays])
    assert results[0] == results[1] == results[2]


def test_errors_name_the_edge_in_any_block():
    graph = view_graph("video", 200, 800, 0.0, 0.0, 0.0, np.random.default_rng(2))
    R_j_i = graph.T_j_i[:, :3, :3].copy()
    R_j_i[700] = np.nan
    R_j_i[750] *= -1
    with Blocks(2) as blocks, pytest.raises(GraphError, match="edge 700 is not finite"):
        average_rotations(200, graph.pairs, R_j_i, blocks=blocks)


@pytest.mark.parametrize("jobs", [1, 3])
def test_parts_come_in_order_and_cover_every_row_once(jobs):
    with Blocks(jobs) as blocks:
        parts = blocks.map(lambda low, high: list(range(low, high)), 1000)
        assert blocks.map(lambda low, high: low, 0) == []
    assert [row for part in parts for row in part] == list(range(1000))
    assert len(parts) == 16
