"""New keyframes adjusted to a map: the map's own stay where they are unless they must move, and covariances add up."""

from dataclasses import replace

import numpy as np
import pytest
from map_scenes import CAMERA, small_map, small_part, some_pose

from miniloop_cli.config import Bundle
from miniloop_cli.geometry import se3
from miniloop_cli.mapping.adjustment import (
    AT_REST,
    NEARLY_AT_REST,
    Observations,
    Settled,
    added_uncertainty,
    adjusted_locally,
    adjusted_until_rest,
    covariance_beside_the_map,
    known_points,
    moved_uncertainty,
    settled,
)
from miniloop_cli.mapping.landmarks import landmarks
from miniloop_cli.mapping.tracks import agreeing, extended_tracks, matches_of_points, without_keyframes
from miniloop_cli.refinement.bundle import BundleSettings
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.points import scan_points
from miniloop_cli.stages.keyframes import common_scans
from miniloop_cli.stages.placing import MustAdjustAll, require_map_as_it_is

SAME = np.repeat(np.arange(120)[:, None], 2, axis=1)  # every keyframe of a small part sees the same points, in order


def seven():
    """A map of four keyframes, then three more that see the same points; all exactly."""
    part = small_part(keyframes=7)
    points = small_map().joined.landmarks
    scans = common_scans([part])
    first = 120 * np.arange(8)
    pairs = [(3, 4), (2, 4), (4, 5), (3, 5), (5, 6), (4, 6)]
    return part.T_world_key, points, scans, first, extended_tracks(points, first, np.array(pairs), [SAME] * len(pairs))


def points_of(tracks, T, scans):
    """(tracks, 3) fused observations of the tracks at poses T."""
    return known_points(landmarks(scans.points, T, tracks), tracks, scans.first_feature)


def test_points_become_the_matches_that_they_were_made_of():
    points = small_map().joined.landmarks
    pairs, matches = matches_of_points(points, 120 * np.arange(5))
    assert pairs.tolist() == [[0, 1], [1, 2], [2, 3]]
    assert all(np.array_equal(rows, SAME) for rows in matches)
    none = replace(points, of_feature=np.full(480, -1))
    assert matches_of_points(none, 120 * np.arange(5))[0].shape == (0, 2)


def test_new_matches_lengthen_tracks_and_contradict_none():
    _, points, _, first, tracks = seven()
    assert tracks.count == 120 and len(tracks.track) == 7 * 120
    wrong = np.stack([np.arange(120), np.roll(np.arange(120), 1)], axis=1)
    both = extended_tracks(points, first, np.array([[0, 4], [3, 4]]), [wrong[:50], SAME])
    of = {(f, k): t for f, k, t in zip(both.frame, both.feature, both.track, strict=True)}
    assert all(of[0, k] == of[3, k] for k in range(120)), "points of the map are not torn apart"
    assert all(of[4, k] == of[3, k] for k in range(120)), "many matches are believed before few"
    assert both.dropped_matches == 50


def test_what_contradicts_a_point_leaves_its_track():
    T, _, scans, first, tracks = seven()
    features = list(scans.features)
    z = features[5].z_m.copy()
    z[7] += 0.5
    features[5] = replace(features[5], z_m=z)
    points = [scan_points(scan, CAMERA) for scan in features]
    kept = agreeing(tracks, landmarks(points, T, tracks), first)
    assert len(kept.track) == len(tracks.track) - 1 and kept.count == tracks.count
    assert not ((kept.frame == 5) & (kept.feature == 7)).any()


def test_only_what_shares_points_moves(rng):
    T, points, scans, first, tracks = seven()
    new = np.arange(7) >= 4
    off = T.copy()
    off[new] = T[new] @ np.array([some_pose(rng, 0.01, 0.01) for _ in range(3)])
    off[2] = T[2] @ some_pose(rng, 0.003, 0.003)
    seen = Observations.of(tracks, scans, 3)
    # Keyframes 0 and 1 see other points than the new ones.
    apart = seen.subset(~((seen.frame < 2) & (seen.track >= 5)) & ~((seen.frame >= 4) & (seen.track < 5)))
    found = adjusted_locally(off, apart, new, scans, Bundle(), 1)
    assert np.abs(found[:2] - off[:2]).max() < 1e-14
    assert np.abs(found - T).max() < 1e-3
    there = known_points(points, tracks, first)
    together, where = adjusted_until_rest(found, there, seen, [], 0, scans, Bundle(), 1, np.ones(7, bool), AT_REST)
    assert np.abs(there - where).max() < 1e-3
    assert np.abs(together[0] - T[0]).max() < 1e-9
    assert np.abs(together - T).max() < 1e-5


def test_a_keyframe_that_an_edge_alone_holds_is_as_uncertain_as_the_edge(rng):
    T, _, scans, _, tracks = seven()
    kept = {name: getattr(tracks, name)[tracks.frame != 6] for name in ("frame", "track", "feature")}
    edge = replace(
        small_part().edges.subset([0]), i=np.array([5]), j=np.array([6]), T_j_i=(se3.inverse(T[6]) @ T[5])[None]
    )
    fewer = replace(tracks, **kept)
    found = settled(T, points_of(fewer, T, scans), fewer, edge, np.ones(7, bool), 0, scans, Bundle(), 1)
    C = covariance_beside_the_map(found, np.arange(7) == 6, scans, Bundle(), 1)[0]
    ratio = np.trace(C) / np.trace(np.linalg.inv(edge.information[0]))
    assert 0.3 < ratio < 3


def test_keyframes_that_are_not_active_keep_their_poses(rng):
    T, _, scans, _, tracks = seven()
    off = T.copy()
    off[[2, 5]] = T[[2, 5]] @ np.array([some_pose(rng, 0.003, 0.003) for _ in range(2)])
    inside, active = np.ones(7, bool), np.arange(7) >= 4
    found = settled(
        off,
        points_of(tracks, off, scans),
        tracks,
        EdgeTable.of([]),
        inside,
        0,
        scans,
        Bundle(),
        1,
        active,
        NEARLY_AT_REST,
    )
    assert np.abs(found.T_world_cam[~active] - off[~active]).max() < 1e-9
    error_m = np.linalg.norm(found.T_world_cam[5, :3, 3] - T[5, :3, 3])
    assert error_m < np.linalg.norm(off[5, :3, 3] - T[5, :3, 3]), "held keyframes pull the active ones"


def test_a_recording_that_bends_the_map_makes_all_adjusted(rng):
    T = np.array([some_pose(rng, 1.0, 1.0) for _ in range(20)])
    moved = T * (1 + 1e-15)  # most are held, and differ by rounding
    moved[:3, 0, 3] += [0.02, 0.004, 0.004]
    require_map_as_it_is("kitchen", T, T)
    require_map_as_it_is("kitchen", T, moved)  # one weakly tied keyframe is no bend
    moved[1, 0, 3] += 0.026
    with pytest.raises(MustAdjustAll, match=r"kitchen moves what it shows of it by 2\.0 cm"):
        require_map_as_it_is("kitchen", T, moved)


def test_points_are_told_without_keyframes_that_are_matched_again():
    points, first = small_map().joined.landmarks, 120 * np.arange(8)
    rest = without_keyframes(points, np.arange(7) % 2 == 1, first)
    assert (rest.of_feature[:120] >= 0).all() and (rest.of_feature[120:240] == -1).all()
    assert len(rest.of_feature) == len(points.of_feature)


def test_a_keyframe_that_few_points_tie_is_held_by_its_edges(rng):
    T, _, scans, _, tracks = seven()
    few = (tracks.frame == 6) & (tracks.track >= 5)
    kept = {name: getattr(tracks, name)[~few] for name in ("frame", "track", "feature")}
    tracks, inside, off = replace(tracks, **kept), np.ones(7, bool), T.copy()
    off[6] = T[6] @ some_pose(rng, 0.01, 0.01)
    edge = replace(
        small_part().edges.subset([0]), i=np.array([5]), j=np.array([6]), T_j_i=(se3.inverse(T[6]) @ T[5])[None]
    )
    found = settled(off, points_of(tracks, off, scans), tracks, edge, inside, 0, scans, Bundle(), 1)
    assert np.abs(found.T_world_cam - T).max() < 1e-4
    C = covariance_beside_the_map(found, np.arange(7) >= 4, scans, Bundle(), 1)
    assert np.isfinite(C).all() and np.trace(C[2]) > 100 * np.trace(C[1]), "its points are exact, but the edge is not"
    alone = settled(off, points_of(tracks, off, scans), tracks, EdgeTable.of([]), inside, 0, scans, Bundle(), 1)
    assert np.abs(alone.T_world_cam[6] - off[6]).max() < 1e-8, "nothing tells where it is"
    assert not (alone.seen.frame == 6).any()


def test_new_keyframes_promise_what_their_errors_are():
    """Pixels and depths with noise, the map as it is: errors of the new poses against their covariances."""
    T, _, scans, _, tracks = seven()
    new, chi2 = np.arange(7) >= 4, []
    exact = Observations.of(tracks, scans, 3)
    for seed in range(12):
        rng = np.random.default_rng(seed)
        z = exact.z_m + CAMERA.noise.sigma_m(exact.z_m) * rng.normal(size=len(exact.z_m))
        px = exact.px_ideal + 0.3 * rng.normal(size=exact.px_ideal.shape)
        seen = replace(exact, px_ideal=px, z_m=np.where(new[exact.frame], z, exact.z_m))
        settings = BundleSettings(relative_tolerance=1e-6)
        found = seen.adjusted(T, scans, settings, 1, ~new, None)
        T_new = found.T_world_cam
        at_rest = Settled(T_new, found.points_world, seen, [])
        C = covariance_beside_the_map(at_rest, new, scans, Bundle(), 1)
        E = se3.inverse(T_new[new]) @ T[new]
        xi = np.concatenate([se3.log_so3(E[:, :3, :3]), E[:, :3, 3]], axis=1)
        chi2 += np.einsum("ki,ki->k", xi, np.linalg.solve(C, xi[..., None])[..., 0]).tolist()
    assert 2 < np.median(chi2) < 14  # of 6 degrees of freedom, by a jackknife of few parts


def test_uncertainty_of_a_neighbour_is_carried_to_a_new_keyframe(rng):
    """Against drawn errors: the new keyframe moves with its neighbour, exactly."""
    A, B, L = some_pose(rng), some_pose(rng), 0.01 * rng.normal(size=(6, 6))
    C = L @ L.T
    drawn = np.linalg.cholesky(C + 1e-12 * np.eye(6)) @ rng.normal(size=(6, 20000))
    moved = A @ se3.pose(se3.exp_so3(drawn[:3].T), drawn[3:].T)
    E = se3.inverse(B) @ moved @ se3.inverse(A) @ B
    xi = np.concatenate([se3.log_so3(E[:, :3, :3]), E[:, :3, 3]], axis=1)
    promised = added_uncertainty(B[None], C, A)[0]
    assert np.allclose(np.cov(xi.T), promised, atol=0.05 * np.abs(promised).max())


def test_a_keyframe_is_as_uncertain_as_new_evidence_moves_it(rng):
    before = se3.pose(se3.exp_so3(rng.standard_normal((5, 3))), rng.standard_normal((5, 3)))
    motion = rng.standard_normal((5, 6)) * [0.01, 0.01, 0.01, 0.05, 0.05, 0.05]
    after = before @ se3.pose(se3.exp_so3(motion[:, :3]), motion[:, 3:])
    A = 0.01 * rng.standard_normal((5, 6, 6))
    covariance = A @ A.transpose(0, 2, 1) + 1e-8 * np.eye(6)
    grown = covariance + moved_uncertainty(before, after)
    sigmas2 = np.einsum("ki,kij,kj->k", motion, np.linalg.inv(grown), motion)
    assert (sigmas2 < 1).all()
    assert moved_uncertainty(before, before).max() < 1e-25
    np.testing.assert_allclose(np.trace(grown - covariance, axis1=1, axis2=2), (motion**2).sum(axis=1), rtol=1e-6)
