"""frames.csv and edges.csv of a results folder: what became of every frame, and of every pair of scans."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.poses import residuals
from miniloop_cli.scene.registration import Registration
from miniloop_cli.typing import Floats

FRAME_COLUMNS = tuple(
    """
    index timestamp keypoints with_depth depth_valid_share median_depth_m registered component sigma_rot_deg
    sigma_trans_m reason
    """.split()
)


def write_frames(run: Registration, stamps: Floats, path: Path) -> None:
    """One row a frame: features, depth, uncertainty of its pose, or why it is not in the trajectory."""

    def rows() -> Iterator[Sequence[Any]]:
        for index, scan in enumerate(run.scans):
            component = int(run.poses.component[index])
            sigma = np.sqrt(np.diag(run.covariance[index]))
            known = np.isfinite(sigma).all() and component == 0
            yield (
                index,
                f"{stamps[index]:.6f}",
                len(scan.features),
                scan.features.with_depth,
                f"{scan.depth_valid_share:.4f}",
                f"{scan.median_depth_m:.3f}",
                int(component == 0),
                component,
                f"{np.degrees(np.linalg.norm(sigma[:3])):.4f}" if known else "",
                f"{np.linalg.norm(sigma[3:]):.5f}" if known else "",
                reason(run, index),
            )

    _write_csv(path, FRAME_COLUMNS, rows())


def reason(run: Registration, index: int) -> str:
    """Why a frame is not in the trajectory; "" if it is."""
    if run.poses.component[index] == 0:
        return ""
    if run.scans[index].problem:
        return run.scans[index].problem
    if run.poses.component[index] > 0:
        size = int((run.poses.component == run.poses.component[index]).sum())
        return f"joined to {size - 1} other frames, but to none of the trajectory"
    found = run.scans[index].features
    if found.with_depth < run.settings.matching.min_matches:
        return f"{len(found)} features, {found.with_depth} with depth: too few"
    own = [edge for edge in run.edges if index in (edge.i, edge.j)]
    if not own:
        return f"no other frame has {run.settings.matching.min_matches} matches with it"
    best = max(own, key=lambda edge: edge.inlier_count)
    what = "its only overlap was not verified" if len(own) == 1 else f"none of {len(own)} overlaps was verified"
    return f"{what} ({'best: ' * (len(own) > 1)}{best.reason or best.verdict})"


EDGE_COLUMNS = tuple(
    """
    i j timestamp_i timestamp_j matches inliers solver cycle verdict reason rot_residual_deg trans_residual_m
    rot_sigma_deg trans_sigma_m hypotheses tx ty tz qx qy qz qw
    """.split()
)


def write_edges(run: Registration, stamps: Floats, path: Path) -> None:
    """One row a pair with enough matches; residuals against the final poses; T_j_i as tx..qw (scan i into scan j)."""
    angles, distances = residuals(run.edges, run.poses.T_world_cam)
    T = np.array([edge.T_j_i for edge in run.edges]).reshape(-1, 4, 4)
    poses = se3.to_rows(T)
    variance = np.array([np.diag(edge.covariance) for edge in run.edges]).reshape(-1, 2, 3)
    sigmas = np.sqrt(np.maximum(variance, 0).sum(axis=2))

    def rows() -> Iterator[Sequence[Any]]:
        numbers = angles.tolist(), distances.tolist(), sigmas.tolist(), poses.tolist()
        for edge, angle, distance, sigma, pose in zip(run.edges, *numbers, strict=True):
            component = run.poses.component[edge.i]
            judged = component >= 0 and component == run.poses.component[edge.j]
            solved = edge.information.any()
            yield (
                edge.i,
                edge.j,
                f"{stamps[edge.i]:.6f}",
                f"{stamps[edge.j]:.6f}",
                len(edge.matches),
                edge.inlier_count,
                edge.solver,
                edge.cycle,
                edge.verdict,
                edge.reason,
                f"{angle:.4f}" if judged and solved else "",
                f"{distance:.5f}" if judged and solved else "",
                f"{np.degrees(sigma[0]):.4f}" if solved else "",
                f"{sigma[1]:.5f}" if solved else "",
                edge.hypotheses,
                *(f"{value:.9f}" if solved else "" for value in pose),
            )

    _write_csv(path, EDGE_COLUMNS, rows())


def _write_csv(path: Path, header: Sequence[str], rows: Iterator[Sequence[Any]]) -> None:
    with atomic_write(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
