"""Display poses of all frames: those of the trajectory, and those of separate pieces, placed beside it."""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.upward import smallest_turn, up_direction
from miniloop_cli.results.columns import ReportData
from miniloop_cli.results.folder import column
from miniloop_cli.scene.interpolation import nearest
from miniloop_cli.typing import Bools, Floats, Ints

PIECE = re.compile(r"[0-9]{1,9}", re.ASCII)
GAP = 0.15  # between pieces, of the size of the trajectory
LEAST_SIZE_M = 1.0


@dataclass(frozen=True)
class Placed:
    """T_world_cam (n, 4, 4), NaN without a pose; piece (n,): 0 the trajectory, 1, 2 ... pieces apart, -1 no pose.

    The relative pose of the pieces is unknown: each is placed beside the one before, upright.
    """

    T_world_cam: Floats
    piece: Ints


def place(data: ReportData, leveled: bool) -> Placed:
    """The poses of trajectory.txt by frame, and those of other pieces, chained along their verified edges.

    The poses of other pieces are not refined, as no file has them. Frames that only tracking joins to such a piece have
    none.
    """
    n = len(data.frames)
    T, piece = np.full((n, 4, 4), np.nan), np.full(n, -1)
    if (data.results.root / "trajectory.txt").is_file():
        trajectory = data.results.trajectory
        rows = nearest(data.frames.timestamp_s, trajectory.timestamps_s)
        T[rows], piece[rows] = trajectory.T_world_cam, 0
    names = np.array([int(text) if PIECE.fullmatch(text) else -1 for text in data.frames.component], np.int64)
    main = T[piece == 0]
    up = up_direction(main, leveled)
    beside_m, size_m = _extent(main)
    for number in sorted(set(names[(names > 0) & (piece < 0)].tolist())):
        chained, found = _chained(data, names == number)
        if found.sum() < 2:
            continue
        own = chained[found]
        own = se3.pose(smallest_turn(up_direction(own), up), np.zeros(3)) @ own
        low, high = own[:, :3, 3].min(axis=0), own[:, :3, 3].max(axis=0)
        reach_m = max(float(np.linalg.norm(high - low)), LEAST_SIZE_M) / 2
        side = np.cross(up, main[:, :3, 2].mean(axis=0)) if len(main) else np.cross(up, [0.0, 0.0, 1.0])
        side = -side / max(float(np.linalg.norm(side)), 1e-9)  # to the right of where the cameras look
        centre = np.nanmean(main[:, :3, 3], axis=0) if len(main) else np.zeros(3)
        beside_m += GAP * size_m + reach_m
        own[:, :3, 3] += centre + beside_m * side - (low + high) / 2
        beside_m += reach_m
        T[found], piece[found] = own, number
    return Placed(T, piece)


def _extent(T: Floats) -> tuple[float, float]:
    """Extent of the model from the cameras' centre, assumed half a metre beyond the cameras, and its size."""
    if not len(T):
        return 0.0, LEAST_SIZE_M
    size_m = max(float(np.ptp(T[:, :3, 3], axis=0).max()), LEAST_SIZE_M)
    return 0.5 + size_m, size_m


def _chained(data: ReportData, member: Bools) -> tuple[Floats, Bools]:
    """(n, 4, 4) poses of the frames of one piece, its first frame's camera as world, and (n,) which have one.

    Breadth first, along the edges of the most inliers of each frame.
    """
    edges, rows = data.edges, data.results.edges
    path = data.results.root / "edges.csv"
    names = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
    motion = np.stack([column(rows, name, path) for name in names], axis=1) if rows else np.zeros((0, 7))
    whole = np.isfinite(motion).all(axis=1) & (np.linalg.norm(motion[:, 3:], axis=1) > 1e-6)
    usable = np.flatnonzero(whole & ~edges.rejected & member[edges.i] & member[edges.j])
    usable = usable[np.argsort(-np.nan_to_num(edges.inliers[usable]), kind="stable")]
    T_j_i = se3.from_rows(motion[usable])
    neighbours: dict[int, list[tuple[int, Floats]]] = {}
    for i, j, T in zip(edges.i[usable].tolist(), edges.j[usable].tolist(), T_j_i, strict=True):
        neighbours.setdefault(i, []).append((j, se3.inverse(T)))
        neighbours.setdefault(j, []).append((i, T))
    T_world_cam, found = np.full((len(member), 4, 4), np.nan), np.zeros(len(member), bool)
    if not neighbours:
        return T_world_cam, found
    first = min(neighbours)
    T_world_cam[first], found[first] = np.eye(4), True
    waiting = deque([first])
    while waiting:
        here = waiting.popleft()
        for there, T_here_there in neighbours[here]:
            if not found[there]:
                T_world_cam[there], found[there] = T_world_cam[here] @ T_here_there, True
                waiting.append(there)
    return T_world_cam, found
