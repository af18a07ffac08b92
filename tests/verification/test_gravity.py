"""A known vertical: edges judged by it, sensors with axes of their own, poses found by it and fitted without it."""

import numpy as np
import pytest

from miniloop_cli.config import Gravity, Ransac, Settings
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.ransac.gravity_aligned import estimate_upright, upright_rotations
from miniloop_cli.ransac.matches import EdgeMatches
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.priors import Accelerometer, Vertical
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.verification.gravity import checked, disagreement_deg, with_gravity

SCANS = 6


def edge(i, j, T, inliers=40, verdict=Verdict.VERIFIED):
    return Edge(i, j, np.zeros((inliers, 2), int), np.ones(inliers, bool), T, np.eye(6), verdict=verdict)


def readings(up):
    """One reading a frame, once a second."""
    return Accelerometer(np.arange(float(len(up))), 9.81 * up, up, "acc.txt")


@pytest.fixture
def world(rng):
    """Poses of some scans, their verticals, and exact edges between all."""
    T = se3.pose(se3.exp_so3(rng.normal(0, 0.8, (SCANS, 3))), rng.normal(0, 1, (SCANS, 3)))
    edges = [edge(i, j, se3.inverse(T[j]) @ T[i]) for i in range(SCANS) for j in range(i + 1, SCANS)]
    return T, T[:, 2, :3], edges


def test_upright_rotations(rng):
    up = rng.normal(size=(50, 3))
    up = np.concatenate([up / np.linalg.norm(up, axis=1)[:, None], [[0, 0, 1], [0, 0, -1]]])
    R = upright_rotations(up)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", R, up), np.tile([0, 0, 1.0], (52, 1)), atol=1e-9)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (52, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1)


def test_exact_edges_agree_and_a_turned_one_does_not(world):
    _, up, edges = world
    assert disagreement_deg(EdgeTable.of(edges), up).max() < 1e-5
    across = np.cross(up[1], [1.0, 0, 0])
    turn = se3.pose(se3.exp_so3(np.radians(10) * across / np.linalg.norm(across)), np.zeros(3))
    off = disagreement_deg(EdgeTable.of([edge(0, 1, turn @ edges[0].T_j_i)]), up)
    assert off == pytest.approx(10, abs=1e-6)
    assert np.isnan(disagreement_deg(EdgeTable.of(edges[:1]), np.full((SCANS, 3), np.nan)))


@pytest.mark.parametrize(
    "axes",
    [np.eye(3), -np.eye(3), [[0, 1, 0], [0, 0, 1], [1, 0, 0]], [[0, -1, 0], [0, 0, -1], [1, 0, 0]]],
    ids=["camera", "down", "turned", "robot"],
)
def test_axes_of_a_sensor_are_found(world, axes):
    _, up, edges = world
    M = np.array(axes, float)
    found, note = checked(EdgeTable.of(edges), readings(up @ M), Gravity())
    assert note.startswith("gravity is used")
    assert "not certain" not in note
    assert disagreement_deg(EdgeTable.of(edges), found.up_cam).max() < 1e-5
    np.testing.assert_allclose(found.accelerometer.readings, 9.81 * found.up_cam)
    np.testing.assert_allclose(np.abs((found.up_cam * up).sum(axis=1)), 1)


def test_a_file_that_fits_no_axes_is_refused(world, rng):
    _, _, edges = world
    noise = rng.normal(size=(SCANS, 3))
    with pytest.raises(
        InputError, match=r"^acc\.txt: disagrees with 15 sure edges by \d+\.\d deg.* every choice of .* axes"
    ):
        checked(EdgeTable.of(edges), readings(noise / np.linalg.norm(noise, axis=1)[:, None]), Gravity())


def test_a_few_edges_cannot_check_it(world):
    _, up, edges = world
    found, note = checked(EdgeTable.of(edges[:2]), readings(up), Gravity())
    assert found is None
    assert "too few" in note


def test_axes_that_the_edges_cannot_tell_apart_are_named(rng):
    """A robot that turns about the vertical only: its sensor may as well stand on its head or lie on its side."""
    heading = rng.uniform(-2, 2, SCANS)[:, None] * [0, 0, 1.0]
    T = se3.pose(se3.exp_so3(heading) @ [[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]], rng.normal(size=(SCANS, 3)))
    edges = [edge(i, j, se3.inverse(T[j]) @ T[i]) for i in range(SCANS) for j in range(i + 1, SCANS)]
    found, note = checked(EdgeTable.of(edges), readings(T[:, 2, :3]), Gravity())
    np.testing.assert_allclose(found.up_cam, T[:, 2, :3], atol=1e-12)  # the camera's axes, as they fit
    assert "not certain: " in note


def test_edges_are_judged(world, rng):
    _, up, edges = world
    across = np.cross(up[1], [1.0, 0, 0])
    turn = se3.pose(se3.exp_so3(0.3 * across / np.linalg.norm(across)), np.zeros(3))
    T = [e.T_j_i for e in edges]
    given = [
        edge(0, 1, turn @ T[0], 40),
        edge(0, 2, T[1], 9, Verdict.WEAK),
        edge(0, 3, T[2], 6, Verdict.WEAK),
        edge(0, 4, T[3], 12),
        edge(0, 5, np.eye(4), 3, Verdict.REJECTED),
    ]
    points = [ScanPoints(rng.normal(size=(50, 3)), np.tile(1e-6 * np.eye(3), (50, 1, 1)))] * SCANS
    matches = {(e.i, e.j): e.matches for e in given}
    how = (Settings().estimation, Gravity(), 0, Workers(1))
    found = with_gravity(EdgeTable.of(given), Vertical(readings(up), 1.0), matches, points, *how)
    assert found.verdict.tolist() == [
        Verdict.REJECTED,
        Verdict.VERIFIED,
        Verdict.VERIFIED,
        Verdict.VERIFIED,
        Verdict.REJECTED,
    ]
    assert found.confirmed.tolist() == [False, True, False, True, False]
    assert found.reasons()[0] == "contradicts gravity by 17.2 deg"
    shaken = with_gravity(EdgeTable.of(given), Vertical(readings(up), 5.0), matches, points, *how)
    assert shaken.verified[0]  # from a hand that shakes so, 17 degrees say nothing


@pytest.mark.parametrize("scans", [2, 3, 4])
def test_poses_found_with_a_tilted_vertical_are_those_of_the_matches(scans, rng):
    """The vertical is a degree off; the pose is the matches' own, as the free estimate finds it."""
    world_m = rng.uniform(-2, 2, (60, 3))
    T = se3.pose(se3.exp_so3(rng.normal(0, 0.5, (scans, 3))), rng.normal(0, 0.5, (scans, 3)))
    chain = [(k, k + 1) for k in range(scans - 1)] + ([(0, scans - 1)] if scans > 2 else [])
    sigma = 0.003
    cov = np.tile(sigma**2 * np.eye(3), (60, 1, 1))

    def seen(k):
        return se3.transform(se3.inverse(T[k]), world_m) + rng.normal(0, sigma, (60, 3))

    edges = []
    for a, b in chain:
        p, q = seen(a), seen(b)
        wrong = rng.random(60) < 0.4
        q[wrong] = rng.uniform(-2, 2, (wrong.sum(), 3))
        edges.append(EdgeMatches(p, q, cov, cov))
    tilt = se3.exp_so3(rng.normal(0, np.radians(0.6), (scans, 3)))
    up = np.einsum("nij,nj->ni", tilt, T[:, 2, :3])
    found = estimate_upright(edges, up, np.radians(1.5), Ransac(), 16.0, np.random.default_rng(0))
    free = estimate(edges, Ransac(), 16.0, np.random.default_rng(0))
    for (a, b), one, other in zip(chain, found.edges, free.edges, strict=True):
        truth = se3.inverse(T[b]) @ T[a]
        np.testing.assert_allclose(one.T, truth, atol=0.01)
        np.testing.assert_allclose(one.T, other.T, atol=1e-4)
        assert (one.inliers == other.inliers).mean() > 0.95
