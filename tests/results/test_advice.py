"""What is advised goes by the frames that were matched."""

from pathlib import Path

import numpy as np
import pytest

from miniloop_cli.results.advice import advice
from miniloop_cli.results.columns import RunColumns, edge_columns, frame_columns


def run(frames, matched, edges):
    """A good run of which so many frames were matched, and the others followed between them."""
    every = frames // matched
    rows = [
        {"registered": "1", "component": "0", "keypoints": "500" if k % every == 0 else "", "median_depth_m": ""}
        for k in range(frames)
    ]
    ends = [{"i": "0", "j": str(k + 1), "rot_residual_deg": "0.1", "trans_residual_m": "0.01"} for k in range(edges)]
    columns = edge_columns(ends, Path()), frame_columns(rows, Path(), np.arange(float(frames)))
    return RunColumns(*columns)


@pytest.mark.parametrize(
    ("matched", "edges", "few"), [(100, 60, True), (100, 200, False), (20, 60, False), (20, 39, True)]
)
def test_edges_are_few_by_the_frames_that_were_matched(matched, edges, few):
    words = advice(run(100, matched, edges), good=True, loose=False)
    assert any("Few edges" in word for word in words) == few
