"""Textures drawn at random: noise of many octaves, shapes, and posters with text, (h, w, 3) uint8 RGB."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from miniloop_cli.typing import Bytes, Floats32

WORDS = ("mini", "loop", "scan", "cycle", "depth", "solver", "rotation", "closure", "camera", "graph", "edge", "pose")


def octaves(height: int, width: int, rng: Generator, coarsest_px: float = 128.0, persistence: float = 0.75) -> NDArray:
    """(h, w) float32 noise of zero mean and unit deviation: octaves from `coarsest_px` down to 2 pixels."""
    import cv2

    total = np.zeros((height, width), np.float32)
    cell, weight = coarsest_px, 1.0
    while cell >= 2:
        grid = rng.standard_normal((int(height / cell) + 3, int(width / cell) + 3)).astype(np.float32)
        size = (int(grid.shape[1] * cell), int(grid.shape[0] * cell))
        total += weight * cv2.resize(grid, size, interpolation=cv2.INTER_CUBIC)[:height, :width]
        cell, weight = cell / 2, weight * persistence
    return (total - total.mean()) / max(float(total.std()), 1e-6)


def color(rng: Generator, low: int = 30, high: int = 230) -> Floats32:
    """(3,) a random colour."""
    return rng.uniform(low, high, 3).astype(np.float32)


def surface(height: int, width: int, rng: Generator, contrast: float, base: Floats32) -> Bytes:
    """Noise (h, w, 3) around a base colour: lightness of all octaves, hue of the coarse ones."""
    image = base + contrast * octaves(height, width, rng)[..., None]
    image += 0.5 * contrast * octaves(height, width, rng, 64)[..., None] * rng.uniform(-1, 1, 3).astype(np.float32)
    return image.clip(5, 250).astype(np.uint8)


def add_shapes(image: Bytes, count: int, rng: Generator, largest_px: int = 60) -> None:
    """Draw filled rectangles, discs and lines of random colours into the image (h, w, 3)."""
    import cv2

    height, width = image.shape[:2]
    for kind in rng.integers(0, 3, count):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        a, b = (int(v) for v in rng.integers(4, max(largest_px, 5), 2))
        paint = tuple(float(v) for v in color(rng, 0, 255))
        if kind == 0:
            cv2.rectangle(image, (x, y), (x + a, y + b), paint, -1)
        elif kind == 1:
            cv2.circle(image, (x, y), a // 2 + 2, paint, -1)
        else:
            cv2.line(image, (x, y), (x + 2 * a - largest_px, y + 2 * b - largest_px), paint, max(a // 12, 1))


def poster(height: int, width: int, rng: Generator) -> Bytes:
    """A sheet (h, w, 3) with a title, a picture and lines of text."""
    import cv2

    sheet = np.full((height, width, 3), color(rng, 170, 250), np.float32).astype(np.uint8)
    ink = tuple(float(v) for v in color(rng, 0, 90))
    unit = max(height, 40)
    cv2.rectangle(sheet, (0, 0), (width - 1, height - 1), ink, max(unit // 60, 1))
    title, body = unit / 320, unit / 640
    cv2.putText(sheet, str(rng.choice(WORDS)).upper(), (width // 20, int(0.16 * height)), 0, title, ink, unit // 90 + 1)
    top, bottom, right = int(0.22 * height), int(0.55 * height), int(0.95 * width)
    picture = sheet[top:bottom, width // 20 : right]
    picture[:] = surface(picture.shape[0], picture.shape[1], rng, 45, color(rng, 60, 200))
    add_shapes(picture, 12, rng, max(unit // 6, 6))
    for y in np.arange(0.64, 0.97, 0.08) * height:
        line = " ".join(rng.choice(WORDS, 5))
        cv2.putText(sheet, line, (width // 20, int(y)), 0, body, ink, 1, cv2.LINE_AA)
    return sheet


def wall(height: int, width: int, texel_per_m: float, rng: Generator, posters: int, contrast: float = 9.0) -> Bytes:
    """Plaster (h, w, 3) with posters of 0.4 to 0.9 m and a few small shapes."""
    hue = color(rng, 120, 215)
    image = surface(height, width, rng, contrast, 0.4 * hue + 0.6 * hue.mean())
    add_shapes(image, posters * 4, rng, int(0.12 * texel_per_m))
    for k in range(posters):
        h = int(min(rng.uniform(0.45, 0.9) * texel_per_m, 0.8 * height))
        w = int(min(h * rng.uniform(0.65, 1.3), width / posters))
        x = int((k + 0.5) * width / posters - w / 2 + rng.uniform(-0.1, 0.1) * width / posters)
        x, y = min(max(x, 0), width - w), int(rng.uniform(0.12, 0.6) * (height - h))
        image[y : y + h, x : x + w] = poster(h, w, rng)
    return image


def repeated(height: int, width: int, texel_per_m: float) -> Bytes:
    """The same tile of 0.5 m side everywhere (h, w, 3), for any seed."""
    side = max(int(0.5 * texel_per_m), 16)
    rng = np.random.default_rng(0)
    tile = surface(side, side, rng, 30, np.array([150, 140, 120], np.float32))
    add_shapes(tile, 25, rng, max(side // 4, 6))
    return np.tile(tile, (height // side + 1, width // side + 1, 1))[:height, :width].copy()
