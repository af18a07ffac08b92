from dataclasses import replace

import numpy as np
import pytest
from refinement_scenes import CAMERA, errors, perturbed, scene, tangent
from scipy.optimize import least_squares

from miniloop_cli.geometry.se3 import exp_so3, inverse, pose, transform
from miniloop_cli.refinement.block_system import SMALL
from miniloop_cli.refinement.bundle import BundleSettings, bundle_adjust

FIXED = BundleSettings(fixed_frame=0)
TIGHT = BundleSettings(fixed_frame=0, relative_tolerance=1e-15, max_iterations=400)


def rng_of(seed):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("kernel", ["none", "cauchy", "geman-mcclure"])
def test_exact_observations_recover_the_truth(kernel):
    rng = rng_of(0)
    S = scene(rng, no_depth=0.3)
    start = perturbed(S.T, rng, 0.5, 0.02)
    start[0] = S.T[0]
    settings = BundleSettings(fixed_frame=0, kernel=kernel, scale_px=20, scale_depth=20, max_iterations=100)
    found = bundle_adjust(start, *S.observations, CAMERA, settings)
    np.testing.assert_allclose(found.T_world_cam, S.T, atol=1e-6)
    seen = np.unique(S.track[found.used])
    assert len(seen) > 80
    np.testing.assert_allclose(found.points_world[seen], S.points[seen], atol=1e-5)
    assert np.isnan(found.points_world[np.setdiff1d(np.arange(len(found.points_world)), seen)]).all()


@pytest.mark.parametrize("scale", [0.05, 1.0, 1e3])
@pytest.mark.parametrize("offset", [0.0, 1e4])
@pytest.mark.parametrize("dtype", [float, np.float32])
def test_centimetres_to_kilometres_far_from_the_origin_and_in_single_precision(scale, offset, dtype):
    """Exact observations; in single precision a pixel has four digits behind the point, and poses those of 10 km."""
    rng = rng_of(3)
    S = scene(rng, no_depth=0.2)
    start = perturbed(S.T, rng, 0.5, 0.02)
    start[0] = S.T[0]
    true = S.T.copy()
    for T in (start, true):
        T[:, :3, 3] = scale * T[:, :3, 3] + offset
    px, z = S.px.astype(dtype), (scale * S.z).astype(dtype)
    settings = BundleSettings(fixed_frame=0, relative_tolerance=1e-12, max_iterations=100)
    model = CAMERA.noise
    noise = replace(model, a_m=scale * model.a_m, b_per_m=model.b_per_m / scale, z0_m=scale * model.z0_m)
    found = bundle_adjust(start, S.frame, S.track, px, z, replace(CAMERA, noise=noise), settings)
    digits = (1e-5 if dtype is float else 1e-3) * scale + 1e-11 * offset
    np.testing.assert_allclose(found.T_world_cam[:, :3, 3], true[:, :3, 3], atol=digits)
    np.testing.assert_allclose(found.T_world_cam[:, :3, :3], true[:, :3, :3], atol=1e-6 if dtype is float else 1e-4)


def test_points_of_an_earlier_adjustment_shorten_the_next():
    rng = rng_of(5)
    S = scene(rng, sigma_px=1, depth_sigmas=2, no_depth=0.2, outliers=0.05, offset=100.0)
    first = bundle_adjust(perturbed(S.T, rng, 0.3, 0.01), *S.observations, CAMERA, FIXED)
    fresh = bundle_adjust(first.T_world_cam, *S.observations, CAMERA, FIXED)
    known = first.points_world.copy()
    known[::7] = np.nan  # are found from the measurements
    warm = bundle_adjust(first.T_world_cam, *S.observations, CAMERA, FIXED, points_world=known)
    same = bundle_adjust(first.T_world_cam, *S.observations, CAMERA, FIXED, points_world=first.points_world)
    assert same.descent.iterations < fresh.descent.iterations
    assert same.descent.cost_before == pytest.approx(first.descent.cost_after, rel=1e-9)
    for found in (warm, same):
        np.testing.assert_allclose(found.T_world_cam, fresh.T_world_cam, atol=2e-4)
        assert np.array_equal(found.used, fresh.used)


@pytest.mark.parametrize("kernel", ["none", "cauchy", "geman-mcclure"])
def test_same_minimum_as_scipy(kernel):
    rng = rng_of(1)
    S = scene(rng, n=3, points=40, seen=0.95, sigma_px=1, depth_sigmas=2, no_depth=0.2, outliers=0.04)
    settings = BundleSettings(fixed_frame=0, kernel=kernel, relative_tolerance=1e-15, max_iterations=500)
    found = bundle_adjust(perturbed(S.T, rng, 0.3, 0.01), *S.observations, CAMERA, settings)
    u = found.used
    frame, px, z = S.frame[u], S.px[u], S.z[u]
    names, point = np.unique(S.track[u], return_inverse=True)
    sigma = 4 * CAMERA.noise.sigma_m(z)
    start = np.concatenate([np.zeros(12), found.points_world[names].ravel()])

    def robust(r):  # smooth: each residual times the root of rho(s) / s
        s = np.maximum((r**2).sum(axis=1, keepdims=True), 1e-300)
        rho = {"none": s, "cauchy": 4 * np.log1p(s / 4), "geman-mcclure": s * 4 / (4 + s)}[kernel]
        return (r * np.sqrt(rho / s)).ravel()

    def residuals(v):
        T = found.T_world_cam.copy()
        xi = v[:12].reshape(2, 6)
        T[1:] = T[1:] @ pose(exp_so3(xi[:, :3]), xi[:, 3:])
        X = v[12:].reshape(-1, 3)[point]
        x = np.einsum("kji,kj->ki", T[frame, :3, :3], X - T[frame, :3, 3])
        depth = ((x[:, 2] - z) / sigma)[np.isfinite(z)]
        return np.concatenate([robust(CAMERA.project(x) - px), robust(depth[:, None])])

    assert 0.5 * (residuals(start) ** 2).sum() == pytest.approx(found.descent.cost_after, rel=1e-10)
    nudged = start + 1e-4 * rng.standard_normal(len(start))
    oracle = least_squares(residuals, nudged, xtol=1e-12, ftol=1e-12, gtol=1e-12, x_scale="jac", max_nfev=200)
    assert found.descent.cost_after == pytest.approx(oracle.cost, rel=1e-7)
    assert np.abs(oracle.x[:12]).max() < 1e-4


def test_reported_residuals_and_weights():
    rng = rng_of(2)
    S = scene(rng, sigma_px=1, depth_sigmas=4, no_depth=0.2, outliers=0.02)
    found = bundle_adjust(S.T, *S.observations, CAMERA, BundleSettings(fixed_frame=0, sigma_px=2.0))
    u = found.used
    T = found.T_world_cam[S.frame[u]]
    x = np.einsum("kji,kj->ki", T[:, :3, :3], found.points_world[S.track[u]] - T[:, :3, 3])
    np.testing.assert_allclose(found.residual_px[u], (CAMERA.project(x) - S.px[u]) / 2, atol=1e-7)
    expected = (x[:, 2] - S.z[u]) / (4 * CAMERA.noise.sigma_m(S.z[u]))
    np.testing.assert_allclose(found.residual_depth[u], expected, atol=1e-7)
    np.testing.assert_allclose(found.weight_px[u], 1 / (1 + (found.residual_px[u] ** 2).sum(axis=1) / 4))
    deep = u & np.isfinite(S.z)
    np.testing.assert_allclose(found.weight_depth[deep], 1 / (1 + found.residual_depth[deep] ** 2 / 4))
    assert not found.weight_depth[~deep].any()
    assert np.isnan(found.residual_px[~u]).all()


def test_outliers_do_no_harm():
    rng = rng_of(3)
    S = scene(rng, points=300, sigma_px=1, depth_sigmas=1, outliers=0.1)
    start = perturbed(S.T, rng, 0.5, 0.02)
    robust, plain = (
        bundle_adjust(start, *S.observations, CAMERA, BundleSettings(fixed_frame=0, kernel=k))
        for k in ("cauchy", "none")
    )
    rms = [np.sqrt((errors(S.T, r.T_world_cam, 0)[:, 3:] ** 2).mean()) for r in (robust, plain)]
    assert rms[0] < 0.003
    assert rms[1] > 5 * rms[0]


def test_order_names_and_jobs_do_not_matter():
    rng = rng_of(4)
    S = scene(rng, sigma_px=1, depth_sigmas=1)
    start = perturbed(S.T, rng, 0.5, 0.02)
    first = bundle_adjust(start, *S.observations, CAMERA, FIXED)
    two = bundle_adjust(start, *S.observations, CAMERA, FIXED, jobs=2)
    np.testing.assert_array_equal(two.T_world_cam, first.T_world_cam)
    np.testing.assert_array_equal(two.covariance, first.covariance)
    np.testing.assert_array_equal(two.points_world, first.points_world)
    shuffle = rng.permutation(len(S.frame))
    mixed = bundle_adjust(start, *(a[shuffle] for a in S.observations), CAMERA, FIXED)
    np.testing.assert_array_equal(mixed.T_world_cam, first.T_world_cam)
    np.testing.assert_array_equal(mixed.residual_px, first.residual_px[shuffle])
    renamed = bundle_adjust(start, S.frame, 1000 - S.track, S.px, S.z, CAMERA, FIXED)
    np.testing.assert_allclose(renamed.T_world_cam, first.T_world_cam, atol=1e-9)


def test_gauge_does_not_matter():
    rng = rng_of(5)
    S = scene(rng, sigma_px=1, depth_sigmas=1)
    start = perturbed(S.T, rng, 0.5, 0.02)
    first = bundle_adjust(start, *S.observations, CAMERA, TIGHT)
    np.testing.assert_allclose(first.T_world_cam[0], start[0], atol=1e-12)
    G = pose(exp_so3(np.array([0.4, -1.2, 2.0])), np.array([1e4, -1e4, 500.0]))
    moved = bundle_adjust(G @ start, *S.observations, CAMERA, TIGHT)
    np.testing.assert_allclose(moved.T_world_cam, G @ first.T_world_cam, atol=1e-6)
    np.testing.assert_allclose(moved.points_world, transform(G, first.points_world), atol=1e-5)
    np.testing.assert_allclose(moved.covariance, first.covariance, rtol=1e-3, atol=1e-12)
    other = bundle_adjust(start, *S.observations, CAMERA, BundleSettings(**(vars(TIGHT) | {"fixed_frame": 5})))
    relative = [inverse(r.T_world_cam[:-1]) @ r.T_world_cam[1:] for r in (first, other)]
    np.testing.assert_allclose(relative[0], relative[1], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "points", "seen", "kernel", "factor", "outliers"),
    [
        (8, 200, 0.6, "none", 1, 0.0),
        (8, 200, 0.6, "cauchy", 1, 0.0),
        (8, 400, 0.6, "cauchy", 4, 0.03),  # the defaults: depth noise assumed four times what it is
    ],
)
def test_covariances_are_those_of_the_errors(n, points, seen, kernel, factor, outliers):
    """Of independent errors, too, where the jackknife says a little too much (Efron & Stein 1981)."""
    inside, squares = [], []
    settings = BundleSettings(fixed_frame=0, kernel=kernel, depth_sigma_factor=factor)
    for seed in range(40):
        rng = rng_of([6, seed])
        S = scene(rng, n, points, seen, sigma_px=0.7, depth_sigmas=1, no_depth=0.1, outliers=outliers)
        found = bundle_adjust(perturbed(S.T, rng, 0.3, 0.01), *S.observations, CAMERA, settings)
        xi, C = errors(S.T, found.T_world_cam, 0)[1:], found.covariance[1:]
        inside.append(np.abs(xi) < 2 * np.sqrt(np.einsum("nii->ni", C)))
        squares.append(np.einsum("ni,nij,nj->n", xi, np.linalg.inv(C), xi) / 6)
    assert 0.95 < np.mean(inside) < 0.99
    assert 0.6 < np.mean(squares) < 1.1


def test_pieces_do_not_disturb_each_other():
    """One piece is solved densely; as many as these together are not."""
    rng = rng_of(7)
    S = scene(rng, n=20, points=300, seen=0.3, sigma_px=1, depth_sigmas=1)
    start = perturbed(S.T, rng, 0.5, 0.02)
    alone = bundle_adjust(start, *S.observations, CAMERA, FIXED)
    pieces = SMALL // 20 + 1
    piece = np.repeat(np.arange(pieces), len(S.frame))
    frame, track, px, z = (np.concatenate([a] * pieces) for a in S.observations)
    T = np.tile(start, (pieces, 1, 1))
    all_of_them = bundle_adjust(T, frame + 20 * piece, track + 300 * piece, px, z, CAMERA, FIXED)
    for one in np.split(all_of_them.T_world_cam, pieces):
        np.testing.assert_allclose(one, alone.T_world_cam, atol=1e-8)
    np.testing.assert_allclose(all_of_them.covariance[:20], alone.covariance, rtol=1e-3, atol=1e-10)


def test_held_frames_stay_and_the_others_find_their_places():
    """As if the held poses were known: with noise, the free ones are nearer to the truth than what they promise."""
    rng = np.random.default_rng(3)
    S = scene(rng, n=8, points=200, sigma_px=0.5, depth_sigmas=1.0)
    held = np.arange(8) < 5
    start = np.where(held[:, None, None], S.T, perturbed(S.T, rng, 0.5, 0.02))
    found = bundle_adjust(start, *S.observations, CAMERA, BundleSettings(), held=held)
    assert np.abs(found.T_world_cam[held] - S.T[held]).max() < 1e-13
    assert held[found.fixed_frame] and not found.covariance[held].any()
    off = tangent(inverse(found.T_world_cam[~held]) @ S.T[~held])
    assert np.abs(off).max() < 0.005
    chi2 = np.einsum("ki,ki->k", off, np.linalg.solve(found.covariance[~held], off[..., None])[..., 0])
    assert (chi2 < 25).all()


def test_frames_that_nothing_ties_stay():
    rng = rng_of(8)
    S = scene(rng, n=9, points=200, sigma_px=1, depth_sigmas=1)
    # Frames 0-3 and 4-7 share no track; frame 8 sees nothing.
    keep = (S.frame < 8) & ((S.frame < 4) == (S.track % 2 == 0))
    start = perturbed(S.T, rng, 0.5, 0.02)
    observations = [a[keep] for a in S.observations]
    found = bundle_adjust(start, *observations, CAMERA, BundleSettings(fixed_frame=1))
    for kept in (1, 4, 8):
        np.testing.assert_allclose(found.T_world_cam[kept], start[kept], atol=1e-12)
    assert np.isfinite(found.covariance[:4]).all()
    assert np.isinf(np.einsum("nii->ni", found.covariance[4:])).all()
    assert np.abs(errors(S.T[:4], found.T_world_cam[:4], 1)).max() < 0.02
    assert np.abs(errors(S.T[4:8], found.T_world_cam[4:8], 0)).max() < 0.02


def test_tracks_without_depth_are_triangulated():
    rng = rng_of(9)
    S = scene(rng, n=5, points=150)
    S.z[S.track % 3 > 0] = np.nan
    start = perturbed(S.T, rng, 0.2, 0.005)
    found = bundle_adjust(start, *S.observations, CAMERA, TIGHT)
    assert np.abs(errors(S.T, found.T_world_cam, 0)).max() < 1e-4
    assert found.used[S.track % 3 > 0].mean() > 0.5
    # The rays of a camera that does not move never open.
    still = np.tile(np.eye(4), (2, 1, 1))
    flat = bundle_adjust(still, [0, 1], [0, 0], [[100.0, 100], [100, 100]], [np.nan, np.nan], CAMERA)
    assert not flat.used.any()


def test_points_behind_the_camera_do_not_break_it():
    rng = rng_of(10)
    S = scene(rng, n=4, points=100)
    start = S.T.copy()
    start[2] = start[2] @ pose(exp_so3(np.array([0.0, 3.0, 0.0])), np.zeros(3))  # looks the other way
    found = bundle_adjust(start, *S.observations, CAMERA, FIXED)
    assert np.isfinite(found.T_world_cam).all()
    assert found.descent.cost_after <= found.descent.cost_before
    assert np.abs(errors(S.T, found.T_world_cam, 0)[[1, 3]]).max() < 0.02


def test_a_camera_that_sees_nothing_before_it_stays_and_says_that_it_is_unknown():
    """Every depth below 2 cm: nothing of it can be projected, and a pose without evidence is no pose."""
    rng = rng_of(3)
    S = scene(rng)
    start = S.T.copy()
    start[:, :3, 3] *= 1e-3
    found = bundle_adjust(start, S.frame, S.track, S.px, 1e-3 * S.z, CAMERA, FIXED)
    np.testing.assert_allclose(found.T_world_cam, start, rtol=0, atol=1e-14)
    assert (found.weight_px == 0).all()
    assert np.isinf(found.covariance[1:, range(6), range(6)]).all()


def test_nothing_observed():
    T = np.tile(np.eye(4), (3, 1, 1))
    found = bundle_adjust(T, [], [], np.zeros((0, 2)), [], CAMERA)
    np.testing.assert_array_equal(found.T_world_cam, T)
    assert found.points_world.shape == (0, 3)
    assert found.descent.converged


@pytest.mark.parametrize(
    "change",
    [
        {"T_world_cam": np.full((2, 4, 4), np.nan)},
        {"T_world_cam": np.eye(4)},
        {"frame": [0, 2]},
        {"frame": [0, 0]},
        {"track": [0, -1]},
        {"track": [0]},
        {"px_ideal": [[1, 2], [3, np.nan]]},
        {"z_m": [1.0, 0.0]},
        {"z_m": [1.0, -1.0]},
        {"z_m": [1.0, np.inf]},
        {"settings": BundleSettings(fixed_frame=2)},
    ],
)
def test_refuses_what_are_no_observations(change):
    given = {
        "T_world_cam": np.tile(np.eye(4), (2, 1, 1)),
        "frame": [0, 1],
        "track": [0, 0],
        "px_ideal": [[100.0, 100], [101, 100]],
        "z_m": [1.0, 1.0],
        "camera": CAMERA,
    }
    assert bundle_adjust(**given).used.all()
    with pytest.raises(ValueError, match=r"frame|poses|pixels|depths|track"):
        bundle_adjust(**(given | change))


@pytest.mark.parametrize("seed", range(3))
def test_steps_by_the_kernels_curvature_come_nearer_than_those_by_their_weights(seed):
    rng = rng_of(seed)
    S = scene(rng, points=300, sigma_px=1, depth_sigmas=3, no_depth=0.2, outliers=0.05)
    start = perturbed(S.T, rng, 0.02, 0.001)

    def cost_after(iterations, least_curvature=0.25):
        settings = replace(
            TIGHT, scale_px=1.5, scale_depth=1.0, max_iterations=iterations, covariance=False,
            least_curvature=least_curvature,
        )  # fmt: skip
        return bundle_adjust(start, *S.observations, CAMERA, settings).descent.cost_after

    counts = (3, 5, 7)
    found = [cost_after(count) for count in counts]
    reweighted = [cost_after(count, least_curvature=1.0) for count in counts]
    least = cost_after(200)
    assert np.all(np.array(found) < reweighted)
    assert found[-1] - least < 0.5 * (reweighted[-1] - least)
