"""Charts laid out in the pixels of an inline SVG; `templates/chart.svg` draws them, with a tooltip on every dot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.typing import Floats, Ints

MOST_DOTS = 1000  # of one kind in a chart: more overlap, and make a page slow

LEFT, RIGHT, TOP, BOTTOM = 60, 12, 26, 42  # margins around the plotting area (px)


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About `count` round numbers (1, 2 or 5 times a power of ten apart) within [low, high]."""
    raw = max(high - low, 1e-12) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / raw)))
    return [float(k * step) for k in range(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1)]


def limits(*series: Floats, margin: float = 0.05) -> tuple[float, float]:
    """Range of the finite values with a margin; (0, 1) if there are none, never empty."""
    values = np.concatenate([np.ravel(s) for s in series]) if series else np.empty(0)
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    extra = margin * (high - low) or max(0.05 * abs(high), 0.5)
    return low - extra, high + extra


def tenths(values: ArrayLike) -> list[float]:
    """(n,) pixels as numbers with one decimal, finer than a screen."""
    return np.round(np.ravel(values), 1).tolist()


def spread(count: int, most: int) -> Ints:
    """(k,) rows of `count`, ascending: all, or `most` evenly spaced ones, the first and the last among them."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.int64)


@dataclass
class Chart:
    """A pair of axes in user units, and their content in pixels: images, above them lines, on top circles."""

    title: str
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    x_label: str = ""
    y_label: str = ""
    equal: bool = False  # equal scales on both axes
    down: bool = False  # y grows downwards, as rows of a matrix
    width: int = 460
    height: int = 340
    images: list[tuple[float, float, float, float, str]] = field(default_factory=list)  # x, y, width, height, URI
    lines: list[tuple[str, str]] = field(default_factory=list)  # class, points
    circles: list[tuple[float, float, float, str, str]] = field(default_factory=list)  # x, y, radius, class, tooltip

    def __post_init__(self) -> None:
        self.left, self.right = LEFT, self.width - RIGHT
        self.top, self.bottom = TOP, self.height - BOTTOM
        if self.equal:
            width, height = self.right - self.left, self.bottom - self.top
            per_px = max(np.ptp(self.x_range) / width, np.ptp(self.y_range) / height)
            self.x_range = _widened(self.x_range, per_px * width)
            self.y_range = _widened(self.y_range, per_px * height)

    @property
    def x_ticks(self) -> list[tuple[float, float]]:
        """(pixel, value) of the numbers on the horizontal axis."""
        values = ticks(*self.x_range)
        return list(zip(tenths(self.place(values, self.y_range[0])[0]), values, strict=True))

    @property
    def y_ticks(self) -> list[tuple[float, float]]:
        """(pixel, value) of the numbers on the vertical axis."""
        values = ticks(*self.y_range)
        return list(zip(tenths(self.place(self.x_range[0], values)[1]), values, strict=True))

    def place(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """x (n,) and y (n,) in units of the axes as pixels of the picture."""
        u = (np.asarray(x, float) - self.x_range[0]) / (self.x_range[1] - self.x_range[0])
        v = (np.asarray(y, float) - self.y_range[0]) / (self.y_range[1] - self.y_range[0])
        u_px = self.left + u * (self.right - self.left)
        return u_px, self.top + (v if self.down else 1 - v) * (self.bottom - self.top)

    def line(self, x: Floats, y: Floats, css: str) -> None:
        """A polyline through x (n,), y (n,), broken where a value is not finite."""
        u, v = self.place(x, y)
        known = np.isfinite(u) & np.isfinite(v)
        for run in np.split(np.arange(len(u)), np.flatnonzero(~known)):
            rows = [k for k in run if known[k]]
            if len(rows) > 1:
                self.lines.append((css, " ".join(f"{u[k]:.1f},{v[k]:.1f}" for k in rows)))

    def dots(self, x: Floats, y: Floats, css: str, tips: Sequence[str], radius: float = 2.5) -> None:
        """Circles at x (n,), y (n,) with tooltips, evenly spaced ones if there are too many; not at NaN or infinity."""
        u, v = self.place(x, y)
        known = np.flatnonzero(np.isfinite(u) & np.isfinite(v))
        rows = known[spread(len(known), MOST_DOTS)]
        for k, a, b in zip(rows.tolist(), tenths(u[rows]), tenths(v[rows]), strict=True):
            self.circles.append((a, b, radius, css, tips[k]))

    def image(self, data_uri: str, x_range: tuple[float, float], y_range: tuple[float, float]) -> None:
        """An image stretched over a range of user units, its pixels kept as squares."""
        u, v = self.place(x_range, y_range)
        x, y, width, height = tenths([u.min(), v.min(), np.ptp(u), np.ptp(v)])
        self.images.append((x, y, width, height, data_uri))


def _widened(span: tuple[float, float], length: float) -> tuple[float, float]:
    middle = (span[0] + span[1]) / 2
    return middle - length / 2, middle + length / 2
