"""The verdict in words: whether the run succeeded, how far it can be trusted, and what to try otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.results.advice import advice
from miniloop_cli.results.columns import Edges, RunColumns, edge_columns, frame_columns
from miniloop_cli.results.facts import facts, pieces
from miniloop_cli.results.tables import EDGE_COLUMNS, FRAME_COLUMNS, edge_rows, frame_rows
from miniloop_cli.scene.edge import FOLLOWED
from miniloop_cli.scene.registration import Registration
from miniloop_cli.scene.sequence import NoteKind
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Bools

if TYPE_CHECKING:
    from miniloop_cli.inspection.findings import Finding

GOOD_SHARE, FAILED_SHARE = 0.95, 0.5  # of the frames
LOOSE_DEG, LOOSE_M = 2.0, 0.05  # a median disagreement beyond this makes every pose doubtful
CONTRADICTING_DEG, CONTRADICTING_M = 10.0, 0.25  # a verified edge farther off is false, or the poses are
DOUBTFUL_NOTES = {
    NoteKind.CONTRADICTED: "the recording contradicts what was assumed about it",
    NoteKind.MOST_DROPPED: "most images of the recording are not used",
    NoteKind.IMPOSSIBLE_MOTION: "the path makes a step that is much larger than those before and after it",
    NoteKind.AMBIGUOUS: "some frames fit at another place nearly as well",
    NoteKind.UNPROVEN: "the averaged poses are not proven to be the best fit to the edges",
}
CONTRADICTED = 0.1  # of the size of the true path: a larger error is not noise


class Level(StrEnum):
    """How far a run can be trusted: fully, with the named doubts, or not at all."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    BAD = "bad"


@dataclass(frozen=True)
class Assessment:
    """The assessment of a run: its level, one headline, facts, and advice (empty if nothing is wrong).

    `reasons`: why the level is not good. `findings`: of an inspection of the recording, for runs that are not good.
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
    columns = edge_columns(edges, nowhere), frame_columns(frames, nowhere, stamps_s)
    return judge(RunColumns(*columns, run.notes))


def judge(data: RunColumns, evaluation: Evaluation | None = None) -> Assessment:
    """The assessment of a run, and of its trajectory if there is a ground truth."""
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
    tried = advice(data, level == Level.GOOD, _loose(data))
    return Assessment(level, headline, tuple(facts(data, evaluation)), tuple(tried), (*lost, *doubts))


def _lost(data: RunColumns, share: float) -> tuple[str, ...]:
    """A reason if many frames have no pose."""
    missing = int((~data.frames.registered).sum())
    return () if share >= GOOD_SHARE else (f"{missing} of {len(data.frames)} frames are not registered",)


def _doubts(data: RunColumns, evaluation: Evaluation | None) -> tuple[str, ...]:
    """Reasons to doubt the poses of the registered frames."""
    edges, doubts = data.edges, []
    if _contradicted(evaluation):
        doubts.append("the ground truth contradicts the poses")
    for kind, doubt in DOUBTFUL_NOTES.items():
        if texts := data.noted(kind):
            doubts += [doubt, *texts]
    if carried := _followed_only(edges):
        doubts.append(
            f"{carried} keyframes are joined to the others by tracking alone: no matches confirm it, and errors of "
            "tracking accumulate"
        )
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


def _followed_only(edges: Edges) -> int:
    """Number of keyframes that no chain of matched frames joins to most of the others; 0 if these are few."""
    followed = np.array([solver == FOLLOWED for solver in edges.solver], bool)
    frames, ends = np.unique(np.stack([edges.i, edges.j], axis=1)[edges.verified], return_inverse=True)
    if not (followed & edges.verified).any():
        return 0
    pairs = ends.reshape(-1, 2)[~followed[edges.verified]]
    carried = int((components(len(frames), pairs) != 0).sum())
    return carried if carried > (1 - GOOD_SHARE) * len(frames) else 0


def _far_off(edges: Edges) -> Bools:
    """(m,) edges whose residual is too large for noise: they or the poses are wrong."""
    return (edges.rot_deg > CONTRADICTING_DEG) | (edges.trans_m > CONTRADICTING_M)


def _loose(data: RunColumns) -> bool:
    kept = data.edges.worst_first
    if not len(kept):
        return False
    return bool(np.median(data.edges.rot_deg[kept]) > LOOSE_DEG or np.median(data.edges.trans_m[kept]) > LOOSE_M)


def _contradicted(evaluation: Evaluation | None) -> bool:
    """Whether the poses are farther from the ground truth than noise explains."""
    if evaluation is None:
        return False
    true = evaluation.T_true[:, :3, 3]
    size_m = float(np.sqrt(((true - true.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return bool(evaluation.numbers["ate_rmse_m"] > max(CONTRADICTED * size_m, LOOSE_M))


def _pieces(data: RunColumns) -> str:
    others = pieces(data)[1:]
    if not others:
        return " in one piece." if data.frames.registered.any() else "."
    return f"; {sum(others)} more form {len(others)} separate piece{'s' * (len(others) > 1)}."
