"""Which pairs are compared: lists, files, and the look that decides."""

import numpy as np
import pytest

from miniloop_cli.config import Matching
from miniloop_cli.errors import InputError
from miniloop_cli.graph.candidates import listed_pairs, match_fully, match_progressively
from miniloop_cli.graph.overlap import ScanPoints
from miniloop_cli.parallel import Workers

WORKERS = Workers(1)


def test_lists_of_pairs():
    settings = Matching(neighbours=2)
    assert len(listed_pairs(10, "exhaustive", settings)) == len(listed_pairs(10, "auto", settings)) == 45
    assert listed_pairs(4, "sequential", settings) == [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]


def test_a_file_of_pairs_is_read_and_its_mistakes_are_named(tmp_path):
    path = tmp_path / "pairs.txt"
    path.write_text("# two\n3 1\n1,3\n0 2 # twice is once\n2 2\n")
    assert listed_pairs(4, str(path), Matching()) == [(0, 2), (1, 3)]
    path.write_text("0 1\n0 4\n")
    with pytest.raises(InputError, match="line 2"):
        listed_pairs(4, str(path), Matching())
    with pytest.raises(InputError, match="sequential"):
        listed_pairs(4, str(tmp_path / "none.txt"), Matching())


def scans_of_one_place_and_another(rng, count=600):
    """Two scans of one place (the second moved) and one of another place."""
    here, there = rng.uniform((-1, -1, 2), (1, 1, 4), (2, count, 3))
    looks = rng.normal(size=(2, count, 64)).astype(np.float32)
    covariances = np.tile(1e-6 * np.eye(3), (count, 1, 1))
    points = [ScanPoints(p, covariances) for p in (here, here + np.array([0.2, 0, 0.1]), there)]
    return [looks[0], looks[0] + np.float32(0.01), looks[1]], points


def test_the_look_keeps_overlaps_and_drops_the_rest():
    descriptors, points = scans_of_one_place_and_another(np.random.default_rng(0))
    pairs = [(0, 1), (0, 2), (1, 2)]
    settings = Matching(look_count=300, look_enough=15)
    assert list(match_progressively(descriptors, points, pairs, settings, WORKERS)) == [(0, 1)]
    assert len(match_progressively(descriptors, points, pairs, settings, WORKERS)[0, 1]) == 300
    unsure = Matching(look_count=300, look_enough=10_000)
    full = match_fully(descriptors, pairs, unsure, WORKERS)
    assert np.array_equal(match_progressively(descriptors, points, pairs, unsure, WORKERS)[0, 1], full[0, 1])
    assert len(full[0, 1]) == 600
