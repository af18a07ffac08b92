"""Depth at features: exact on planes, refused at holes, edges and out of range."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.config import Depth, Features
from miniloop_cli.features.detect import detect
from miniloop_cli.features.keypoints3d import blob_shift, clear_of, depth_at, depth_slope, on_outline, scan_features
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Scan

PLAIN = Depth()


@settings(max_examples=50)
@given(st.floats(0.8, 4), st.floats(-0.002, 0.002), st.floats(-0.002, 0.002), st.integers(0, 2**32 - 1))
def test_depth_and_slope_of_a_plane_are_exact(z0, a, b, seed):
    v, u = np.mgrid[0:60, 0:80]
    depth_m = (z0 + a * u + b * v).astype(np.float32)
    px = np.random.default_rng(seed).uniform((6, 6), (73, 53), (20, 2))
    z = depth_at(depth_m, px, PLAIN)
    assert np.allclose(z, z0 + a * px[:, 0] + b * px[:, 1], atol=1e-5)
    assert np.allclose(depth_slope(depth_m, px, z, PLAIN), (a, b), atol=1e-5)


def test_holes_edges_borders_and_range_are_refused():
    depth_m = np.full((40, 40), 2.0, np.float32)
    depth_m[:, 20:] = 2.2  # an edge of 10 %
    depth_m[5, 5] = 0
    depth_m[30:, :5] = 9.0
    depth_m[30:, 35:] = np.inf
    px = np.array([[5.4, 5.4], [19.5, 10.0], [-1.0, 3.0], [39.0, 3.0], [2.0, 35.0], [37.0, 35.0], [10.2, 10.7]])
    assert np.isfinite(depth_at(depth_m, px, PLAIN)).tolist() == [False] * 6 + [True]


def test_slope_is_zero_across_an_edge():
    depth_m = np.full((40, 40), 2.0, np.float32)
    depth_m[:, 23:] = 2.3
    px = np.array([[20.0, 20.0]])
    assert np.array_equal(depth_slope(depth_m, px, depth_at(depth_m, px, PLAIN), PLAIN), [[0, 0]])


def test_a_feature_is_on_an_outline_if_depth_jumps_within_its_radius():
    depth_m = np.full((60, 60), 2.0, np.float32)
    depth_m[:, 30:] = 2.3
    depth_m[:, 30:34] = 0  # no reading in the shadow of the edge
    px = np.array([[20.0, 20.0], [20.0, 20.0], [27.0, 20.0], [32.0, 20.0], [40.0, 59.0]])
    radius_px = np.float32([2, 15, 8, 9, 30])
    z_m = np.array([2.0, 2.0, 2.0, np.nan, 2.3])
    assert on_outline(depth_m, px, radius_px, z_m).tolist() == [False, True, True, False, True]
    slanted = np.tile(np.linspace(1.0, 2.0, 60, dtype=np.float32), (60, 1))
    assert not on_outline(slanted, px[:1], radius_px[:1], np.array([1.339])).any()


def test_no_feature_reaches_into_a_mask_and_the_rest_of_the_image_has_about_as_many():
    coarse = np.random.default_rng(0).integers(0, 256, (40, 60, 3)).astype(np.uint8)
    color = np.kron(coarse, np.ones((8, 8, 1), np.uint8))
    mask = np.zeros((320, 480), bool)
    mask[60:260, 150:400] = True
    camera, wanted = Camera(450, 450, 239.5, 159.5, 480, 320), Features(count=150)
    depth_m = np.full((320, 480), 2.0, np.float32)
    depth_m[mask] = 0
    found = scan_features(Scan(color, depth_m, mask), camera, wanted, PLAIN)
    open_ = scan_features(Scan(color, depth_m), camera, wanted, PLAIN)
    x, y = np.rint(found.px).astype(int).T
    assert 0.8 * 150 <= len(found) <= 150
    assert not mask[y, x].any() and np.isfinite(found.z_m).all()
    assert mask[tuple(np.rint(open_.px).astype(int).T[::-1])].any(), "without a mask, features lie there"
    everywhere = detect(color[..., 1], "sift", 1000)
    clear = clear_of(mask, everywhere.px, everywhere.radius_px)
    v, u = np.nonzero(mask)
    for px, radius, is_clear in zip(everywhere.px[::50], everywhere.radius_px[::50], clear[::50], strict=True):
        nearest = np.hypot(*(np.rint(px)[:, None] - [u, v])).min()
        assert is_clear == (nearest > radius)


@pytest.mark.parametrize("sigma_px", [3.0, 6.0, 8.0])
def test_sift_finds_a_blob_on_a_slanted_surface_off_its_middle_and_the_shift_is_taken_off(sigma_px):
    """Depth is z0 / (1 - p u), u px right of the middle: there lies the place (u, v) / (1 - p u) of the surface."""
    p, middle = 0.008, np.array([160.3, 120.2])
    v, u = np.mgrid[0:240, 0:320]
    near = 1 - p * (u - middle[0])
    x, y = (u - middle[0]) / near, (v - middle[1]) / near
    found = detect((40 + 180 * np.exp(-(x**2 + y**2) / (2 * sigma_px**2))).astype(np.uint8), "sift", 50)
    k = np.argmin(np.linalg.norm(found.px - middle, axis=1))
    off = found.px[k] - middle
    shift = blob_shift(found.radius_px[k : k + 1], np.array([2.0]), np.array([[2.0 * p, 0.0]]))[0]
    assert off[0] == pytest.approx(-p * sigma_px**2, rel=0.1), "found on the nearer side"
    assert np.abs(off + shift).max() < 0.04
    assert shift[1] == 0


def test_no_blob_is_moved_where_depth_is_unknown():
    assert np.array_equal(blob_shift(np.float32([5]), np.array([np.nan]), np.zeros((1, 2))), [[0, 0]])
