"""The software renderer and the charts, by brute force and known answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.report import splat
from miniloop_cli.report.splat import BACKGROUND, View, overview, shade
from miniloop_cli.report.svg import Chart, limits, ticks
from miniloop_cli.report.templating import render


@settings(max_examples=25)
@given(st.integers(0, 9999))
def test_the_nearest_point_is_seen(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform([-1, -1, -0.5], [1, 1, 3], (300, 3))
    colors = rng.integers(0, 256, (300, 3), dtype=np.uint8)
    view = View(np.eye(4), 40.0, 64, 48)
    expected = np.broadcast_to(BACKGROUND, (48, 64, 3)).copy()
    depth = np.full((48, 64), np.inf, np.float32)
    px, z = view.project(points)
    for k in range(300):
        if z[k] <= 0.05:
            continue
        side = int(np.clip(np.ceil(np.float32(view.focal_px * 0.1 / z[k])), 1, 6))
        x0, y0 = np.floor(px[k] - (side - 1) / 2 + 0.5).astype(int)
        for y in range(max(y0, 0), min(y0 + side, 48)):
            for x in range(max(x0, 0), min(x0 + side, 64)):
                if z[k] < depth[y, x]:
                    depth[y, x], expected[y, x] = z[k], colors[k]
    np.testing.assert_array_equal(splat.render(points, colors, view, point_m=0.1), shade(expected, depth))


def test_points_behind_the_view_leave_the_background():
    picture = splat.render(np.array([[0, 0, -1.0]]), np.zeros((1, 3), np.uint8), View(np.eye(4), 50, 32, 24))
    assert (picture == BACKGROUND).all()


def test_overview_shows_the_cloud_from_the_cameras_side():
    rng = np.random.default_rng(1)
    points = rng.normal([10, 0, 5], [1, 0.5, 0.2], (5000, 3))
    view = overview(points, np.eye(4)[None], 0, 0, (300, 200))
    px, z = view.project(points)
    assert (z > 0).mean() > 0.99
    inside = ((px >= 0) & (px < [300, 200])).all(axis=1)
    assert inside.mean() > 0.9
    assert np.ptp(px[inside, 0]) > 150  # and fills the picture
    np.testing.assert_allclose(view.T_view_world[:3, :3], np.eye(3), atol=1e-9)


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_ticks_are_few_and_inside(low, length):
    values = ticks(low, low + length)
    slack = 1e-6 * max(abs(low), length)
    assert len(values) <= 10
    assert all(low - slack <= v <= low + length + slack for v in values)


def test_ticks_are_round():
    assert ticks(0, 1) == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1.0])
    assert ticks(-3.2, 3.1) == pytest.approx([-3, -2, -1, 0, 1, 2, 3])


def test_limits_never_collapse():
    assert limits() == (0, 1)
    assert limits(np.array([np.nan])) == (0, 1)
    low, high = limits(np.array([2.0, 2.0]))
    assert low < 2 < high


def test_equal_axes_have_one_scale():
    chart = Chart("t", (0, 10), (0, 1), equal=True)
    (x0, x1), (y0, y1) = chart.place(np.array([0, 1]), np.array([0, 1]))
    assert x1 - x0 == pytest.approx(y0 - y1)


def test_lines_break_at_gaps_and_tips_are_escaped():
    chart = Chart("a <b>", (0, 4), (0, 4))
    chart.line(np.arange(5.0), np.array([1, 2, np.nan, 3, 4]), "c")
    chart.dots(np.array([1.0, np.nan]), np.array([1.0, 1]), "c", ["<i>", "x"])
    svg = render("chart.svg", chart=chart)
    assert svg.count("<polyline") == 2
    assert svg.count("<circle") == 1
    assert "&lt;i&gt;" in svg
    assert "a &lt;b&gt;" in svg
