"""frames.csv and edges.csv of a results folder: the status of each frame, the verdict of each pair of scans."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.frame_status import FrameStatus
from miniloop_cli.scene.poses import residuals
from miniloop_cli.scene.registration import Registration
from miniloop_cli.scene.tracked import TrackStatus
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.typing import Bools, Floats

FRAME_COLUMNS = tuple(
    """
    index timestamp keypoints with_depth depth_valid_share median_depth_m registered component sigma_rot_deg
    sigma_trans_m status reason found_by
    """.split()
)


def frame_rows(run: Registration) -> Iterator[Sequence[Any]]:
    """A row a frame: features, depth, uncertainty of its pose, or why it is not in the trajectory."""
    matched = np.isin(np.arange(len(run.scans)), run.scan_frames)
    for index, scan in enumerate(run.scans):
        component = int(run.poses.component[index])
        sigma = np.sqrt(np.diag(run.covariance[index]))
        known = np.isfinite(sigma).all() and component == 0
        yield (
            index,
            f"{run.sequence.frames[index].timestamp_s:.6f}",
            len(scan.features) if matched[index] else "",
            scan.features.with_depth if matched[index] else "",
            f"{scan.depth_valid_share:.4f}" if matched[index] else "",
            f"{scan.median_depth_m:.3f}" if matched[index] else "",
            int(component == 0),
            component,
            f"{np.degrees(np.linalg.norm(sigma[:3])):.4f}" if known else "",
            f"{np.linalg.norm(sigma[3:]):.5f}" if known else "",
            *frame_status(run, index),
            _found_by(run, index),
        )


def _found_by(run: Registration, index: int) -> str:
    """How a frame got its pose: matched with others, as a keyframe or as a scan, or tracked between keyframes."""
    if run.poses.component[index] < 0:
        return ""
    if run.tracking is None:
        return "matched"
    return "keyframe" if run.tracking[index] == TrackStatus.KEYFRAME else "tracked"


def frame_status(run: Registration, index: int) -> tuple[FrameStatus, str]:
    """The status of a frame, and the reason why it is not in the trajectory ("" if it is)."""
    scan, component = run.scans[index], run.poses.component
    if component[index] == 0:
        return FrameStatus.REGISTERED, ""
    if scan.problem:
        blank = run.tracking is not None and run.tracking[index] == TrackStatus.BLANK
        return FrameStatus.FEW_FEATURES if blank else FrameStatus.UNREADABLE, scan.problem
    if component[index] > 0:
        size = int((component == component[index]).sum())
        return FrameStatus.OTHER_PIECE, f"joined to {size - 1} other frames, but to none of the trajectory"
    if run.tracking is not None and run.tracking[index] == TrackStatus.FOLLOWED:
        return FrameStatus.NOT_VERIFIED, "the keyframe that it was followed from has no pose"
    features, least = scan.features, run.settings.matching.min_matches
    if features.with_depth < least:
        return FrameStatus.FEW_FEATURES, f"{len(features)} features, {features.with_depth} with depth: too few"
    own = run.edges.subset((run.edges.i == index) | (run.edges.j == index))
    if not len(own):
        return FrameStatus.NO_MATCHES, f"no other frame has {least} matches with it"
    best = int(own.inlier_count.argmax())
    said = own.reasons()[best] or Verdict(int(own.verdict[best])).label
    if len(own) == 1:
        return FrameStatus.NOT_VERIFIED, f"its only overlap was not verified ({said})"
    return FrameStatus.NOT_VERIFIED, f"none of {len(own)} overlaps was verified (best: {said})"


EDGE_COLUMNS = tuple(
    """
    i j timestamp_i timestamp_j matches inliers solver cycle verdict rejection reason rot_residual_deg trans_residual_m
    rot_sigma_deg trans_sigma_m hypotheses tx ty tz qx qy qz qw
    """.split()
)


def edge_rows(run: Registration) -> Iterator[Sequence[Any]]:
    """A row a pair with enough matches; residuals against the final poses; T_j_i as tx..qw (scan i into scan j)."""
    edges, component = run.edges, run.poses.component
    stamps = np.array([frame.timestamp_s for frame in run.sequence.frames])
    angle_deg, distance_m = residuals(edges, run.poses.T_world_cam)
    variance = np.diagonal(edges.covariance, axis1=1, axis2=2).reshape(-1, 2, 3)
    sigma = np.sqrt(np.maximum(variance, 0).sum(axis=2))
    solved = np.any(edges.information, axis=(1, 2))
    judged = solved & (component[edges.i] >= 0) & (component[edges.i] == component[edges.j])
    columns: list[Iterable[Any]] = [
        edges.i,
        edges.j,
        _numbers(stamps[edges.i], 6),
        _numbers(stamps[edges.j], 6),
        edges.match_count,
        edges.inlier_count,
        edges.solver,
        edges.cycle,
        [Verdict(int(number)).label for number in edges.verdict],
        [Rejection(int(number)).label for number in edges.rejection],
        edges.reasons(),
        _numbers(angle_deg, 4, judged),
        _numbers(distance_m, 5, judged),
        _numbers(np.degrees(sigma[:, 0]), 4, solved),
        _numbers(sigma[:, 1], 5, solved),
        edges.hypotheses,
        *(_numbers(column, 9, solved) for column in se3.to_rows(edges.T_j_i).T),
    ]
    return zip(*columns, strict=True)


def _numbers(values: Floats, digits: int, known: Bools | None = None) -> list[str]:
    """Numbers (m,) as text; "" where they are not known."""
    shown = np.ones(len(values), bool) if known is None else known
    return [f"{value:.{digits}f}" if show else "" for value, show in zip(values.tolist(), shown, strict=True)]


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A table with a header."""
    with atomic_write(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
