"""The registration of depth to colour, by the agreement of their edges.

The mean strength of colour edges at the depth edges, as a function of a shift of the depth, has a sharp peak: at zero
if the depth is registered, elsewhere if it is shifted, and none if it belongs to another image.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Scan, Sequence
from miniloop_cli.typing import Bytes, Floats32

SAMPLE = 24  # frames, which the heights below are for
Reader = Callable[[Sequence, int], Scan]

REACH = 48  # largest shift that is tried, pixels of a 640-pixel image
TOLERANCE = 4.0  # a peak this near to zero is registered; for real Kinects it is at about two
JUMP = 0.08  # relative step that makes a depth edge


@dataclass(frozen=True)
class Agreement:
    """The peak over all shifts: its height in robust deviations, its position (px), and the height near zero."""

    peak: float
    shift_px: tuple[int, int]
    at_zero: float
    depth_edges: float  # pixels a frame


def color_edges(color: Bytes) -> Floats32:
    """(h, w) strength of colour edges relative to their close surroundings, zero mean.

    Three channels, little smoothing and close surroundings distinguish outlines from texture.
    """
    import cv2

    smooth = cv2.GaussianBlur(color.astype(np.float32), (0, 0), 0.7)
    dx, dy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    strength = np.sqrt((dx * dx + dy * dy).sum(axis=2))
    strength = np.minimum(strength / (cv2.blur(strength, (21, 21)) + 4), 4)
    return strength - strength.mean()


def depth_edges(depth_m: Floats32) -> Floats32:
    """(h, w) 1 on the nearer side of a jump of depth_m (h, w), else 0; the outline of what is in front."""
    import cv2

    near = cv2.erode(np.where(depth_m > 0, depth_m, np.float32(1e3)), np.ones((3, 3), np.uint8))
    far = cv2.dilate(depth_m, np.ones((3, 3), np.uint8))
    edges = (depth_m > 0) & (far - near > JUMP * near) & (depth_m < 1.03 * near)
    edges[:5], edges[-5:], edges[:, :5], edges[:, -5:] = False, False, False, False
    return edges.astype(np.float32)


def agreement(pairs: Many[tuple[Floats32, Floats32]]) -> Agreement:
    """Cross-correlation of colour edges and depth edges (h, w) of several frames, by FFT.

    Frames with less than 30 pixels of depth edges do not count.
    """
    total, counts = None, [float(depth.sum()) for _, depth in pairs]
    for (color, depth), count in zip(pairs, counts, strict=True):
        if count < 30:
            continue
        spectrum = np.fft.rfft2(color) * np.conj(np.fft.rfft2(depth))
        response = np.fft.irfft2(spectrum, s=color.shape) / np.sqrt(count)
        total = response if total is None else total + response
    if total is None:
        return Agreement(0.0, (0, 0), 0.0, float(np.mean(counts)) if counts else 0.0)
    unit = total.shape[1] / 640
    reach = min(int(REACH * unit), min(total.shape) // 2 - 1)
    window = np.roll(total, (reach, reach), (0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    centred = window - np.median(window)
    heights = centred / max(1.4826 * float(np.median(np.abs(centred))), 1e-12)
    y, x = np.unravel_index(np.argmax(heights), heights.shape)
    offset = np.arange(-reach, reach + 1)
    near = np.hypot(offset[:, None], offset) <= max(TOLERANCE * unit, 1.5)
    # A correlation at (x, y) means that depth fits if moved by (x, y).
    shift = (int(x) - reach, int(y) - reach)
    return Agreement(float(heights[y, x]), shift, float(heights[near].max()), float(np.mean(counts)))


def halved(edges: Floats32) -> Floats32:
    """(h / 2, w / 2) means of edges (h, w); a coarser image tolerates larger shifts."""
    import cv2

    size = (edges.shape[1] // 2, edges.shape[0] // 2)
    return np.asarray(cv2.resize(edges, size, interpolation=cv2.INTER_AREA), np.float32)


def enlarged(edges: Floats32, factor: float) -> Floats32:
    """(h, w) edges as they would be if the depth image were enlarged by `factor` about its centre."""
    import cv2

    h, w = edges.shape
    M = np.array([[factor, 0, (1 - factor) * (w - 1) / 2], [0, factor, (1 - factor) * (h - 1) / 2]])
    return np.asarray(cv2.warpAffine(edges, M, (w, h), flags=cv2.INTER_LINEAR), np.float32)


@dataclass(frozen=True)
class Verdict:
    """The relation of depth and colour: `kind` is registered, shifted, enlarged, mirrored, late, foreign or unknown."""

    kind: str
    agreement: Agreement
    shift_px: tuple[int, int] = (0, 0)  # by which the depth must be moved
    factor: float = 1.0  # by which it must be enlarged
    frames: int = 0  # from the depth's own colour image to the fitting one

    def sentence(self) -> str:
        """What does not fit, and how it would; "" if depth is registered, or nothing tells."""
        x, y = self.shift_px
        later = "later" if self.frames > 0 else "earlier"
        return {
            "shifted": f"depth is shifted against colour: it fits when moved by ({x}, {y}) px",
            "enlarged": f"depth and colour differ in scale: depth fits when scaled by {self.factor:.2f} and moved by "
            f"({x}, {y}) px",
            "mirrored": "depth is a mirror image of colour",
            "late": f"depth belongs to the colour image {abs(self.frames)} frame(s) {later}",
            "foreign": "depth does not belong to the colour images: edges in depth are not edges in colour",
        }.get(self.kind, "")


# Heights of peaks. Unrelated images reach 4.7, and 2.1 at zero. Registered ones reach 12 to 30 over 24 frames, and 4 to
# 27 over 8 successive real frames, whose few outlines also blur the peak.
FIRM, SURE, NOISE = 7.0, 6.2, 3.2
FACTORS = tuple(float(f) for f in np.exp(np.arange(-12, 13) * 0.018) if f != 1)
LAGS = (-1, 1, -2, 2, -3, 3, -5, 5)
ENOUGH_EDGES = 2000


def as_they_lie(color: Many[Floats32], depth: Many[Floats32]) -> Verdict:
    """The relation of the edges of some frames, without a search: registered, shifted or unknown.

    color, depth: (h, w) edges of the same frames.
    """
    found = agreement(list(zip(color, depth, strict=True)))
    tolerance = (TOLERANCE + 1) * (color[0].shape[1] / 640 if color else 1)
    off = float(np.hypot(*found.shift_px)) > tolerance and found.at_zero < 0.7 * found.peak
    if found.at_zero >= FIRM and not off:
        return Verdict("registered", found)
    if off and found.peak >= FIRM:
        return Verdict("shifted", found, found.shift_px)
    return Verdict("unknown", found)


def diagnose(
    color: Many[Floats32], depth: Many[Floats32], color_behind: Callable[[int], Many[tuple[int, Floats32]]]
) -> Verdict:
    """The relation of depth and colour of some frames.

    `color`, `depth`: (h, w) edges of the same frames. `color_behind(lag)`: for some of the frames, their number in
    those lists and the colour edges `lag` frames later; only called if the frames' own do not fit.
    """
    verdict = as_they_lie(color, depth)
    found, both = verdict.agreement, list(zip(color, depth, strict=True))
    if verdict.kind != "unknown" or found.depth_edges * len(depth) < ENOUGH_EDGES:
        return verdict
    nothing = Verdict("foreign" if found.at_zero < NOISE else "unknown", found)
    tried = [(max(SURE, 1.5 * found.peak), nothing)]
    for axis in (1, 0):
        flipped = agreement([(c, np.ascontiguousarray(np.flip(d, axis))) for c, d in both])
        tried.append((flipped.at_zero, Verdict("mirrored", found)))
    coarse = 2 if color[0].shape[1] > 480 else 1
    small = [(halved(c), halved(d)) for c, d in both] if coarse == 2 else both
    for factor in FACTORS:
        zoomed = agreement([(c, enlarged(d, factor)) for c, d in small])
        shift = (coarse * zoomed.shift_px[0], coarse * zoomed.shift_px[1])
        tried.append((zoomed.peak, Verdict("enlarged", found, shift, factor)))
    for lag in LAGS:
        late = agreement([(c, depth[k]) for k, c in color_behind(lag)])
        tried.append((late.at_zero, Verdict("late", found, frames=lag)))
    return max(tried, key=lambda entry: entry[0])[1]


def sampled(sequence: Sequence, most: int = SAMPLE) -> list[int]:
    """Numbers of evenly spaced frames."""
    return np.unique(np.linspace(0, len(sequence.frames) - 1, most).round().astype(int)).tolist()


def edges_of(sample: Mapping[int, Scan]) -> tuple[list[Floats32], list[Floats32]]:
    """The edges (h, w) of colour, and those of depth, of the frames of a sample."""
    scans = sample.values()
    return [color_edges(scan.color) for scan in scans], [depth_edges(scan.depth_m) for scan in scans]


def registration_of(sequence: Sequence, sample: Mapping[int, Scan], read: Reader) -> Verdict:
    """The relation of depth and colour in the frames of a sample; `read` gives others of the recording."""
    color, depth = edges_of(sample)

    def color_behind(lag: int) -> list[tuple[int, Floats32]]:
        found = []
        for k, index in list(enumerate(sample))[::2]:
            if 0 <= index + lag < len(sequence.frames):
                try:
                    found.append((k, color_edges(read(sequence, index + lag).color)))
                except InputError:
                    continue
        return found

    return diagnose(color, depth, color_behind)
