"""Depth at features: exact on planes, refused at holes, edges and out of range."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.config import Depth
from miniloop_cli.features.lift import depth_at, depth_slope, on_outline

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
