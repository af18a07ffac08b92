"""Scans placed by outlines only are named; a few outlines among other matches, or many others, do no harm."""

import numpy as np
import pytest

from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.verification.depth_discontinuities import MIN_OTHER_MATCHES, share_on_discontinuities

FEATURES = 100
OUTLINE = np.arange(FEATURES) < 50  # of every scan: the first half


def edge(i, j, on_outline, elsewhere):
    """An edge with so many inliers, and as many matches on outlines that are none."""
    rows = np.concatenate([np.arange(on_outline), np.arange(50, 50 + elsewhere), np.arange(40)])
    return Edge(i, j, np.stack([rows, rows], 1), np.arange(len(rows)) < on_outline + elsewhere)


def named(edges, outline):
    """The scans that are placed by discontinuities, with the share."""
    share = share_on_discontinuities(EdgeTable.of(edges), outline)
    return {int(scan): share[scan] for scan in np.flatnonzero(share)}


def test_scans_whose_matches_lie_on_discontinuities_are_named_with_the_share():
    found = named([edge(0, 1, 12, 6), edge(1, 2, 11, 9)], [OUTLINE] * 4)
    assert found == pytest.approx({0: 12 / 18, 1: 23 / 38, 2: 11 / 20})


def test_enough_matches_elsewhere_in_one_overlap_clear_both_scans():
    edges = [edge(0, 1, 40, MIN_OTHER_MATCHES), edge(1, 2, 12, 6), edge(3, 4, 3, 12)]
    assert set(named(edges, [OUTLINE] * 5)) == {2}


def test_a_discontinuity_in_either_scan_counts():
    assert set(named([edge(0, 1, 12, 6)], [OUTLINE, np.zeros(FEATURES, bool)])) == {0, 1}
    assert not named([edge(0, 1, 12, 6)], [np.zeros(FEATURES, bool)] * 2)
    assert not named([], [OUTLINE])
