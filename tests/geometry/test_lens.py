"""Lenses against OpenCV's, there and back, and what is refused because it folds over within the image."""

import re

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from miniloop_cli.datasets.intrinsics import freiburg_camera
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import PINHOLE, fisheye_lens, radial_tangential_lens
from miniloop_cli.geometry.monotone import first_root, invert_increasing
from miniloop_cli.runtime.artifact_store import fingerprint

AZURE = (0.722746, -2.88559, 0.000783, -0.000143, 1.632723, 0.602199, -2.719626, 1.565053)  # a colour camera of 1920
RADIAL = {
    "4": (-0.28, 0.07, 9e-4, -2e-4),
    "5": (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    "8": AZURE,
    "barrel": (-0.3, 0.09, 0.0, 0.0, -0.01),
}
FISHEYE = {
    "equidistant": (0.0, 0.0, 0.0, 0.0),
    "calibrated": (0.0304, 0.0061, 0.0004, 0.0001),
    "wide": (-0.03, 0, 0, 0),
}


def camera(lens, f=480.0):
    return Camera(f, f + 3, 322.5, 236.25, 640, 480, lens=lens)


def pixels():
    u, v = np.meshgrid(np.linspace(0, 639, 17), np.linspace(0, 479, 13))
    return np.stack([u.ravel(), v.ravel()], axis=1)


@pytest.mark.parametrize("coefficients", RADIAL.values(), ids=RADIAL)
def test_radial_tangential_is_opencvs(coefficients):
    c = camera(radial_tangential_lens(*coefficients))
    ideal = c.undistort(pixels())
    rays = np.column_stack([(ideal - [c.cx, c.cy]) / [c.fx, c.fy], np.ones(len(ideal))])
    projected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), c.K, np.array(coefficients))
    np.testing.assert_allclose(projected[:, 0], pixels(), atol=1e-8)
    np.testing.assert_allclose(c.distort(ideal), pixels(), atol=1e-8)
    until = (cv2.TERM_CRITERIA_COUNT, 200, 0)
    oracle = cv2.undistortImagePoints(pixels(), c.K, np.array(coefficients), arg1=until)
    np.testing.assert_allclose(ideal, oracle[:, 0], atol=1e-7)


@pytest.mark.parametrize("coefficients", FISHEYE.values(), ids=FISHEYE)
def test_fisheye_is_opencvs(coefficients):
    c, k = camera(fisheye_lens(*coefficients), f=400.0), np.array(coefficients)
    ideal = c.undistort(pixels())
    oracle = cv2.fisheye.undistortPoints(pixels()[:, None], c.K, k, P=c.K)[:, 0]
    np.testing.assert_allclose(ideal, oracle, atol=1e-6)
    xy = (ideal - [c.cx, c.cy]) / [c.fx, c.fy]
    np.testing.assert_allclose(cv2.fisheye.distortPoints(xy[:, None], c.K, k)[:, 0], pixels(), atol=1e-8)
    np.testing.assert_allclose(c.distort(ideal), pixels(), atol=1e-8)


@pytest.mark.parametrize("family", ["1", "2"])
def test_the_benchmarks_cameras_are_undistorted_as_ever(family):
    """To the bit what OpenCV's 40 steps give: results of recordings do not change."""
    c = freiburg_camera(family, "")
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
    oracle = cv2.undistortImagePoints(pixels(), c.K, np.array(c.lens.coefficients), arg1=until)
    assert np.array_equal(c.undistort(pixels()), oracle[:, 0])


def test_strong_lenses_are_undone_where_opencvs_steps_do_not_arrive():
    c = camera(radial_tangential_lens(-0.3, 0.05, 0.01, -0.01))
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
    oracle = cv2.undistortImagePoints(pixels(), c.K, np.array(c.lens.coefficients), arg1=until)[:, 0]
    assert not np.abs(c.distort(oracle) - pixels()).max() < 0.01
    assert c.lens_fault() is None
    np.testing.assert_allclose(c.distort(c.undistort(pixels())), pixels(), atol=1e-6)


small, tiny = st.floats(-0.5, 0.5), st.floats(-0.01, 0.01)
radial = st.tuples(small, small, tiny, tiny, small) | st.tuples(small, small, tiny, tiny, small, small, small, small)
lenses = radial.map(lambda c: radial_tangential_lens(*c)) | st.tuples(*[st.floats(-0.1, 0.1)] * 4).map(
    lambda c: fisheye_lens(*c)
)
points = st.lists(st.tuples(st.floats(0, 639), st.floats(0, 479)), min_size=1, max_size=8).map(np.array)


@given(lenses, points)
def test_there_and_back(lens, px):
    c = camera(lens)
    assume(c.lens_fault() is None)
    np.testing.assert_allclose(c.distort(c.undistort(px)), px, atol=1e-5)


@pytest.mark.slow
@given(lenses, points)
def test_a_sound_lens_keeps_the_order_of_radii(lens, px):
    """Pixels farther out come from directions farther out; tangential terms, which need not keep it, left out."""
    if lens.model == "radial-tangential":
        k1, k2, _, _, *rest = lens.coefficients
        lens = radial_tangential_lens(k1, k2, 0, 0, *rest)
    c = camera(lens)
    assume(c.lens_fault() is None)
    f, centre = np.array([c.fx, c.fy]), np.array([c.cx, c.cy])
    measured = np.linalg.norm((px - centre) / f, axis=1)
    ideal = np.linalg.norm((c.undistort(px) - centre) / f, axis=1)
    assert (np.diff(ideal[np.argsort(measured)]) >= -1e-9).all()


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        # r (1 - 0.6 r^2) turns back at r = 1 / sqrt(1.8), where it is 0.4969: 239 px.
        (radial_tangential_lens(-0.6), r"radial-tangential lens folds over 239 px .* pixel \(0, 479\) is 403 px away"),
        (radial_tangential_lens(0.26, -0.95), "folds over 305 px"),
        (radial_tangential_lens(0, 0, 0.5, 0.5), r"folds over at pixel \(0, 0\)"),
        (radial_tangential_lens(0.1, 0, 0, 0, 0, 0, 0, 9.0), "radial-tangential lens folds over"),
        (fisheye_lens(-0.9), "fisheye lens folds over"),
        (fisheye_lens(-0.2, 0.1, -0.9, 0), "fisheye lens folds over"),
    ],
)
def test_a_lens_that_folds_over_is_named(lens, words):
    with np.errstate(all="raise"):
        fault = camera(lens).lens_fault()
    assert fault is not None and re.search(words, fault), fault


def test_a_fisheye_of_more_than_a_half_space_is_named():
    fault = Camera(190, 190, 256, 256, 512, 512, lens=fisheye_lens()).lens_fault()
    assert "fisheye lens sees 90 degrees off its axis 298 px" in fault  # 190 px pi / 2


@pytest.mark.parametrize("lens", [PINHOLE, *(radial_tangential_lens(*c) for c in RADIAL.values())])
def test_sound_lenses_have_no_fault(lens):
    assert camera(lens).lens_fault() is None


def test_pixels_that_no_direction_reaches():
    """Beyond the fold nothing is imaged, and measured pixels there take the direction of the fold."""
    c = camera(radial_tangential_lens(-0.6))
    fold = 1 / np.sqrt(1.8)
    assert c.lens.limit == pytest.approx((fold, fold * 2 / 3))
    beyond = np.array([[c.cx + 1.01 * fold * c.fx, c.cy], [c.cx + 0.99 * fold * c.fx, c.cy]])
    assert np.isnan(c.distort(beyond)).all(axis=1).tolist() == [True, False]
    np.testing.assert_allclose(c.undistort(np.array([[639.0, c.cy]])), [[c.cx + fold * c.fx, c.cy]], atol=1e-3)


def test_a_pole_is_no_fold():
    """r / (1 - r^2) grows without end before r = 1."""
    lens = radial_tangential_lens(0, 0, 0, 0, 0, -1.0)
    assert lens.limit == (1.0, np.inf)
    c = camera(lens, f=200.0)
    np.testing.assert_allclose(c.distort(c.undistort(pixels())), pixels(), atol=1e-8)


def test_coefficients_that_are_all_zero_make_a_pinhole_but_of_a_fisheye():
    assert radial_tangential_lens(0, 0, 0, 0, 0, 0, 0, 0) == radial_tangential_lens() == PINHOLE
    assert radial_tangential_lens(0.1, 0, 0, 0, 0, 0, 0, 0).coefficients == (0.1, 0, 0, 0, 0)
    assert not fisheye_lens().ideal
    assert not np.allclose(camera(fisheye_lens()).undistort(pixels()), pixels())


def test_lenses_name_artefacts_of_their_own():
    cameras = [camera(PINHOLE), camera(fisheye_lens(0.1)), camera(radial_tangential_lens(0.1))]
    cameras += [camera(radial_tangential_lens(0.1, 0, 0, 0, 0, 0.01))]
    assert len({fingerprint(c) for c in cameras}) == len(set(cameras)) == 4


def test_lenses_in_words():
    assert str(PINHOLE) == "pinhole"
    assert str(radial_tangential_lens(0.1, 0, 0, -0.02)) == "radial-tangential (k1 0.1, p2 -0.02)"
    assert str(fisheye_lens()) == "fisheye"


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=20).map(np.array))
def test_inverse_of_an_increasing_function(x):
    def value(x):
        return x + x**3

    found = invert_increasing(value, lambda x: 1 + 3 * x**2, value(x), np.inf)
    np.testing.assert_allclose(found, x, rtol=1e-12)
    assert (invert_increasing(value, lambda x: 1 + 3 * x**2, value(x), 0.5) <= 0.5).all()


def test_first_root():
    assert first_root(np.polynomial.Polynomial.fromroots([-1, 2, 3])) == pytest.approx(2)
    assert first_root(np.polynomial.Polynomial([1, 0, 1])) == np.inf
    assert first_root(np.polynomial.Polynomial([1, -0.5, 1e-300])) == 2
