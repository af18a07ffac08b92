"""Covariances by parts of the image: against fits without them, with errors in common, and where there is but one."""

from dataclasses import replace

import numpy as np
import pytest
from refinement_scenes import CAMERA, errors, perturbed, scene

from miniloop_cli.refinement.bundle import BundleSettings, bundle_adjust
from miniloop_cli.refinement.jackknife import PARTS, image_part, remaining_fraction

PLAIN = BundleSettings(fixed_frame=0, kernel="none", relative_tolerance=1e-12, max_iterations=100)


def test_parts_of_the_image():
    px = np.array([[0.0, 0], [639, 0], [320, 240], [0, 479], [639, 479], [-30, 700], [213, 159], [214, 161]])
    np.testing.assert_array_equal(image_part(px, CAMERA), [0, 2, 4, 6, 8, 6, 0, 4])
    left = remaining_fraction(np.array([0, 0, 0, 8]))
    assert left.shape == (PARTS,)
    np.testing.assert_allclose(left, [0.25, 1, 1, 1, 1, 1, 1, 1, 0.75])
    np.testing.assert_array_equal(remaining_fraction(np.zeros(0, int)), np.ones(PARTS))


def test_variances_are_those_of_fits_without_each_part():
    """The Newton step stands for a whole adjustment without the part."""
    rng = np.random.default_rng(21)
    S = scene(rng, 6, 400, 0.6, sigma_px=0.5, depth_sigmas=1, no_depth=0.2)
    found = bundle_adjust(perturbed(S.T, rng, 0.2, 0.01), *S.observations, CAMERA, PLAIN)
    part = image_part(S.px, CAMERA)
    variance = np.zeros((6, 6))
    for number, left in enumerate(remaining_fraction(part)):
        kept = part != number
        without = bundle_adjust(
            found.T_world_cam, *(a[kept] for a in S.observations), CAMERA, replace(PLAIN, covariance=False)
        )
        variance += left * errors(found.T_world_cam, without.T_world_cam, 0) ** 2
    np.testing.assert_allclose(np.einsum("nii->ni", found.covariance), variance, rtol=0.1, atol=1e-12)
    for C in found.covariance[1:]:
        assert np.linalg.eigvalsh(C).min() > 0


@pytest.mark.slow
def test_errors_that_parts_of_the_image_have_in_common_are_in_the_covariances():
    """A lens that no model fits: half a pixel off, elsewhere in another direction."""
    inside = []
    for seed in range(20):
        rng = np.random.default_rng([22, seed])
        S = scene(rng, 8, 300, 0.6, sigma_px=0.1, depth_sigmas=0.2)
        S.px[:] += 0.5 * rng.standard_normal((PARTS, 2))[image_part(S.px, CAMERA)]
        found = bundle_adjust(perturbed(S.T, rng, 0.2, 0.01), *S.observations, CAMERA, replace(PLAIN, kernel="cauchy"))
        xi, C = errors(S.T, found.T_world_cam, 0)[1:], found.covariance[1:]
        inside.append(np.abs(xi) < 2 * np.sqrt(np.einsum("nii->ni", C)))
    assert 0.85 < np.mean(inside) < 0.995


def test_a_frame_that_sees_all_in_one_part_of_the_image_is_not_known():
    rng = np.random.default_rng(23)
    S = scene(rng, 6, 300, sigma_px=0.5, depth_sigmas=1)
    kept = (S.frame != 3) | (image_part(S.px, CAMERA) == 4)
    found = bundle_adjust(S.T, *(a[kept] for a in S.observations), CAMERA, PLAIN)
    assert np.isinf(np.diag(found.covariance[3])).all()
    assert np.isfinite(np.delete(found.covariance, 3, axis=0)).all()
    assert not found.covariance[0].any()


def test_a_frame_whose_partners_see_all_in_one_part_of_the_image_is_not_known():
    """Without that part nobody else sees its points: what is left of it is rounding."""
    rng = np.random.default_rng(24)
    S = scene(rng, 6, 400, sigma_px=0.5, depth_sigmas=1)
    part = image_part(S.px, CAMERA)
    own = S.track % 3 == 0  # frame 3 sees these only; of the others, frame 2 does, in the middle
    kept = np.where(S.frame == 3, own, ~own | ((S.frame == 2) & (part == 4)))
    found = bundle_adjust(S.T, *(a[kept] for a in S.observations), CAMERA, PLAIN)
    assert np.isinf(np.diag(found.covariance[3])).all()
    assert np.isfinite(np.delete(found.covariance, 3, axis=0)).all()


def test_frames_that_one_part_of_the_image_ties_to_the_others_are_not_known():
    """They know of each other, but what ties them to the rest is seen in the middle only."""
    rng = np.random.default_rng(25)
    S = scene(rng, 8, 600, sigma_px=0.5, depth_sigmas=1)
    middle, late = image_part(S.px, CAMERA) == 4, S.frame >= 5
    of_late = S.track % 2 == 0  # frames 5 to 7 see these; of the others, frame 2 does, in the middle
    kept = np.where(late, of_late, ~of_late | ((S.frame == 2) & middle))
    found = bundle_adjust(S.T, *(a[kept] for a in S.observations), CAMERA, PLAIN)
    assert np.isinf(np.einsum("nii->ni", found.covariance[5:])).all()
    assert np.isfinite(found.covariance[:5]).all()
