"""Advice for runs that did not succeed, from their frames and edges."""

from __future__ import annotations

import numpy as np

from miniloop_cli.results.columns import Edges, RunColumns
from miniloop_cli.results.facts import pieces
from miniloop_cli.scene.verdict import Rejection
from miniloop_cli.typing import Floats

FEW_KEYPOINTS, FEW_READINGS = 300, 0.35
# The images or other edges contradict an edge that is rejected for one of these reasons.
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
MOSTLY_REJECTED = 0.8  # chance matches cause many rejected pairs in good recordings as well
NEAR_M, FAR_M = 0.25, 6.0  # a median depth outside suggests a wrong scale


def advice(data: RunColumns, good: bool, loose: bool) -> list[str]:
    """What to try; `good`: no doubts about the run; `loose`: its edges disagree with the poses as a whole."""
    return _scale_advice(data) + (_few_edges(data) if good else _troubles(data, loose))


def _scale_advice(data: RunColumns) -> list[str]:
    depth = _median(data.frames.median_depth_m)
    if NEAR_M <= depth <= FAR_M or not np.isfinite(depth):
        return []
    words = f"The median depth of {depth:.2f} m is unusual: check depth_scale (units a metre) in the camera file."
    return [f"{words} With a wrong scale, registration succeeds, but the model has the wrong size."]


def _few_edges(data: RunColumns) -> list[str]:
    matched = int(np.isfinite(data.frames.keypoints).sum())  # tracked frames that are not keyframes have no edges
    if len(data.edges.worst_first) >= 2 * matched:
        return []
    return ["Few edges join the frames: a recording that returns to known places is more accurate."]


def _troubles(data: RunColumns, loose: bool) -> list[str]:
    """What to try after a failure, from the frames and edges."""
    frames, edges, advice = data.frames, data.edges, []
    if _median(frames.keypoints) < FEW_KEYPOINTS:
        advice.append(
            f"The frames have few features (median {_median(frames.keypoints):.0f}): more light, a slower camera and "
            "more texture help. Another detector (--features orb) or --config accurate may help as well."
        )
    if _median(frames.depth_valid_share) < FEW_READINGS:
        advice.append(
            f"Only {100 * _median(frames.depth_valid_share):.0f} % of the pixels have depth: stay within the sensor's "
            "range, and check the depth folder."
        )
    if not frames.registered.all() and len(pieces(data)) > 1:
        advice.append(
            "No verified edge joins the pieces: record frames that show parts of both, or use more frames "
            "(--max-frames) where the camera moved fast."
        )
    if len(edges) and edges.rejected.mean() > MOSTLY_REJECTED:
        advice.append(_why_rejected(edges))
    if len(frames) > 2 and not len(edges):
        advice.append("No two frames share enough matches: neighbouring frames should share a third of their view.")
    if loose:
        advice.append(
            "The disagreement is far above a depth camera's noise: check the camera (focal length, distortion, "
            "depth_scale), and whether depth is registered to colour (`miniloop inspect`)."
        )
    return advice


def _why_rejected(edges: Edges) -> str:
    """Advice for the reason of most rejected pairs."""
    reasons = [rejection for rejection, out in zip(edges.rejection, edges.rejected, strict=True) if out]
    against = sum(rejection in SPOKEN_AGAINST for rejection in reasons)
    share = f"{100 * edges.rejected.mean():.0f} % of the pairs were rejected"
    if 2 * against > len(reasons):
        return (
            f"{share}, most because the images contradict them: texture repeats, or something moves. "
            "Masks (a mask/ folder beside rgb/) exclude what moves."
        )
    return f"{share}, most because too few matches agree: record more slowly, so that frames overlap more."


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
