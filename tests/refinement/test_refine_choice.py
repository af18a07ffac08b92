"""Which refinement a recording gets: bundle adjustment, or beyond a size the pose graph."""

import logging

import numpy as np
import pytest

from miniloop_cli.presets import load_settings
from miniloop_cli.refinement import joint as module
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import VERIFIED, Edge
from miniloop_cli.scene.poses import Poses


@pytest.mark.parametrize(("most", "expected"), [(3, "bundle"), (2, "pose graph")])
def test_beyond_a_size_the_pose_graph_is_refined_and_the_log_says_so(most, expected, monkeypatch, caplog):
    monkeypatch.setattr(module, "_bundle", lambda *_: "bundle")
    monkeypatch.setattr(module, "_over_edges", lambda *_: "pose graph")
    matches = np.zeros((20, 2), np.int64)
    edges = [Edge(i, i + 1, matches, np.ones(20, bool), verdict=VERIFIED) for i in range(2)]
    poses = Poses(np.tile(np.eye(4), (3, 1, 1)), np.zeros(3, np.int64))
    scans = module.Scans([None] * 3, [None] * 3, np.arange(3.0), np.arange(3.0), None)
    settings = load_settings("default", (f"bundle.max_scans={most}",))
    with caplog.at_level(logging.WARNING, logger="miniloop"):
        assert module.refine(poses, edges, scans, settings, Workers(1)) == expected
    assert ("bundle.max_scans" in caplog.text) == (expected == "pose graph")
