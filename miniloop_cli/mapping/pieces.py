"""Pieces of a map: recordings that are joined, and the poses of their keyframes before the joint refinement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.scene_map import MapPart
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Floats, Ints, Pair

MIN_JOINING = 3  # verified edges, of as many keyframes each, that join recordings; fewer may be chance


def as_one_table(counts: Sequence[int], own: Sequence[EdgeTable], between: Mapping[Pair, EdgeTable]) -> EdgeTable:
    """All edges, within recordings (of so many keyframes) and between them, numbered through the map."""
    first = np.cumsum([0, *counts])
    tables = [replace(table, i=table.i + start, j=table.j + start) for table, start in zip(own, first, strict=False)]
    for (a, b), table in between.items():
        shift = np.array([first[a], first[b] - counts[a]])
        tables.append(replace(table, i=table.i + shift[0], j=table.j + shift[1]))
    return EdgeTable.concatenated(tables) if tables else EdgeTable.of([])


def pieces_of(between: EdgeTable, of_part: Ints, count: int, component: Ints) -> Ints:
    """(count,) the piece of each recording; 0 is that with most keyframes.

    between: verified edges between recordings, of_part (K,) the recording and component (K,) the component of each
    keyframe. Two recordings are joined by MIN_JOINING edges that lie in one component.
    """
    together = component[between.i] == component[between.j]
    ends = np.sort(of_part[between.pairs[together]], axis=1)
    pairs = []
    for pair in np.unique(ends, axis=0):
        rows = between.pairs[together][(ends == pair).all(axis=1)]
        if min(len(np.unique(rows[:, 0])), len(np.unique(rows[:, 1]))) >= MIN_JOINING:
            pairs.append(pair)
    return by_size(components(count, np.array(pairs, np.int64).reshape(-1, 2)), of_part)


def by_size(label: Ints, of_part: Ints) -> Ints:
    """(r,) pieces of recordings, numbered by falling number of keyframes; label (r,) any numbers, of_part (K,)."""
    label = np.unique(label, return_inverse=True)[1]
    size = np.bincount(label[of_part], minlength=label.max(initial=-1) + 1)
    first = np.array([np.flatnonzero(label == k)[0] for k in range(len(size))])
    rank = np.empty(len(size), np.int64)
    rank[np.lexsort((first, -size))] = np.arange(len(size))
    return rank[label]


def whole_recordings(T_own: Floats, poses: Poses, inside: Ints, of_part: Ints) -> Floats:
    """Poses (K, 4, 4) of the keyframes inside (k,) a piece; lost keyframes keep their motion within their recording.

    T_own (K, 4, 4): poses of the keyframes in the worlds of their recordings. A lost keyframe keeps its motion to the
    nearest one of its recording that has a pose.
    """
    numbers = poses.component[inside]
    main = np.bincount(numbers[numbers >= 0]).argmax()
    T = poses.T_world_cam.copy()
    for part in np.unique(of_part[inside]):
        own = inside[of_part[inside] == part]
        placed = own[poses.component[own] == main]
        for lost in np.setdiff1d(own, placed):
            near = placed[np.abs(placed - lost).argmin()]
            T[lost] = poses.T_world_cam[near] @ se3.inverse(T_own[near]) @ T_own[lost]
    return T


def in_the_first_world(T_world_cam: Floats, first: MapPart) -> Floats:
    """Poses (m, 4, 4) of a piece, moved so that its first recording is nearest to its own poses."""
    return moved_onto(T_world_cam[: len(first)], first.T_world_key) @ T_world_cam


def moved_onto(now: Floats, where: Floats) -> Floats:
    """(4, 4) the motion that aligns poses (m, 4, 4) best to others (m, 4, 4)."""
    R = se3.project_so3((where[:, :3, :3] @ np.swapaxes(now[:, :3, :3], 1, 2)).sum(axis=0))
    return se3.pose(R, (where[:, :3, 3] - now[:, :3, 3] @ R.T).mean(axis=0))
