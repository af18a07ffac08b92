"""The work of a factor: counted where that is quick, and predicted where it would take long."""

import numpy as np
import pytest

from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.averaging import fill_in
from miniloop_cli.averaging.fill_in import factor_work, predicted_work
from miniloop_cli.averaging.optimum import MOST_WORK
from miniloop_cli.scene.view_graph import elimination


def graph(kind, scans, outliers=0.0):
    return view_graph(kind, scans, 5 * scans, outliers, 0.5, 0.01, np.random.default_rng(0)).pairs


@pytest.mark.parametrize("scans", [1000, pytest.param(3000, marks=pytest.mark.slow)])
def test_the_forecast_of_a_random_graph_is_right_within_what_it_promises(scans):
    pairs = graph("expander", scans)
    assert 1 / fill_in.SURELY < predicted_work(scans, pairs) / elimination(scans, pairs)[1] < fill_in.SURELY


def test_random_graphs_are_refused_before_anything_is_factorised(monkeypatch):
    def never(count, pairs):
        raise AssertionError("a factor of this graph takes hours")

    monkeypatch.setattr(fill_in, "elimination", never)
    scans = fill_in.COUNTED + 1
    assert factor_work(scans, graph("expander", scans), MOST_WORK) > 100 * MOST_WORK


@pytest.mark.parametrize("scans", [1000, pytest.param(fill_in.COUNTED + 1, marks=pytest.mark.slow)])
def test_the_work_of_a_recording_is_counted_at_any_size(scans):
    pairs = graph("video", scans)
    assert factor_work(scans, pairs, MOST_WORK) == elimination(scans, pairs)[1] < MOST_WORK
