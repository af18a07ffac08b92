"""From keyframes to all frames of a recording and back."""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import replace

import numpy as np

from miniloop_cli.scene.edge import FOLLOWED, Edge, EdgeTable
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.features import NO_FEATURES
from miniloop_cli.scene.priors import Priors
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.scene.tracked import Tracked, TrackStatus
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.typing import Floats, Ints


def keyframes_only(sequence: Sequence, keyframes: Ints) -> Sequence:
    """The recording with the frames keyframes (K,) alone."""
    return replace(sequence, frames=tuple(sequence.frames[k] for k in keyframes))


def priors_of(priors: Priors, keyframes: Ints) -> Priors:
    """The priors of the frames keyframes (K,)."""
    accelerometer, T = priors.accelerometer, priors.T_world_cam
    of_keyframes = replace(accelerometer, up=accelerometer.up[keyframes]) if accelerometer else None
    return Priors(of_keyframes, None if T is None else T[keyframes], priors.notes)


def priors_among(priors: Priors, rows: Ints, n: int) -> Priors:
    """The priors of n frames, known for rows (k,) and unknown for the others."""

    def spread(known: Floats) -> Floats:
        whole = np.full((n, *known.shape[1:]), np.nan)
        whole[rows] = known
        return whole

    accelerometer, T = priors.accelerometer, priors.T_world_cam
    of_all = replace(accelerometer, up=spread(accelerometer.up)) if accelerometer else None
    return Priors(of_all, None if T is None else spread(T), priors.notes)


def with_followed(edges: EdgeTable, tracked: Tracked) -> EdgeTable:
    """The edges, and edges from tracked points between neighbouring keyframes that no verified edge joins."""
    keyframes = tracked.keyframes
    row = np.full(len(tracked), -1)
    row[keyframes] = np.arange(len(keyframes))
    verified = set(map(tuple, edges.pairs[edges.verified].tolist()))
    more = []
    for j in np.flatnonzero(tracked.determined[keyframes]).tolist():
        frame = keyframes[j]
        i = int(row[tracked.key[frame]])
        if (i, j) in verified:
            continue
        more.append(
            Edge(
                i,
                j,
                np.zeros((0, 2), np.int64),
                np.zeros(0, bool),
                tracked.T_cam_key[frame],
                tracked.information[frame],
                np.linalg.pinv(tracked.information[frame]),
                solver=FOLLOWED,
                verdict=Verdict.VERIFIED,
                rejection=Rejection.NONE,
                confirmed=True,
                followed=max(int(tracked.support[frame]), 1),  # the weight in averaging
            )
        )
    return edges.replaced(more) if more else edges


def in_frames(edges: EdgeTable, keyframes: Ints) -> EdgeTable:
    """Edges between keyframes as edges between frames; keyframes (K,) are the frame numbers."""
    return replace(edges, i=keyframes[edges.i], j=keyframes[edges.j])


def of_all_frames(keyframes: Many[ExtractedScan], tracked: Tracked) -> list[ExtractedScan]:
    """One row a frame: the extracted keyframes; other frames have no features, and the reason if they are unusable."""
    found = iter(keyframes)
    nothing = ExtractedScan(NO_FEATURES, None, np.nan, np.nan, "")
    return [
        next(found) if status == TrackStatus.KEYFRAME else replace(nothing, problem=problem)
        for status, problem in zip(tracked.status.tolist(), tracked.problem.tolist(), strict=True)
    ]
