"""Numbers from the stamps: paired images, the rate, the gaps."""

from __future__ import annotations

from typing import Any

import numpy as np

from miniloop_cli.scene.sequence import Sequence

GAP = 5.0  # intervals this many times longer than the median are gaps


def timing(sequence: Sequence) -> dict[str, Any]:
    """Numbers of colour and depth images and pairs, interval (s), longest gaps, delay of depth behind colour (ms)."""
    stamps = np.array([frame.timestamp_s for frame in sequence.frames])
    intervals = np.diff(stamps)
    usual = float(np.median(intervals)) if len(intervals) else 0.0
    longest = np.argsort(-intervals)[:5]
    gaps = [
        {"after_frame": int(k), "at_s": float(stamps[k]), "length_s": float(intervals[k])}
        for k in longest
        if intervals[k] > GAP * usual and intervals[k] > 0.5
    ]
    color, depth = sequence.available if all(sequence.available) else (len(stamps), len(stamps))
    delays = [f.depth_timestamp_s - f.timestamp_s for f in sequence.frames if f.depth_timestamp_s is not None]
    return {
        "color_images": color,
        "depth_images": depth,
        "paired": len(stamps) / max(min(color, depth), 1),
        "duration_s": float(stamps[-1] - stamps[0]),
        "interval_s": usual,
        "gaps": gaps,
        "depth_delay_ms": float(1000 * np.median(delays)) if delays else None,
    }
