"""rejected.npz: some matches of every rejected edge, those that agree first, and only of rejected ones."""

from types import SimpleNamespace

import numpy as np

from miniloop_cli.results.rejected_matches import MOST_INLIERS, MOST_MATCHES, read_rejected, write_rejected
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.verdict import Verdict


def edge(i, j, matches, inliers, verdict):
    rows = np.stack([np.arange(matches), np.arange(matches)[::-1]], axis=1)
    agrees = np.zeros(matches, bool)
    agrees[np.random.default_rng(i + j).permutation(matches)[:inliers]] = True
    return Edge(i, j, rows, agrees, verdict=verdict)


def test_only_rejected_edges_are_in_it_and_their_pixels_are_those_of_the_features(tmp_path):
    px = np.random.default_rng(0).uniform(0, 640, (3, 100, 2))
    scans = [SimpleNamespace(features=SimpleNamespace(px=rows)) for rows in px]
    edges = [
        edge(0, 1, 100, 50, Verdict.REJECTED),
        edge(0, 2, 40, 30, Verdict.VERIFIED),
        edge(1, 2, 7, 2, Verdict.REJECTED),
    ]
    write_rejected(SimpleNamespace(edges=EdgeTable.of(edges), scans=scans), tmp_path / "rejected.npz")
    read = read_rejected(tmp_path, 3)
    assert sorted(read) == [0, 2]
    px_i, px_j, agrees = read[0]
    assert len(px_i) == MOST_MATCHES and agrees.sum() == MOST_INLIERS
    for row_i, row_j, agree in zip(px_i, px_j, agrees, strict=True):
        k = np.abs(px[0] - row_i).max(axis=1).argmin()
        assert edges[0].inliers[k] == agree
        np.testing.assert_allclose([row_i, row_j], [px[0][k], px[1][99 - k]], atol=0.5)
    assert len(read[2][0]) == 7 and read[2][2].sum() == 2


def test_no_rejected_edges_are_none(tmp_path):
    write_rejected(SimpleNamespace(edges=EdgeTable.of([]), scans=[]), tmp_path / "rejected.npz")
    assert read_rejected(tmp_path, 0) == {}
    assert read_rejected(tmp_path / "elsewhere", 0) == {}
