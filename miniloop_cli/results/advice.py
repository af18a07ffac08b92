"""What to try where a run did not go well, from what its frames and edges show."""

from __future__ import annotations

import numpy as np

from miniloop_cli.results.columns import Edges, RunColumns
from miniloop_cli.results.facts import pieces
from miniloop_cli.scene.verdict import Rejection
from miniloop_cli.typing import Floats

FEW_KEYPOINTS, FEW_READINGS = 300, 0.35
# The images, or other edges, speak against an edge that is rejected for one of these.
SPOKEN_AGAINST = {
    rejection.label
    for rejection in (
        Rejection.LOOKS_DIFFERENT,
        Rejection.SCAN_LOOKS_DIFFERENT,
        Rejection.MOVING_COMPONENT,
        Rejection.MOSTLY_MOVING,
        Rejection.REPETITION,
        Rejection.CONTRADICTS_POSES,
        Rejection.CONTRADICTS_GRAVITY,
        Rejection.CONTRADICTS_POSE_PRIOR,
    )
}
MOSTLY_REJECTED = 0.8  # chance matches make many pairs that are rejected, also in a good recording
NEAR_M, FAR_M = 0.25, 6.0  # a median depth outside suggests a wrong scale


def advice(data: RunColumns, good: bool, loose: bool) -> list[str]:
    """What to try; `good`: nothing speaks against the run; `loose`: its edges disagree with the poses as a whole."""
    return _scale_advice(data) + (_few_edges(data) if good else _troubles(data, loose))


def _scale_advice(data: RunColumns) -> list[str]:
    depth = _median(data.frames.median_depth_m)
    if NEAR_M <= depth <= FAR_M or not np.isfinite(depth):
        return []
    words = f"The median depth is {depth:.2f} m, unusual for such a recording: check depth_scale (units a metre)"
    return [f"{words} in the camera file; a wrong scale registers well and gives a model of the wrong size."]


def _few_edges(data: RunColumns) -> list[str]:
    matched = int(np.isfinite(data.frames.keypoints).sum())  # no edge leads to frames that were only followed
    if len(data.edges.worst_first) >= 2 * matched:
        return []
    return ["Few edges hold the frames together: a recording that returns to known places is more accurate."]


def _troubles(data: RunColumns, loose: bool) -> list[str]:
    """What to try where it did not work, from what the frames and edges show."""
    frames, edges, advice = data.frames, data.edges, []
    if _median(frames.keypoints) < FEW_KEYPOINTS:
        advice.append(
            f"Few features ({_median(frames.keypoints):.0f} a frame at the median): more light, a slower camera and "
            "less plain walls help; so may another detector (--features orb) or --config accurate."
        )
    if _median(frames.depth_valid_share) < FEW_READINGS:
        advice.append(
            f"Depth has readings in only {100 * _median(frames.depth_valid_share):.0f} % of the pixels: stay within "
            "the sensor's range, and check the depth folder."
        )
    if not frames.registered.all() and len(pieces(data)) > 1:
        advice.append(
            "The pieces have no verified edge between them: record a frame that shows parts of both, "
            "or keep more frames (--max-frames) where the camera moved fast."
        )
    if len(edges) and edges.rejected.mean() > MOSTLY_REJECTED:
        advice.append(_why_rejected(edges))
    if len(frames) > 2 and not len(edges):
        advice.append("No two frames share enough matches: do they show the same place, at more than a third overlap?")
    if loose:
        advice.append(
            "The disagreement is far above a depth camera's noise: check the camera (focal length, distortion, "
            "depth_scale), and whether depth is registered to colour (`miniloop inspect`)."
        )
    return advice


def _why_rejected(edges: Edges) -> str:
    """What the reason of most rejected pairs suggests."""
    reasons = [rejection for rejection, out in zip(edges.rejection, edges.rejected, strict=True) if out]
    against = sum(rejection in SPOKEN_AGAINST for rejection in reasons)
    share = f"{100 * edges.rejected.mean():.0f} % of the pairs were rejected"
    if 2 * against > len(reasons):
        return (
            f"{share}, most because the images speak against them: repeated texture or things that move. "
            "Masks (a mask/ folder beside rgb/) keep moving things out."
        )
    return f"{share}, most for too few matches that agree: record more slowly, with more overlap from frame to frame."


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
