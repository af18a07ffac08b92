"""Which pairs are compared: lists, files, and how."""

import numpy as np
import pytest

from miniloop_cli.config import Matching
from miniloop_cli.errors import InputError
from miniloop_cli.features.lsh_match import sketch
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.stages.candidates import listed_pairs, match_fully, match_quickly

WORKERS = Workers(1)


def test_lists_of_pairs():
    settings = Matching(sequential_window=2)
    assert len(listed_pairs(10, "exhaustive", settings)) == len(listed_pairs(10, "auto", settings)) == 45
    assert listed_pairs(4, "sequential", settings) == [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]


def test_a_file_of_pairs_is_read_and_its_mistakes_are_named(tmp_path):
    path = tmp_path / "pairs.txt"
    path.write_text("# two\n3 1\n1,3\n0 2 # twice is once\n2 2\n")
    assert listed_pairs(4, str(path), Matching()) == [(0, 2), (1, 3)]
    path.write_text("0 1\n0 4\n")
    with pytest.raises(InputError, match="line 2"):
        listed_pairs(4, str(path), Matching())
    path.write_text("0 1\n0 " + "9" * 5000 + "\n")  # more digits than Python takes for a number
    with pytest.raises(InputError, match="line 2"):
        listed_pairs(4, str(path), Matching())
    for name in ("none.txt", "n" * 5000, "zero\0byte"):
        with pytest.raises(InputError, match="sequential"):
            listed_pairs(4, str(tmp_path / name), Matching())


def scans_of_one_place_and_another(rng, count=600):
    """Two scans of one place (the second moved) and one of another place: descriptors (count, 64) uint8 and points."""
    here, there = rng.uniform((-1, -1, 2), (1, 1, 4), (2, count, 3))
    looks = rng.integers(1, 255, (2, count, 64), dtype=np.uint8)
    covariances = np.tile(1e-6 * np.eye(3), (count, 1, 1))
    points = [ScanPoints(p, covariances) for p in (here, here + np.array([0.2, 0, 0.1]), there)]
    return [looks[0], looks[0] + np.uint8(1), looks[1]], points


def test_overlaps_are_kept_and_the_rest_is_dropped():
    descriptors, points = scans_of_one_place_and_another(np.random.default_rng(0))
    pairs, settings = [(0, 1), (0, 2), (1, 2)], Matching()
    quick = match_quickly(sketch(descriptors), points, pairs, settings, 0.64, WORKERS)
    full = match_fully([found.astype(np.float32) for found in descriptors], pairs, settings, WORKERS)
    assert list(quick) == list(full) == [(0, 1)]
    assert np.array_equal(quick[0, 1], full[0, 1])
    assert len(full[0, 1]) == 600


def test_matches_that_do_not_agree_in_their_distances_are_no_overlap():
    descriptors, points = scans_of_one_place_and_another(np.random.default_rng(1), 30)
    features = sketch([descriptors[0], descriptors[0] + np.uint8(1)])
    pair = [(0, 1)]
    assert len(match_quickly(features, points[:2], pair, Matching(), 0.64, WORKERS)[0, 1]) == 30
    elsewhere = [points[0], points[2]]  # the same looks, other places
    assert not match_quickly(features, elsewhere, pair, Matching(), 0.64, WORKERS)
    assert len(match_quickly(features, elsewhere, pair, Matching(min_distance_consistent=0), 0.64, WORKERS)[0, 1]) == 30
