"""The verdict in words: did it work, how far it can be trusted, and what to try where it did not."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.results.columns import Edges, RunColumns, edge_columns, frame_columns
from miniloop_cli.results.tables import EDGE_COLUMNS, FRAME_COLUMNS, edge_rows, frame_rows
from miniloop_cli.scene.frame_status import FrameStatus
from miniloop_cli.scene.registration import Registration
from miniloop_cli.scene.verdict import Rejection
from miniloop_cli.typing import Bools, Floats, Ints

if TYPE_CHECKING:
    from miniloop_cli.inspection.findings import Finding

GOOD_SHARE, FAILED_SHARE = 0.95, 0.5  # of the frames
LOOSE_DEG, LOOSE_M = 2.0, 0.05  # a median disagreement beyond this makes every pose doubtful
CONTRADICTING_DEG, CONTRADICTING_M = 10.0, 0.25  # a verified edge farther off is false, or the poses are
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
CONTRADICTED = 0.1  # of the size of the true path: a larger error is not noise
NEAR_M, FAR_M = 0.25, 6.0  # a median depth outside suggests a wrong scale


class Level(StrEnum):
    """How far a run can be trusted: as it is, with the doubts that are named, or not."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    BAD = "bad"


@dataclass(frozen=True)
class Assessment:
    """What a run is worth: its level, one headline, what is known, what to try (empty where nothing is wrong).

    `reasons` say why the level is not good. `findings` are of an inspection of the recording, for runs that did not go
    well.
    """

    level: Level
    headline: str
    facts: tuple[str, ...]
    advice: tuple[str, ...]
    reasons: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


def assess_run(run: Registration) -> Assessment:
    """The assessment of a run from the tables that it writes."""
    edges = [dict(zip(EDGE_COLUMNS, map(str, row), strict=True)) for row in edge_rows(run)]
    frames = [dict(zip(FRAME_COLUMNS, map(str, row), strict=True)) for row in frame_rows(run)]
    stamps_s = np.array([frame.timestamp_s for frame in run.sequence.frames])
    nowhere = Path("of this run")
    return judge(RunColumns(edge_columns(edges, nowhere), frame_columns(frames, nowhere, stamps_s), run.notes))


def judge(data: RunColumns, evaluation: Evaluation | None = None) -> Assessment:
    """The assessment of a run, and of its trajectory where a ground truth was given."""
    frames = data.frames
    total, registered = len(frames), int(frames.registered.sum())
    share = registered / total if total else 0.0
    lost, doubts = _lost(data, share), _doubts(data, evaluation)
    if share < FAILED_SHARE or registered < 2:
        level, words = Level.BAD, "It did not work"
    else:
        level = Level.DOUBTFUL if lost or doubts else Level.GOOD
        words = f"It worked{' in part' if lost else ''}{f', but {doubts[0]}' if doubts else ''}"
    headline = f"{words}: {registered} of {total} frames are registered{_pieces(data)}"
    advice = _scale_advice(data) + (_few_edges(data) if level == Level.GOOD else _advice(data, _loose(data)))
    return Assessment(level, headline, tuple(_facts(data, evaluation)), tuple(advice), (*lost, *doubts))


def _lost(data: RunColumns, share: float) -> tuple[str, ...]:
    """What is said of frames without a pose, where they are many."""
    missing = int((~data.frames.registered).sum())
    return () if share >= GOOD_SHARE else (f"{missing} of {len(data.frames)} frames are not registered",)


def _doubts(data: RunColumns, evaluation: Evaluation | None) -> tuple[str, ...]:
    """Why the poses of the registered frames are not to be trusted."""
    edges, doubts = data.edges, []
    if _contradicted(evaluation):
        doubts.append("the ground truth contradicts the poses")
    if _loose(data):
        doubts.append("the edges disagree with the poses as a whole")
    off = edges.worst_first[_far_off(edges)[edges.worst_first]]
    if len(off):
        worst = off[0]
        doubts.append(
            f"{len(off)} verified edge{'s' * (len(off) > 1)} contradict{'s' * (len(off) == 1)} the poses (the worst: "
            f"{edges.i[worst]}–{edges.j[worst]} by {edges.rot_deg[worst]:.1f} deg, {edges.trans_m[worst]:.2f} m)"
        )
    return tuple(doubts)


def _far_off(edges: Edges) -> Bools:
    """(m,) edges whose residual is no noise: they are false, or the poses are."""
    return (edges.rot_deg > CONTRADICTING_DEG) | (edges.trans_m > CONTRADICTING_M)


def _loose(data: RunColumns) -> bool:
    kept = data.edges.worst_first
    if not len(kept):
        return False
    return bool(np.median(data.edges.rot_deg[kept]) > LOOSE_DEG or np.median(data.edges.trans_m[kept]) > LOOSE_M)


def _contradicted(evaluation: Evaluation | None) -> bool:
    """Whether the poses are farther from the ground truth than any noise would take them."""
    if evaluation is None:
        return False
    true = evaluation.T_true[:, :3, 3]
    size_m = float(np.sqrt(((true - true.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return bool(evaluation.numbers["ate_rmse_m"] > max(CONTRADICTED * size_m, LOOSE_M))


def pieces(data: RunColumns) -> list[int]:
    """Sizes of the separate pieces of two frames or more, the registered one first."""
    named = [c for c in data.frames.component if c not in ("", "-1")]
    return [size for _, size in sorted(Counter(named).items(), key=lambda item: -item[1]) if size > 1]


def _pieces(data: RunColumns) -> str:
    others = pieces(data)[1:]
    if not others:
        return " in one piece." if data.frames.registered.any() else "."
    return f"; {sum(others)} more hang together in {len(others)} separate piece{'s' * (len(others) > 1)}."


def _facts(data: RunColumns, evaluation: Evaluation | None) -> list[str]:
    edges = data.edges
    facts = []
    if len(edges):
        counts = Counter(text or "unknown" for text in edges.verdict)
        listed = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        facts.append(f"{len(edges)} pairs of frames have enough matches: {listed}.")
    kept = edges.worst_first
    if len(kept):
        worst = kept[0]
        facts.append(
            f"Verified edges disagree with the final poses by {np.median(edges.rot_deg[kept]):.2f} deg and "
            f"{100 * np.median(edges.trans_m[kept]):.1f} cm (median); the worst is {edges.i[worst]}–{edges.j[worst]} "
            f"with {edges.rot_deg[worst]:.2f} deg and {100 * edges.trans_m[worst]:.1f} cm."
        )
    if evaluation:
        numbers = evaluation.numbers
        facts.append(
            f"Against the ground truth: position error {100 * numbers['ate_rmse_m']:.2f} cm RMSE, "
            f"{100 * numbers['ate_max_m']:.2f} cm at most, over {numbers['poses_with_ground_truth']} poses "
            f"({numbers['protocol']['alignment']} alignment, ground truth {numbers['protocol']['association']}d)."
        )
    facts += [f"{note[0].upper()}{note[1:]}." for note in data.prior_notes]
    facts += [
        f"{len(lost)} frame{'s' * (len(lost) > 1)} without a pose ({runs(lost)}): {reason}."
        for reason, lost in left_out(data)[:3]
    ]
    return facts


def left_out(data: RunColumns) -> list[tuple[str, Ints]]:
    """(reason, frame numbers) of the frames without a pose, the most frequent reason first.

    Frames none of whose overlaps was verified belong together: what differs between them stands in frames.csv.
    """
    reasons: dict[str, list[int]] = {}
    for k in np.flatnonzero(~data.frames.registered).tolist():
        unverified = data.frames.status[k] == FrameStatus.NOT_VERIFIED
        reason = "no overlap was verified" if unverified else data.frames.reason[k]
        reasons.setdefault(reason or "the reason is not known", []).append(k)
    return sorted(((r, np.array(k)) for r, k in reasons.items()), key=lambda item: -len(item[1]))


def _scale_advice(data: RunColumns) -> list[str]:
    depth = _median(data.frames.median_depth_m)
    if NEAR_M <= depth <= FAR_M or not np.isfinite(depth):
        return []
    words = f"The median depth is {depth:.2f} m, unusual for such a recording: check depth_scale (units a metre)"
    return [f"{words} in the camera file; a wrong scale registers well and gives a model of the wrong size."]


def _few_edges(data: RunColumns) -> list[str]:
    if len(data.edges.worst_first) >= 2 * len(data.frames):
        return []
    return ["Few edges hold the frames together: a recording that returns to known places is more accurate."]


def _advice(data: RunColumns, loose: bool) -> list[str]:
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


def runs(numbers: Ints, most: int = 12) -> str:
    """Sorted whole numbers as "3, 7–9, 12", cut off after `most` runs."""
    groups = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    words = [f"{g[0]}" if len(g) == 1 else f"{g[0]}–{g[-1]}" for g in groups[:most]]
    return ", ".join(words) + (f" and {len(groups) - most} more runs" if len(groups) > most else "")
