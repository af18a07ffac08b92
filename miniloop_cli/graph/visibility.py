"""Which scans see the same place, according to their poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.typing import Bools, Floats, Ints, Pair

SAMPLE = 100  # points that stand for a scan
MIN_SHARE = 0.3  # of them that must be in view of the other scan
NEAR_M = 0.2  # nearer points are not seen
CELLS = 4  # rows and columns of a view, to measure which part of it points cover


def sample_points(points: Sequence[ScanPoints]) -> Floats:
    """(n, SAMPLE, 3) points of each scan, evenly drawn from its list; NaN for scans without any."""
    chosen = np.full((len(points), SAMPLE, 3), np.nan)
    for k, scan in enumerate(points):
        if len(scan.points_m):
            chosen[k] = scan.points_m[np.linspace(0, len(scan.points_m) - 1, SAMPLE).astype(int)]
    return chosen


def partners(
    T_world_cam: Floats,
    scans: Ints,
    points: Sequence[ScanPoints],
    camera: Camera,
    most: int,
    group: Ints | None = None,
) -> list[Pair]:
    """Pairs (i, j), i < j, of `scans`: each scan with the `most` scans that share most of its view, sorted.

    Poses T_world_cam (n, 4, 4). `group` (n,) of each scan: only pairs across groups.
    """
    (T, T_inverse, sample, lens), pairs = _views(T_world_cam, scans, points, camera), set[Pair]()
    own = None if group is None else group[scans]
    for a in range(len(scans)):  # row by row: all pairs of a long recording do not fit in memory
        share = _mutual_shares(a, T_inverse @ T[a], T_inverse[a] @ T, sample, lens, MIN_SHARE)
        if own is not None:
            share[own == own[a]] = 0.0
        near = np.flatnonzero(share >= MIN_SHARE)
        for b in near[np.argsort(-share[near], kind="stable")][:most]:
            pairs.add((int(min(scans[a], scans[b])), int(max(scans[a], scans[b]))))
    return sorted(pairs)


def best_partners(
    T_world_cam: Floats,
    scans: Ints,
    points: Sequence[ScanPoints],
    camera: Camera,
    most: int,
    edges: EdgeTable,
) -> list[Pair]:
    """`partners`, and each scan with the `most` scans that it has most matches with by `edges`; sorted.

    T_world_cam (n, 4, 4); scans (k,) rows of the poses.
    By views alone, in a place that is visited often, scans from other times crowd out a scan's neighbours, which have
    more and better matches: tracks break there, and the map bends.
    """
    inside = edges.subset(np.isin(edges.pairs, scans).all(axis=1))
    strongest = inside.pairs[_among_the_strongest(inside.pairs, inside.inlier_count, most)]
    by_view = partners(T_world_cam, scans, points, camera, most)
    return sorted({*by_view, *((i, j) for i, j in strongest.tolist())})


def _among_the_strongest(pairs: Ints, strength: Ints, most: int) -> Bools:
    """(m,) whether each of the pairs (m, 2) is among the `most` strongest ones of one of its ends."""
    end, edge = pairs.T.ravel(), np.tile(np.arange(len(pairs)), 2)
    order = np.lexsort((edge, -strength[edge], end))
    rank = np.arange(len(order)) - np.searchsorted(end[order], end[order])
    kept = np.zeros(len(pairs), bool)
    kept[edge[order[rank < most]]] = True
    return kept


def pairs_in_view(
    T_world_cam: Floats, scans: Ints, points: Sequence[ScanPoints], camera: Camera, least: float
) -> set[Pair]:
    """Pairs (i, j), i < j, of `scans` of which one has the share `least` of its points in the image of the other.

    scans (k,): rows of the poses T_world_cam (n, 4, 4).
    """
    (T, T_inverse, sample, lens), pairs = _views(T_world_cam, scans, points, camera), set[Pair]()
    for a in range(len(scans)):
        for b in np.flatnonzero(_shares(a, T_inverse @ T[a], sample, lens, least) >= least):
            if a != b:
                pairs.add((int(min(scans[a], scans[b])), int(max(scans[a], scans[b]))))
    return pairs


def shared_with_view(T_world_cam: Floats, sample: Floats, camera: Camera) -> Floats:
    """(n,) overlap of each scan with the view from T_world_cam (4, 4); sample (n, s, 3) m: its points in the world.

    This is the smaller of two shares: of the scan's points that lie in the view, and of the view that these cover. It
    is therefore small for a scan from much nearer.
    """
    p_cam = (sample - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
    ahead = p_cam[..., 2] > NEAR_M
    px = camera.project(np.where(ahead[..., None], p_cam, 1.0).reshape(-1, 3)).reshape(*ahead.shape, 2)
    inside = ahead & (px >= 0).all(axis=-1) & (px < (camera.width, camera.height)).all(axis=-1)
    covered = np.zeros((len(sample), CELLS, CELLS), bool)
    column, row = (px[inside] * CELLS / (camera.width, camera.height)).astype(int).T
    covered[np.nonzero(inside)[0], row, column] = True
    return np.minimum(inside.mean(axis=1), covered.mean(axis=(1, 2)))


def _views(
    T_world_cam: Floats, scans: Ints, points: Sequence[ScanPoints], camera: Camera
) -> tuple[Floats, Floats, Floats, Floats]:
    """Poses (m, 4, 4) of the scans, their inverses, sample points (m, SAMPLE, 3); fx fy cx cy width height."""
    T = T_world_cam[scans]
    sample = sample_points([points[k] for k in scans])
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height])
    return T, se3.inverse(T), sample, lens


@njit(cache=True, nogil=True, error_model="numpy")
def _share(T: Floats, points: Floats, lens: Floats, least: float) -> float:
    """Share of the points (k, 3) that lie in the image of a camera which they reach by T (4, 4); 0 if below `least`."""
    seen, count = 0, points.shape[0]
    for k in range(count):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        if depth > NEAR_M:
            u = lens[0] * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth + lens[2]
            v = lens[1] * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth + lens[3]
            seen += 0 <= u < lens[4] and 0 <= v < lens[5]
        if seen + count - 1 - k < least * count:
            return 0.0
    return seen / count


@njit(cache=True, nogil=True, error_model="numpy")
def _shares(a: int, T_cam_a: Floats, sample: Floats, lens: Floats, least: float) -> Floats:
    """(n,) share of the sample points of scan a that lie in the image of each scan; 0 where it is below `least`.

    T_cam_a (n, 4, 4): from scan a to each scan.
    """
    n = T_cam_a.shape[0]
    share = np.zeros(n)
    for b in range(n):
        share[b] = _share(T_cam_a[b], sample[a], lens, least)
    return share


@njit(cache=True, nogil=True, error_model="numpy")
def _mutual_shares(a: int, T_cam_a: Floats, T_a_cam: Floats, sample: Floats, lens: Floats, least: float) -> Floats:
    """(n,) the smaller one of both shares of scan a and each other; 0 where it is below `least`, and for a itself.

    T_cam_a, T_a_cam (n, 4, 4): from scan a to each scan, and back.
    """
    n = T_cam_a.shape[0]
    share = np.zeros(n)
    for b in range(n):
        if b == a:
            continue
        there = _share(T_cam_a[b], sample[a], lens, least)
        if there > 0.0:
            share[b] = min(there, _share(T_a_cam[b], sample[b], lens, least))
    return share
