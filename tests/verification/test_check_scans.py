"""Edges whose images disagree are rejected; those compared before are not compared again."""

import numpy as np

from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.verification.gating import check_scans


class Disagreeing:
    """A photometric check in which all views disagree; it keeps which pairs it was asked for."""

    outline, step_m = (np.zeros(20, bool),) * 4, np.zeros(4)

    def __init__(self):
        self.asked = []

    def votes(self, pairs, T_j_i):
        self.asked += [tuple(pair) for pair in pairs.tolist()]
        return np.tile([0, 300], (len(pairs), 1))


def chain():
    same = np.repeat(np.arange(20)[:, None], 2, axis=1)
    return EdgeTable.of(
        [Edge(k, k + 1, same, np.ones(20, bool), np.eye(4), verdict=Verdict.VERIFIED) for k in range(3)]
    )


def test_edges_compared_before_are_not_compared_again():
    check = Disagreeing()
    judged = check_scans(chain(), check, 0.5, np.array([True, False, True]))
    assert check.asked == [(1, 2)]
    assert judged.verified.tolist() == [True, False, True]
    assert judged.edges()[1].rejection == Rejection.LOOKS_DIFFERENT
    assert not check_scans(chain(), Disagreeing(), 0.5).verified.any()
