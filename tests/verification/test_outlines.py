"""Scans placed by outlines only are named; a few outlines among other matches, or many others, do no harm."""

import numpy as np

from miniloop_cli.scene.edge import Edge
from miniloop_cli.verification.depth_discontinuities import MIN_OTHER_MATCHES, by_outlines

FEATURES = 100
OUTLINE = np.arange(FEATURES) < 50  # of every scan: the first half


def edge(i, j, on_outline, elsewhere):
    """An edge with so many inliers, and as many matches on outlines that are none."""
    rows = np.concatenate([np.arange(on_outline), np.arange(50, 50 + elsewhere), np.arange(40)])
    return Edge(i, j, np.stack([rows, rows], 1), np.arange(len(rows)) < on_outline + elsewhere)


def test_scans_whose_matches_lie_on_outlines_are_named_with_the_share():
    found = by_outlines([edge(0, 1, 12, 6), edge(1, 2, 11, 9)], [OUTLINE] * 4)
    assert set(found) == {0, 1, 2}
    assert found[0].startswith("scan 0: 67 % of its matches lie on outlines")
    assert found[1].startswith("scan 1: 61 %")


def test_enough_matches_elsewhere_in_one_overlap_clear_both_scans():
    edges = [edge(0, 1, 40, MIN_OTHER_MATCHES), edge(1, 2, 12, 6), edge(3, 4, 3, 12)]
    assert set(by_outlines(edges, [OUTLINE] * 5)) == {2}


def test_an_outline_in_either_scan_counts():
    assert set(by_outlines([edge(0, 1, 12, 6)], [OUTLINE, np.zeros(FEATURES, bool)])) == {0, 1}
    assert not by_outlines([edge(0, 1, 12, 6)], [np.zeros(FEATURES, bool)] * 2)
    assert not by_outlines([], [OUTLINE])
