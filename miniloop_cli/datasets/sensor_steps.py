"""The steps of a structured-light sensor: equal in inverse depth, fixed by its hardware, and thus a metric scale."""

from __future__ import annotations

from collections.abc import Sequence as Many

import numpy as np

from miniloop_cli.typing import Floats32

KINECT_STEP_PER_M = 0.00289  # 1 / (8 f b): f = 576 px, b = 75 mm; freiburg1 measures 0.00288
STEP_RANGE = 7.0  # steps up to so many times larger or smaller are searched
BIN_PER_M, MAX_BINS = 3e-5, 500_000
MIN_CLARITY = 0.5  # of accepted steps


def too_large_by(step_per_m: float, clarity: float) -> float | None:
    """Factor by which depth is too large for a Kinect or Xtion; None if the steps do not contradict the scale.

    Other sensors have other steps, so only small errors and confusion of 5000 with 1000 units a metre are reported.
    """
    factor = KINECT_STEP_PER_M / step_per_m if step_per_m else 1.0
    small, mixed_up = 1 / 1.7 < factor < 1.7, 4.5 < factor < 5.5 or 4.5 < 1 / factor < 5.5
    off = not 1 / 1.1 < factor < 1.1
    return factor if clarity > MIN_CLARITY and off and (small or mixed_up) else None


def disparity_step(depths_m: Many[Floats32]) -> tuple[float, float]:
    """Step of the readings (h, w) in inverse depth (1/m), and how pronounced it is, 0 to 1 (1: all on steps).

    The highest peak of the periodogram of the histogram of 1/z. Multiples of a frequency have peaks as well, so the
    largest step that is nearly as pronounced as the best is used.
    """
    z = np.concatenate([depth[depth > 0][::7] for depth in depths_m]) if depths_m else np.zeros(0)
    if len(z) < 1000:
        return 0.0, 0.0
    low, high = np.quantile(z, [0.3, 0.9])
    inverse = 1 / z[(z >= low) & (z <= high)].astype(float)
    bins = int(min(np.ptp(inverse) / BIN_PER_M, MAX_BINS)) + 1
    counts, edges = np.histogram(inverse, bins)
    size = 1 << 20
    power = np.abs(np.fft.rfft(counts, size)) / counts.sum()
    frequency = np.fft.rfftfreq(size, edges[1] - edges[0])
    inside = (frequency > 1 / (KINECT_STEP_PER_M * STEP_RANGE)) & (frequency < STEP_RANGE / KINECT_STEP_PER_M)
    power, frequency = power[inside], frequency[inside]
    if not len(power):
        return 0.0, 0.0  # all readings are equal
    first = int(np.argmax(power > 0.9 * power.max()))
    k = first + int(np.argmax(power[first : first + 200]))
    return float(1 / frequency[k]), float(power[k])
