"""Impossible motion: steps of the path that are much larger than the steps around them.

Scans of a recording follow each other in time, and hands do not jump. A jump in the path means that places that look
alike were confused, or that the recording was cut. The step is checked again with both scans and their neighbours. It
is accepted only if they overlap after it and look the same there, and if no hypothesis gives a small step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from miniloop_cli.config import Averaging
from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import residuals
from miniloop_cli.typing import Bools, Floats, Ints
from miniloop_cli.verification.photometric_check import PhotometricCheck, agreement_ratio

AROUND = 6  # steps on either side that a step is compared with
MIN_AROUND = 4  # needed to judge a step
USUAL = 0.75  # quantile of their speeds: a step is no jump if half of the steps around it are fast
OUT_OF_PROPORTION = 5.0  # times the usual speed
NEVER_DEG, NEVER_DEPTHS = 20.0, 0.3  # steps below are never doubted: degrees, and the distance as a share of the depth
GAP = 3.0  # times the usual time between frames: longer gaps allow any motion
MIN_CELLS, MIN_AGREEING = 60, 0.7  # compared cells of a step, and the share of them that must agree


@dataclass(frozen=True)
class Step:
    """A doubted step from scan a to scan b: its size, the usual size in this time, and the reason of the doubt.

    `contested`: views or matches agree with a step of usual size; else no common view confirms the step.
    """

    a: int
    b: int
    angle_deg: float
    distance_m: float
    usual_deg: float
    usual_m: float
    contested: bool

    def sentence(self, frames: Ints) -> str:
        """The doubt in words; `frames` (n,): the frame number of each scan."""
        why = (
            "their images also agree with a step of the usual size"
            if self.contested
            else "no matches between them confirm it"
        )
        return (
            f"between frames {frames[self.a]} and {frames[self.b]} the path turns by {self.angle_deg:.0f} deg and "
            f"moves by {self.distance_m:.2f} m; {self.usual_deg:.1f} deg and {self.usual_m:.2f} m are usual there in "
            f"this time; {why}"
        )


def impossible_steps(
    T_world_cam: Floats,
    scans: Ints,
    stamps_s: Floats,
    gaps: Bools,
    depth_m: float,
    edges: Sequence[EdgeTable],
    settings: Averaging,
    photometric: PhotometricCheck | None,
) -> list[Step]:
    """The doubted steps between successive ones of `scans`, ascending in time.

    T_world_cam (n, 4, 4) and stamps_s (n,) of all scans; `gaps` (n,): a gap in time precedes this scan; `depth_m`: a
    usual depth. `edges`: tables of hypotheses about pairs of scans, accepted or not.
    """
    angle_deg, distance_m, time_s = step_sizes(T_world_cam, scans, stamps_s)
    judged = ~np.array([gaps[a + 1 : b + 1].any() for a, b in pairwise(scans)], bool)
    usual_deg, usual_m = usual(angle_deg, time_s, judged), usual(distance_m, time_s, judged)
    least_deg = np.maximum(OUT_OF_PROPORTION * usual_deg, NEVER_DEG)
    least_m = np.maximum(OUT_OF_PROPORTION * usual_m, NEVER_DEPTHS * depth_m)
    doubted = []
    for k in np.flatnonzero(judged & ((angle_deg > least_deg) | (distance_m > least_m))):
        a, b = int(scans[k]), int(scans[k + 1])
        before, after = scans[:k][-1:].tolist(), scans[k + 2 :][:1].tolist()
        around = [(a, b), *((scan, b) for scan in before), *((a, scan) for scan in after)]
        limit = float(least_deg[k]), float(least_m[k])
        contested = any(_small_steps(table, around, T_world_cam, limit, settings, photometric) for table in edges)
        if contested or not _seen(around, T_world_cam, photometric):
            doubted.append(Step(a, b, angle_deg[k], distance_m[k], usual_deg[k], usual_m[k], contested))
    return doubted


def step_sizes(T_world_cam: Floats, scans: Ints, stamps_s: Floats) -> tuple[Floats, Floats, Floats]:
    """Degrees, metres and seconds (m - 1,) from each of `scans` (m,) to the next one.

    T_world_cam (n, 4, 4), stamps_s (n,) of all scans.
    """
    T, stamps_s = T_world_cam[scans], stamps_s[scans]
    step = se3.inverse(T[:-1]) @ T[1:]
    return *se3.angle_and_distance(step), np.diff(stamps_s)


def usual(size: Floats, time_s: Floats, judged: Bools) -> Floats:
    """The size (n,) that each step would have at the usual speed of its neighbours; infinite if these are too few.

    Steps of `size` (n,), degrees or metres, in `time_s` (n,); only those `judged` (n,) count as neighbours.
    """
    out = np.full(len(size), np.inf)
    speed = size / np.maximum(time_s, 1e-9)
    for k in range(len(size)):
        others = np.r_[max(k - AROUND, 0) : k, k + 1 : min(k + 1 + AROUND, len(size))]
        others = others[judged[others]]
        if len(others) >= MIN_AROUND:
            out[k] = np.quantile(speed[others], USUAL) * time_s[k]
    return out


def gaps_before(stamps_s: Floats) -> Bools:
    """(n,) whether the time since the frame before is a gap, for sorted stamps_s (n,)."""
    time_s = np.diff(stamps_s, prepend=stamps_s[:1])
    return time_s > GAP * float(np.median(time_s[1:])) if len(stamps_s) > 1 else np.zeros(len(stamps_s), bool)


def _seen(pairs: Sequence[tuple[int, int]], T_world_cam: Floats, photometric: PhotometricCheck | None) -> bool:
    """Whether the views of these pairs overlap by their poses, and look the same there."""
    if photometric is None:
        return True
    which = np.array(pairs, np.int64)
    votes = photometric.votes(which, se3.inverse(T_world_cam[which[:, 1]]) @ T_world_cam[which[:, 0]]).sum(axis=0)
    return bool(votes.sum() >= MIN_CELLS and agreement_ratio(votes) >= MIN_AGREEING)


def _small_steps(
    edges: EdgeTable,
    pairs: Sequence[tuple[int, int]],
    T_world_cam: Floats,
    limit: tuple[float, float],
    settings: Averaging,
    photometric: PhotometricCheck | None,
) -> bool:
    """Whether a hypothesis about one of the pairs contradicts the poses and is a step within the `limit` (deg, m)."""
    wanted = {(min(pair), max(pair)) for pair in pairs}
    rows = np.flatnonzero([pair in wanted for pair in map(tuple, edges.pairs.tolist())] if len(edges) else [])
    rows = rows[edges.inlier_count[rows] > 0]
    if not len(rows):
        return False
    chosen = edges.subset(rows)
    off_deg, off_m = residuals(chosen, T_world_cam)
    T = chosen.T_j_i
    small = se3.rotation_angle_deg(T[:, :3, :3]) <= limit[0]
    small &= np.linalg.norm(T[:, :3, 3], axis=1) <= limit[1]
    small &= (off_deg > settings.max_residual_deg) | (off_m > settings.max_residual_m)
    if photometric is not None and small.any():
        small[small] = agreement_ratio(photometric.votes(chosen.pairs[small], T[small])) >= MIN_AGREEING
    return bool(small.any())
