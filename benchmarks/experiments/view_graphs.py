"""View graphs with known poses: what motion averaging is measured on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry.se3 import exp_so3, inverse, pose
from miniloop_cli.typing import Bools, Floats, Ints

KINDS = ("video", "expander")


@dataclass(frozen=True)
class ViewGraph:
    """Poses `T_world_cam` (n, 4, 4), and noisy edges `pairs` (m, 2), `T_j_i` (m, 4, 4); `false` (m,) the outliers."""

    T_world_cam: Floats
    pairs: Ints
    T_j_i: Floats
    false: Bools


def view_graph(
    kind: str, scans: int, edges: int, outliers: float, noise_deg: float, noise_m: float, rng: np.random.Generator
) -> ViewGraph:
    """A connected view graph of `edges` edges, a share `outliers` of them with a random relative pose.

    `video`: a hand-held camera wanders through a flat world; four edges in five join neighbours in time, the others
    close loops between near and similar views; every second outlier joins two random scans instead.
    `expander`: random pairs, random poses. Noise: `noise_deg`, `noise_m` standard deviations along each axis.
    """
    if kind not in KINDS:
        raise ConfigError(f"view graphs are of kind {' or '.join(KINDS)}, not {kind!r}")
    most = scans * (scans - 1) // 2
    if scans < 2 or not scans - 1 <= edges <= most:
        raise ConfigError(f"{scans} scans need at least 2 scans and {scans - 1} to {most} edges, not {edges}")
    if not 0 <= outliers < 1:
        raise ConfigError(f"outliers are a share of the edges in [0, 1), not {outliers}")
    T_world_cam = _walk(scans, rng) if kind == "video" else _random_poses(scans, rng)
    pairs = _video_pairs(T_world_cam, edges, rng) if kind == "video" else _random_pairs(scans, edges, rng)
    false = np.zeros(edges, dtype=bool)
    false[rng.choice(edges, round(outliers * edges), replace=False)] = True
    if kind == "video":
        rewired = false & (rng.random(edges) < 0.5) & (np.diff(pairs, axis=1)[:, 0] > 1)
        pairs[rewired] = np.sort((pairs[rewired, :1] + [0, 1] * rng.integers(1, scans, (rewired.sum(), 2))) % scans)
    i, j = pairs.T
    T_j_i = inverse(T_world_cam[j]) @ T_world_cam[i]
    T_j_i[:, :3, :3] = exp_so3(np.radians(noise_deg) * rng.standard_normal((edges, 3))) @ T_j_i[:, :3, :3]
    T_j_i[:, :3, 3] += noise_m * rng.standard_normal((edges, 3))
    T_j_i[false] = _random_poses(int(false.sum()), rng)
    return ViewGraph(T_world_cam, pairs, T_j_i, false)


def _random_poses(count: int, rng: np.random.Generator) -> Floats:
    """Uniform rotations, translations of a few metres."""
    q = rng.standard_normal((count, 4))
    w, v = q[:, 0], q[:, 1:]
    length = np.linalg.norm(v, axis=1)
    R = exp_so3(v / length[:, None] * 2 * np.arctan2(length, w)[:, None])
    return pose(R, 2.0 * rng.standard_normal((count, 3)))


def _walk(scans: int, rng: np.random.Generator) -> Floats:
    """A smooth walk, 3 cm and about 2 degrees a scan, over a floor that it covers several times, between walls."""
    side_m = 0.08 * np.sqrt(scans)
    turn = np.zeros(scans)
    for k in range(1, scans):
        turn[k] = 0.98 * turn[k - 1] + np.radians(0.4) * rng.standard_normal()
    heading = np.cumsum(turn)
    step = 0.03 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    fold = (np.cumsum(step, axis=0) + side_m / 2) % (2 * side_m)
    position = np.where(fold > side_m, 2 * side_m - fold, fold)
    moved = np.gradient(position, axis=0)
    yaw = np.arctan2(moved[:, 1], moved[:, 0])
    time_s = np.arange(scans) / 30
    wobble = np.stack([0.2 * np.sin(1.3 * time_s), 0.3 * np.sin(0.7 * time_s), np.zeros(scans)], axis=1)
    R = exp_so3(yaw[:, None] * [0.0, 0.0, 1.0]) @ exp_so3(wobble)
    return pose(R, np.column_stack([position, 1.5 + 0.1 * np.sin(time_s)]))


def _video_pairs(T_world_cam: Floats, edges: int, rng: np.random.Generator) -> Ints:
    """Neighbours in time (about 80 % of the edges), then loops: the nearest other views in place and direction."""
    scans = len(T_world_cam)
    in_time, gap = list[Ints](), 0
    while sum(len(part) for part in in_time) < 0.8 * edges and gap < scans - 1:
        gap += 1
        first = np.arange(scans - gap)
        left = max(round(0.8 * edges), scans - 1) - sum(len(part) for part in in_time)
        if len(first) > left:
            first = np.sort(rng.choice(first, left, replace=False))
        in_time.append(np.column_stack([first, first + gap]))
    neighbours = np.concatenate(in_time)
    wanted = edges - len(neighbours)
    view = np.column_stack([T_world_cam[:, :2, 3], T_world_cam[:, :2, 0]])
    loops, around = np.empty((0, 2), dtype=np.int64), 32
    while len(loops) < wanted:
        around = min(scans - 1, 2 * around)
        distance, other = cKDTree(view).query(view, around + 1)
        i, j, d = np.repeat(np.arange(scans), around + 1), other.ravel(), distance.ravel()
        late = j - i > (max(gap, 30) if around < scans - 1 else 0)
        i, j, d = i[late], j[late], d[late]
        order = np.argsort(np.floor(2 * d) + rng.random(len(d)))
        order = order[~np.isin(i * scans + j, neighbours @ [scans, 1])[order]]
        loops = np.column_stack([i, j])[order]
    return np.concatenate([neighbours, loops[:wanted]])


def _random_pairs(scans: int, edges: int, rng: np.random.Generator) -> Ints:
    """A random tree and random further pairs, all different."""
    order = rng.permutation(scans)
    parent = order[(rng.random(scans - 1) * np.arange(1, scans)).astype(np.int64)]
    codes = np.sort(np.column_stack([parent, order[1:]]), axis=1) @ [scans, 1]
    dense = edges > scans * (scans - 1) // 8
    while len(codes) < edges:
        if dense:
            more = rng.permutation(np.column_stack(np.triu_indices(scans, 1)))
        else:
            more = rng.integers(0, scans, (2 * (edges - len(codes)) + 10, 2))
        more = np.sort(more[more[:, 0] != more[:, 1]], axis=1) @ [scans, 1]
        codes = np.concatenate([codes, more])
        codes = codes[np.sort(np.unique(codes, return_index=True)[1])][:edges]
    return np.column_stack([codes // scans, codes % scans])
