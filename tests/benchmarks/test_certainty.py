"""`python -m benchmarks certainty`, in small: what counts as elsewhere, and as right."""

import numpy as np
import pytest

from benchmarks.experiments.certainty import CASES, PAIRS, certainty_row, certainty_rows, elsewhere, map_row, outcome
from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry import se3
from miniloop_cli.results.assessment import Level
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.simulation.settings import SimulationSettings


def test_what_stands_elsewhere_is_counted_whatever_the_world(rng):
    T_true = se3.pose(se3.exp_so3(rng.normal(size=(12, 3))), rng.normal(size=(12, 3)))
    T = se3.pose(se3.exp_so3(np.array([0.2, 1.0, 0.3])), np.array([3.0, 1.0, 2.0])) @ T_true
    assert elsewhere(T, T_true) == 0
    T[9:] = se3.pose(np.eye(3), np.array([0.0, 0.3, 0.0])) @ T[9:]
    assert elsewhere(T, T_true) == 3
    T[:8, :3, 3] += rng.normal(0, 0.01, (8, 3))
    assert elsewhere(T, T_true) == 3


def test_outcomes():
    said = {(level, off): outcome(level, off) for level in Level for off in (0, 2)}
    assert said[Level.GOOD, 2] == "sure, WRONG" and said[Level.GOOD, 0] == "sure, right"
    assert said[Level.DOUBTFUL, 2] == "doubted, wrong" and said[Level.DOUBTFUL, 0] == "doubted, right"
    assert said[Level.BAD, 0] == said[Level.BAD, 2] == "bad"


def test_every_case_can_be_simulated():
    alone = [*CASES.values(), *(changes for *both, _ in PAIRS.values() for changes in both)]
    assert all(SimulationSettings(**changes).frames >= 24 for changes in alone)
    with pytest.raises(ConfigError, match="no case 'rom'"):
        next(certainty_rows(["rom"]))


@pytest.mark.slow
def test_a_turntable_that_looks_alike_from_behind_is_no_sure_thing():
    name = "turntable, alike from behind"
    row = certainty_row(name, CASES[name] | {"frames": 18}, 240, 0, Workers(1, True))
    assert row["registered"] > 9 and row["certified"]
    assert row["outcome"] in ("sure, right", "doubted, wrong", "doubted, right")


@pytest.mark.slow
def test_two_rooms_with_the_same_furniture_are_not_taken_for_one():
    row = map_row("map: two rooms, same furniture", 240, 0, Workers(1, True))
    assert row["registered"] > 40 and row["elsewhere"] == 0
    assert row["outcome"] == "doubted, right" and row["pieces"] == 2 and "2 pieces" in row["said"]
