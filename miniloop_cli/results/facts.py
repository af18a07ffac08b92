"""Facts on a run, as sentences: edges, residuals, errors, and the frames without a pose."""

from __future__ import annotations

from collections import Counter

import numpy as np

from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.results.columns import RunColumns
from miniloop_cli.scene.frame_status import FrameStatus
from miniloop_cli.scene.sequence import NoteKind
from miniloop_cli.typing import Ints

# Notes that are facts on the result.
SAID = (NoteKind.PRIOR, NoteKind.PROVEN, NoteKind.UNPROVEN, NoteKind.IMPOSSIBLE_MOTION, NoteKind.AMBIGUOUS)


def facts(data: RunColumns, evaluation: Evaluation | None) -> list[str]:
    """Sentences on a run, and on its trajectory if there is a ground truth."""
    edges = data.edges
    said = []
    if len(edges):
        counts = Counter(text or "unknown" for text in edges.verdict)
        listed = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        pairs = "1 pair of frames has" if len(edges) == 1 else f"{len(edges)} pairs of frames have"
        said.append(f"{pairs} enough matches: {listed}.")
    kept = edges.worst_first
    if len(kept):
        worst = kept[0]
        said.append(
            f"Verified edges disagree with the final poses by {np.median(edges.rot_deg[kept]):.2f} deg and "
            f"{100 * np.median(edges.trans_m[kept]):.1f} cm (median); the worst is {edges.i[worst]}–{edges.j[worst]} "
            f"with {edges.rot_deg[worst]:.2f} deg and {100 * edges.trans_m[worst]:.1f} cm."
        )
    if evaluation:
        numbers = evaluation.numbers
        said.append(
            f"Against the ground truth: position error {100 * numbers['ate_rmse_m']:.2f} cm RMSE, "
            f"{100 * numbers['ate_max_m']:.2f} cm at most, over {numbers['poses_with_ground_truth']} poses "
            f"({numbers['protocol']['alignment']} alignment, ground truth {numbers['protocol']['association']}d)."
        )
    told = [text for kind in SAID for text in data.noted(kind)]
    said += [f"{text[0].upper()}{text[1:]}." for text in told]
    said += [
        f"{len(lost)} frame{'s' * (len(lost) > 1)} without a pose ({runs(lost)}): {reason}."
        for reason, lost in left_out(data)[:3]
    ]
    return said


def pieces(data: RunColumns) -> list[int]:
    """Sizes of the separate pieces of two frames or more, the registered one first."""
    named = [c for c in data.frames.component if c not in ("", "-1")]
    return [size for _, size in sorted(Counter(named).items(), key=lambda item: -item[1]) if size > 1]


def left_out(data: RunColumns) -> list[tuple[str, Ints]]:
    """(reason, frame numbers) of the frames without a pose, the most frequent reason first.

    Frames without a verified edge have one common reason here; frames.csv has the details.
    """
    reasons: dict[str, list[int]] = {}
    for k in np.flatnonzero(~data.frames.registered).tolist():
        unverified = data.frames.status[k] == FrameStatus.NOT_VERIFIED
        reason = "no edge was verified" if unverified else data.frames.reason[k]
        reasons.setdefault(reason or "the reason is not known", []).append(k)
    return sorted(((r, np.array(k)) for r, k in reasons.items()), key=lambda item: -len(item[1]))


def runs(numbers: Ints, most: int = 12) -> str:
    """Sorted whole numbers (n,) as "3, 7–9, 12", cut off after `most` runs."""
    groups = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    words = [f"{g[0]}" if len(g) == 1 else f"{g[0]}–{g[-1]}" for g in groups[:most]]
    return ", ".join(words) + (f" and {len(groups) - most} more runs" if len(groups) > most else "")
