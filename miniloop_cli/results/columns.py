"""The tables of a results folder as arrays, for the report; a missing file or column is empty, not an error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.errors import InputError
from miniloop_cli.results.folder import Results, column
from miniloop_cli.results.rejected_matches import Matches, read_rejected
from miniloop_cli.results.stored_arrays import read_covariances, read_inliers
from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.scene.sequence import Sequence as Recording
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.typing import Bools, Floats, Ints

Rows = Sequence[dict[str, str]]
KINDS = tuple(NoteKind)


@dataclass(frozen=True)
class Edges:
    """Columns of edges.csv, one entry an edge: frame numbers i < j; residuals NaN where there are none."""

    i: Ints
    j: Ints
    matches: Floats
    inliers: Floats
    rot_deg: Floats
    trans_m: Floats
    solver: list[str]
    cycle: list[str]
    verdict: list[str]
    rejection: list[str]
    reason: list[str]

    def __len__(self) -> int:
        return len(self.i)

    @cached_property
    def rejected(self) -> Bools:
        """(m,) whether an edge was rejected."""
        return np.array([text == Verdict.REJECTED.label for text in self.verdict], bool)

    @cached_property
    def verified(self) -> Bools:
        """(m,) whether an edge belongs to the graph that determines the poses."""
        return np.array([text in (Verdict.VERIFIED.label, "") for text in self.verdict], bool)

    @cached_property
    def by_residual(self) -> Ints:
        """Rows (m,) of all edges by falling residual, those without one last; 1 degree counts as 2 cm."""
        score = self.rot_deg + 50 * self.trans_m
        return np.argsort(-np.where(np.isfinite(score), score, -1.0), kind="stable")

    @cached_property
    def worst_first(self) -> Ints:
        """Rows (k,) of verified edges that have residuals, the largest first."""
        order = self.by_residual
        return order[self.verified[order] & np.isfinite(self.rot_deg + self.trans_m)[order]]


@dataclass(frozen=True)
class Frames:
    """Columns of frames.csv, one entry a frame; NaN where a value is not known. The sigmas are of the pose."""

    timestamp_s: Floats
    keypoints: Floats
    with_depth: Floats
    depth_valid_share: Floats
    median_depth_m: Floats
    sigma_rot_deg: Floats
    sigma_trans_m: Floats
    registered: Bools
    component: list[str]
    status: list[str]
    reason: list[str]
    found_by: list[str]

    def __len__(self) -> int:
        return len(self.timestamp_s)


@dataclass(frozen=True)
class RunColumns:
    """The tables of a run, and the notes on its recording and its priors."""

    edges: Edges
    frames: Frames
    notes: Sequence[Note] = ()

    def noted(self, kind: NoteKind) -> list[str]:
        """The notes of one kind."""
        return [note.text for note in self.notes if note.kind == kind]


@dataclass(frozen=True)
class ReportData:
    """A run, loaded for display. `inlier_px`: edge number to the (k, 2) measured pixels of its inliers in i and in j.

    `covariance` (n, 6, 6): of every frame's (w, v) in T_world_cam(true) = T_world_cam [exp(w) | v], NaN where it is not
    known; None without the file. `rejected_px`: some matches of rejected edges, from `read_rejected`.
    """

    results: Results
    sequence: Recording | None
    edges: Edges
    frames: Frames
    inlier_px: dict[int, tuple[Floats, Floats]] = field(default_factory=dict)
    covariance: Floats | None = None
    rejected_px: dict[int, Matches] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.sequence.name if self.sequence else self.results.root.resolve().name

    @property
    def summary(self) -> dict[str, Any]:
        return self.results.summary

    @property
    def columns(self) -> RunColumns:
        """The tables as columns."""
        return RunColumns(self.edges, self.frames, self._notes())

    def _notes(self) -> list[Note]:
        """The valid notes of the summary, as others may have changed the file."""
        found = self.summary.get("notes")
        rows = [row for row in found if isinstance(row, dict)] if isinstance(found, list) else []
        pairs = [(row.get("kind"), row.get("text")) for row in rows]
        return [Note(NoteKind(kind), text) for kind, text in pairs if kind in KINDS and isinstance(text, str) and text]

    def text(self, name: str, limit: int = 20_000) -> str:
        """The end of a text file of the folder, "" without it."""
        path = self.results.root / name
        if not path.is_file():
            return ""
        text = path.read_bytes()[-limit:].decode("utf-8", "replace")
        return text if path.stat().st_size <= limit else "[...]\n" + text.partition("\n")[2]


def load(results_dir: Path, sequence: Recording | None = None) -> ReportData:
    """Read a results folder. Raises InputError if a file in it is malformed."""
    results = Results(Path(results_dir))
    edges, frames = read_edges(results), read_frames(results)
    if len(edges) and max(edges.i.max(), edges.j.max()) >= len(frames):
        raise InputError(f"{results.root / 'edges.csv'} names frames beyond the {len(frames)} of frames.csv")
    covariance = read_covariances(results.root, len(frames))
    inliers, rejected = read_inliers(results.root, len(edges)), read_rejected(results.root, len(edges))
    return ReportData(results, sequence, edges, frames, inliers, covariance, rejected)


def read_edges(results: Results) -> Edges:
    """edges.csv as columns."""
    return edge_columns(results.edges, results.root / "edges.csv")


def edge_columns(rows: Rows, path: Path) -> Edges:
    """Rows of edges.csv as columns; `path` is named where they are malformed."""
    return Edges(
        i=whole(column(rows, "i", path), path),
        j=whole(column(rows, "j", path), path),
        matches=column(rows, "matches", path),
        inliers=column(rows, "inliers", path),
        rot_deg=column(rows, "rot_residual_deg", path),
        trans_m=column(rows, "trans_residual_m", path),
        solver=texts(rows, "solver"),
        cycle=texts(rows, "cycle"),
        verdict=texts(rows, "verdict"),
        rejection=texts(rows, "rejection"),
        reason=texts(rows, "reason"),
    )


def read_frames(results: Results) -> Frames:
    """frames.csv as columns; without it, the frames of the trajectory, with other columns empty."""
    rows, path = results.frames, results.root / "frames.csv"
    if not rows:
        stamps_s = results.trajectory.timestamps_s
        rows = [{"registered": "1", "component": "0"} for _ in stamps_s]
        return frame_columns(rows, path, stamps_s)
    return frame_columns(rows, path, results.frame_stamps_s)


def frame_columns(rows: Rows, path: Path, stamps_s: Floats) -> Frames:
    """Rows of frames.csv as columns, with stamps (n,); `path` is named where they are malformed."""
    return Frames(
        timestamp_s=stamps_s,
        keypoints=column(rows, "keypoints", path),
        with_depth=column(rows, "with_depth", path),
        depth_valid_share=column(rows, "depth_valid_share", path),
        median_depth_m=column(rows, "median_depth_m", path),
        sigma_rot_deg=column(rows, "sigma_rot_deg", path),
        sigma_trans_m=column(rows, "sigma_trans_m", path),
        registered=np.array([text.lower() in ("1", "true", "yes") for text in texts(rows, "registered")], bool),
        component=texts(rows, "component"),
        status=texts(rows, "status"),
        reason=texts(rows, "reason"),
        found_by=texts(rows, "found_by"),
    )


def texts(rows: Rows, name: str) -> list[str]:
    """A column as text, "" where it is missing."""
    return [row.get(name, "") for row in rows]


def whole(values: Floats, path: Path) -> Ints:
    """(n,) frame numbers. Raises InputError for a negative, fractional or missing one."""
    if not (np.isfinite(values).all() and (values >= 0).all() and (values % 1 == 0).all() and (values < 2**31).all()):
        raise InputError(f"{path}: columns i and j must be frame numbers, whole and from 0")
    return values.astype(np.int64)
