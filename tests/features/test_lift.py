"""Depth at features: exact on planes, refused at holes, edges and out of range."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.config import Depth
from miniloop_cli.features.lift import depth_at, depth_slope

PLAIN = Depth()


@settings(max_examples=50, deadline=None)
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
