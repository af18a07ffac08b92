"""The edges by which a recording is placed in a map are judged by the images of both."""

from dataclasses import replace

import numpy as np
import pytest
from map_scenes import small_map, small_part

from miniloop_cli.config import Settings
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.stages import placing
from miniloop_cli.stages.run import Run
from miniloop_cli.verification.consensus import average_verified

SAME = np.repeat(np.arange(120)[:, None], 2, axis=1)


def between(T):
    """Edges of all keyframes T (4, 4, 4) of a recording with those of another at the same poses."""
    return EdgeTable.of([
        Edge(i, 4 + j, SAME, np.ones(120, bool), se3.inverse(T[j]) @ T[i], 1e4 * np.eye(6), 1e-4 * np.eye(6),
             verdict=Verdict.VERIFIED)
        for i in range(4) for j in range(4)
    ])  # fmt: skip


@pytest.mark.parametrize("seed", [0, 1])
def test_edges_to_the_map_are_compared_by_their_views(seed, tmp_path, monkeypatch):
    before, part, judged = small_map(), small_part("kitchen"), []
    part = replace(part, views=small_part(seed=seed).views)  # those of the map with the same seed, else others

    def average(*given):
        poses, edges = average_verified(*given)
        judged.append(edges)
        return poses, edges

    monkeypatch.setattr(placing, "average_verified", average)
    run = Run(Store(tmp_path), Workers(1))
    placing.placed_in(before, part, {(0, 1): between(part.T_world_key)}, Settings(), run)
    edges = judged[0]
    across = (edges.i < 4) & (edges.j >= 4)
    # All views of a small recording are one image: only those of the same keyframes fit.
    alike = across & (edges.j == edges.i + 4) & (seed == 0)
    assert across.sum() == 16
    np.testing.assert_array_equal(edges.rejection == Rejection.LOOKS_DIFFERENT, across & ~alike)
