"""Keyframes that only followed motion ties to the others make a result doubtful."""

from pathlib import Path

import numpy as np
import pytest

from miniloop_cli.results.assessment import Level, judge
from miniloop_cli.results.columns import RunColumns, edge_columns, frame_columns

N = 40


def judged(solvers):
    """A chain of N keyframes, edge k from k to k + 1 of this solver."""
    edges = [
        {"i": str(k), "j": str(k + 1), "matches": "60", "inliers": "50", "solver": solver, "verdict": "verified"}
        | {"rot_residual_deg": "0.1", "trans_residual_m": "0.001"}
        for k, solver in enumerate(solvers)
    ]
    frames = [{"registered": "1", "component": "0", "status": "registered"} for _ in range(N)]
    path = Path("of this run")
    return judge(RunColumns(edge_columns(edges, path), frame_columns(frames, path, np.arange(N) / 30)))


@pytest.mark.parametrize(("followed", "carried"), [(range(N - 1), N - 1), (range(20, N - 1), 19), ([9], 10)])
def test_what_followed_motion_alone_carries_is_doubted(followed, carried):
    found = judged(["followed" if k in set(followed) else "cycle5" for k in range(N - 1)])
    assert found.level == Level.DOUBTFUL
    assert any(reason.startswith(f"{carried} keyframes are joined to the others") for reason in found.reasons)


@pytest.mark.parametrize("followed", [[], [N - 2]])
def test_a_single_frame_at_the_end_is_no_doubt(followed):
    found = judged(["followed" if k in followed else "cycle5" for k in range(N - 1)])
    assert found.level == Level.GOOD and found.reasons == ()
