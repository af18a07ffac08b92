"""The feature factory, on a drawn image: every detector finds, describes and finds again after a shift."""

import cv2
import numpy as np
import pytest

from miniloop_cli.feature_types import FEATURE_TYPES
from miniloop_cli.features.detect import compact, comparable, detect
from miniloop_cli.features.match import match

KINDS = tuple(FEATURE_TYPES)


@pytest.fixture(scope="module")
def picture():
    rng = np.random.default_rng(0)
    image = np.full((260, 340), 120, np.uint8)
    for _ in range(150):
        x, y, r, shade = rng.integers((0, 0, 3, 0), (340, 260, 18, 256))
        cv2.circle(image, (int(x), int(y)), int(r), int(shade), -1, cv2.LINE_AA)
    for _ in range(150):
        corners = rng.integers(0, (340, 260), (1, 2)) + rng.integers(-16, 17, (4, 2))
        cv2.fillPoly(image, [cv2.convexHull(corners.astype(np.int32))], int(rng.integers(256)), cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), 1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_features_are_found_again_in_a_shifted_image(picture, kind):
    a = detect(picture[:240, :320], kind, 300)
    b = detect(picture[5:245, 8:328], kind, 300)
    rows = match(comparable(a.descriptors, kind), comparable(b.descriptors, kind), 0.8)
    shift = a.px[rows[:, 0]] - b.px[rows[:, 1]]
    good = np.linalg.norm(shift - (8, 5), axis=1) < 2.0
    assert len(rows) > 30
    assert good.mean() > 0.9


@pytest.mark.parametrize("kind", KINDS)
def test_a_feature_is_not_taken_for_the_patch_that_describes_it(picture, kind):
    """All lay on an outline otherwise: ORB's patches reach 15 pixels, its corners 3."""
    assert 1.5 < np.median(detect(picture, kind, 300).radius_px) < 8


@pytest.mark.parametrize("first_octave", [-1, 0])
@pytest.mark.parametrize("kind", ["sift", "rootsift"])
def test_sift_lies_where_the_blob_is(kind, first_octave):
    y, x = np.mgrid[:120, :160]
    off = []
    for centre in np.random.default_rng(1).uniform((70, 50), (90, 70), (20, 2)):
        blob = 60 + 150 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 18)
        px = detect(np.rint(blob).astype(np.uint8), kind, 100, first_octave=first_octave).px
        off.append(px[np.linalg.norm(px - centre, axis=1).argmin()] - centre)
    np.testing.assert_allclose(np.mean(off, axis=0), 0, atol=0.03)


@pytest.mark.parametrize("kind", KINDS)
def test_the_strongest_come_first_and_not_too_many(picture, kind):
    found = detect(picture, kind, 50)
    assert 0 < len(found.px) <= 50
    assert np.all(np.diff(found.response) <= 0)
    again = detect(picture, kind, 50)
    assert np.array_equal(found.px, again.px)
    assert np.array_equal(found.descriptors, again.descriptors)


@pytest.mark.parametrize("kind", KINDS)
def test_a_blank_image_has_no_features(kind):
    found = detect(np.full((120, 160), 90, np.uint8), kind, 100)
    assert len(found.px) == len(found.descriptors) == len(found.response) == 0


def test_rootsift_has_unit_length(picture):
    root = comparable(detect(picture, "rootsift", 100).descriptors, "rootsift")
    assert root.dtype == np.float32
    assert np.allclose(np.linalg.norm(root, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize(("kind", "norm"), [("rootsift", 1.0), ("sift", 512.0), ("surf", 1.0)])
def test_compact_descriptors_keep_the_distances_of_their_kind(picture, kind, norm):
    found = detect(picture, kind, 60).descriptors
    real, (small, scale) = comparable(found, kind) / norm, compact(found, kind)
    exact = ((real[:, None] - real) ** 2).sum(axis=2)
    kept = ((small[:, None].astype(float) - small) ** 2).sum(axis=2) / scale
    assert small.dtype == np.uint8
    assert np.abs(kept - exact).max() < 0.05
    assert np.ptp(exact) > 0.5
