"""Charts as inline SVG: sharp at any size, with a tooltip on every mark, and no library to load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from miniloop_cli.typing import Floats


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


@dataclass
class Chart:
    """A pair of axes in user units; marks are added in drawing order, `svg()` gives the element."""

    title: str
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    x_label: str = ""
    y_label: str = ""
    equal: bool = False  # one unit is as long on both axes
    down: bool = False  # y grows downwards, as rows of a matrix
    width: int = 460
    height: int = 340
    marks: list[str] = field(default_factory=list)

    LEFT, RIGHT, TOP, BOTTOM = 60, 12, 26, 42

    def __post_init__(self) -> None:
        if self.equal:
            per_px = max(self._unit(self.x_range, self.inner[0]), self._unit(self.y_range, self.inner[1]))
            self.x_range = self._widen(self.x_range, per_px * self.inner[0])
            self.y_range = self._widen(self.y_range, per_px * self.inner[1])

    @property
    def inner(self) -> tuple[int, int]:
        """Width and height of the plotting area (px)."""
        return self.width - self.LEFT - self.RIGHT, self.height - self.TOP - self.BOTTOM

    @staticmethod
    def _unit(span: tuple[float, float], px: int) -> float:
        return (span[1] - span[0]) / px

    @staticmethod
    def _widen(span: tuple[float, float], length: float) -> tuple[float, float]:
        middle = (span[0] + span[1]) / 2
        return middle - length / 2, middle + length / 2

    def place(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """User units to pixels of the picture."""
        width, height = self.inner
        u = (np.asarray(x, float) - self.x_range[0]) / (self.x_range[1] - self.x_range[0])
        v = (np.asarray(y, float) - self.y_range[0]) / (self.y_range[1] - self.y_range[0])
        return self.LEFT + u * width, self.TOP + (v if self.down else 1 - v) * height

    def line(self, x: Floats, y: Floats, css: str) -> None:
        """A polyline, broken where a value is not finite."""
        u, v = self.place(x, y)
        known = np.isfinite(u) & np.isfinite(v)
        for run in np.split(np.arange(len(u)), np.flatnonzero(~known)):
            rows = [k for k in run if known[k]]
            if len(rows) > 1:
                points = " ".join(f"{u[k]:.1f},{v[k]:.1f}" for k in rows)
                self.marks.append(f'<polyline class="{css}" points="{points}"/>')

    def dots(self, x: Floats, y: Floats, css: str, tips: Sequence[str], radius: float = 2.5) -> None:
        """Circles with tooltips; those that are not finite are left out."""
        u, v = self.place(x, y)
        for a, b, tip in zip(u, v, tips, strict=True):
            if np.isfinite(a) and np.isfinite(b):
                circle = f'<circle class="{css}" cx="{a:.1f}" cy="{b:.1f}" r="{radius}">'
                self.marks.append(f"{circle}<title>{escape(tip)}</title></circle>")

    def image(self, data_uri: str, x_range: tuple[float, float], y_range: tuple[float, float]) -> None:
        """An image stretched over a range of user units, its pixels kept as squares."""
        u, v = self.place(np.array(x_range), np.array(y_range))
        box = f'x="{u.min():.1f}" y="{v.min():.1f}" width="{np.ptp(u):.1f}" height="{np.ptp(v):.1f}"'
        self.marks.append(f'<image class="pixels" preserveAspectRatio="none" {box} href="{data_uri}"/>')

    def svg(self) -> str:
        """The chart with grid, numbers and captions."""
        width, height = self.inner
        right, bottom = self.LEFT + width, self.TOP + height
        parts = [f'<text class="title" x="{self.LEFT}" y="16">{escape(self.title)}</text>']
        for value in ticks(*self.x_range):
            x = self.place(np.array(value), np.array(self.y_range[0]))[0]
            parts.append(f'<path class="grid" d="M{x:.1f} {self.TOP}V{bottom}"/>')
            parts.append(f'<text class="tick" text-anchor="middle" x="{x:.1f}" y="{bottom + 15}">{value:.6g}</text>')
        for value in ticks(*self.y_range):
            y = self.place(np.array(self.x_range[0]), np.array(value))[1]
            parts.append(f'<path class="grid" d="M{self.LEFT} {y:.1f}H{right}"/>')
            parts.append(f'<text class="tick" text-anchor="end" x="{self.LEFT - 5}" y="{y + 4:.1f}">{value:.6g}</text>')
        middle = self.LEFT + width / 2
        parts.append(
            f'<text class="label" text-anchor="middle" x="{middle}" y="{bottom + 34}">{escape(self.x_label)}</text>'
        )
        turned = f'text-anchor="middle" transform="translate(12 {self.TOP + height / 2}) rotate(-90)"'
        parts.append(f'<text class="label" {turned}>{escape(self.y_label)}</text>')
        parts += self.marks
        parts.append(f'<rect class="frame" x="{self.LEFT}" y="{self.TOP}" width="{width}" height="{height}"/>')
        return wrap(parts, self.width, self.height, self.title)


def wrap(parts: Sequence[str], width: int, height: int, label: str) -> str:
    """An svg element that scales with the page."""
    return f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'
