"""The best arrangement of a table of edges: proven, or taken where averaging had ended in another one."""

import numpy as np
import pytest

from miniloop_cli.averaging import optimum
from miniloop_cli.averaging.optimum import prove_optimum
from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.poses import Poses, residuals
from miniloop_cli.scene.sequence import NoteKind
from miniloop_cli.scene.verdict import Verdict

N = 40
INFORMATION = np.diag([1e5] * 3 + [1e4] * 3)


def table(T, pairs, rng):
    edges = []
    for i, j in pairs:
        T_j_i = se3.pose(se3.exp_so3(rng.normal(0, 3e-3, 3)), rng.normal(0, 1e-2, 3)) @ se3.inverse(T[j]) @ T[i]
        edges.append(Edge(i, j, np.zeros((0, 2), int), np.zeros(0, bool), T_j_i, INFORMATION, verdict=Verdict.VERIFIED))
    return EdgeTable.of(edges)


def circle(turns):
    """N cameras on a circle that look outwards, and turn about their axis `turns` times on the way."""
    angle = 2 * np.pi * np.arange(N) / N
    R = se3.exp_so3(angle[:, None] * [0.0, 1.0, 0.0]) @ se3.exp_so3(turns * angle[:, None] * [0.0, 0.0, 1.0])
    return se3.pose(R, np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1))


def ring_pairs(first=0):
    return [(first + k, first + k + 1) for k in range(N - 1)] + [(first, first + N - 1)]


def test_averaged_poses_stay_as_they_are_where_their_minimum_is_the_lowest(rng):
    T = circle(0)
    start = Poses(se3.pose(se3.exp_so3(rng.normal(0, 2e-3, (N, 3))), rng.normal(0, 5e-3, (N, 3))) @ T, np.zeros(N, int))
    poses, proven = prove_optimum(start, table(T, ring_pairs(), rng), Averaging())
    assert np.array_equal(poses.T_world_cam, start.T_world_cam)
    assert proven.certified and not proven.escaped and 0 < proven.relative_gap <= 1e-6
    assert proven.note.kind == NoteKind.PROVEN
    assert proven.sentence == "no other arrangement of these edges and weights is better by more than 0.0001 %"
    moved = proven.refined(proven.optimum)
    assert moved.moved_m < 1e-9 and moved.sentence.endswith("the refinement then moved frames by 0.0 mm (median)")


def test_a_better_minimum_is_taken(rng):
    T = circle(0)
    edges = table(T, ring_pairs(), rng)
    plain = Averaging(rotations="plain", translations="plain")
    poses, proven = prove_optimum(Poses(circle(1), np.zeros(N, int)), edges, plain)
    assert proven.certified and proven.escaped
    angle_deg, distance_m = residuals(edges, poses.T_world_cam)
    assert angle_deg.max() < 1 and distance_m.max() < 0.06


def test_every_component_is_proven_by_itself(rng):
    """The poses of the second one go round once too often, and lie far off."""
    good, far = circle(0), se3.pose(np.eye(3), np.array([50.0, 0, 0])) @ circle(0)
    edges = table(np.concatenate([good, far]), ring_pairs() + ring_pairs(N), rng)
    label = np.repeat([0, 1], N)
    wound = Poses(np.concatenate([good, circle(1)]), label)
    poses, proven = prove_optimum(wound, edges, Averaging(rotations="plain", translations="plain"))
    assert proven.certified and proven.escaped
    assert np.array_equal(poses.T_world_cam[:N], good) and residuals(edges, poses.T_world_cam)[0].max() < 1


def test_what_is_moved_by_refinement_is_told_whatever_the_world(rng):
    T = circle(0)
    _, proven = prove_optimum(Poses(T, np.zeros(N, int)), table(T, ring_pairs(), rng), Averaging())
    turned = se3.pose(se3.exp_so3(np.array([0.3, 0.2, 1.0])), np.array([1.0, 2.0, 3.0])) @ proven.optimum.T_world_cam
    turned[:, :3, 3] += 0.003 * np.where(np.arange(N) % 2, 1, -1)[:, None] * [0.0, 1.0, 0.0]
    np.testing.assert_allclose(proven.refined(Poses(turned, np.zeros(N, int))).moved_m, 0.003, rtol=0.05)


def test_graphs_too_large_are_not_called_certified(rng, monkeypatch):
    monkeypatch.setattr(optimum, "MOST_WORK", N - 1)
    T = circle(0)
    _, proven = prove_optimum(Poses(T, np.zeros(N, int)), table(T, ring_pairs(), rng), Averaging())
    assert not proven.certified and np.isnan(proven.relative_gap)
    assert proven.note.kind == NoteKind.PROVEN
    assert "the graph of 40 scans and 40 edges is too densely connected for the proof" in proven.sentence


@pytest.mark.parametrize("gap", [0.37, 0.002])
def test_what_is_not_proven_is_a_doubt_in_words(gap):
    nothing = Poses(np.zeros((0, 4, 4)), np.zeros(0, int))
    unproven = optimum.Certificate(False, gap, nothing)
    assert unproven.note.kind == NoteKind.UNPROVEN
    assert unproven.sentence.endswith(f"may be better, by up to {100 * gap:g} %")
