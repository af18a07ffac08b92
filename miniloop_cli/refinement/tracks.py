"""Feature tracks: the pairwise matches of one scene point, chained over the frames that saw it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Ints


@dataclass(frozen=True)
class Tracks:
    """Observations sorted by track, then by frame; no frame occurs twice in a track.

    frame, track, feature: (k,) int64; `feature` counts within its frame. `count` tracks, numbered 0..count-1 in the
    order of their first observation (frame, then feature). `dropped_matches` were refused because they contradict
    stronger ones.
    """

    frame: Ints
    track: Ints
    feature: Ints
    count: int
    dropped_matches: int


def build_tracks(
    feature_offsets: ArrayLike,
    pairs: ArrayLike,
    matches: Sequence[NDArray[np.integer]],
    strength: Sequence[ArrayLike] | None = None,
    min_frames: int = 2,
) -> Tracks:
    """Chain matches into tracks that see every frame at most once.

    feature_offsets: (n + 1,) ints, frame f owns the features offsets[f]..offsets[f + 1] - 1 counted over all frames.
    pairs: (m, 2) ints, the frames of each pair; matches: m arrays (k, 2) of feature numbers within those two frames.
    strength: m scalars or (k,) arrays, stronger matches are joined earlier; by default the number of matches of the
    pair, since a pair with many inliers is rarely wrong. Ties keep the given order.

    A union-find joins the matches from the strongest on. It refuses a match that would put two features of a frame
    into one track, so that a wrong match does not fuse two tracks.
    Raises ValueError for shapes or numbers that do not fit together.
    """
    offsets = np.asarray(feature_offsets, np.int64)
    pairs = np.asarray(pairs, np.int64).reshape(-1, 2)
    if len(matches) != len(pairs):
        raise ValueError(f"{len(pairs)} pairs but {len(matches)} arrays of matches")
    counts = np.array([len(m) for m in matches], np.int64)
    ab = np.concatenate([np.asarray(m, np.int64).reshape(-1, 2) for m in matches] or [np.zeros((0, 2), np.int64)])
    frames = np.repeat(pairs, counts, axis=0)
    if frames.size and (frames.min() < 0 or frames.max() >= len(offsets) - 1):
        raise ValueError(f"pairs name frames outside 0..{len(offsets) - 2}")
    if np.any(ab < 0) or np.any(ab >= np.diff(offsets)[frames]):
        raise ValueError("a match names a feature that its frame does not have")
    if strength is None:
        weight = np.repeat(counts.astype(float), counts)
    else:
        weight = np.concatenate(
            [np.broadcast_to(np.asarray(s, float), k) for s, k in zip(strength, counts, strict=True)]
        )
    order = np.argsort(-weight, kind="stable")
    nodes = (ab + offsets[frames])[order]
    frame_of = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    root, unmarked = np.arange(len(frame_of)), np.full(len(offsets) - 1, -1)
    ones, scratch = np.ones(len(frame_of), np.int64), np.empty(2, np.int64)
    dropped = _join(np.ascontiguousarray(nodes), frame_of, root, root.copy(), ones, unmarked, scratch)

    # Nodes are numbered by frame, then feature. A track has the number of its smallest node, so a stable sort suffices.
    size = np.bincount(root, minlength=len(root))
    kept = np.flatnonzero(size[root] >= max(min_frames, 2))
    _, first, track = np.unique(root[kept], return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    track = rank[track]
    by_track = np.argsort(track, kind="stable")
    kept, track = kept[by_track], track[by_track]
    frame = frame_of[kept]
    return Tracks(frame, track, kept - offsets[frame], len(first), dropped)


@njit(cache=True, nogil=True, error_model="numpy")
def _join(ends: Ints, frame_of: Ints, parent: Ints, ring: Ints, size: Ints, seen: Ints, root: Ints) -> int:
    """Join the nodes (m, 2) that matches connect, in their order; the number of matches refused is returned.

    `parent` and `ring` (k,) begin as 0..k - 1, `size` as ones, `seen` (frames,) as -1; root (2,) is scratch. Members of
    a set form a ring through `ring`. In the end `parent` holds the root of every node.
    """
    dropped = 0
    for m in range(len(ends)):
        for side in range(2):
            x = ends[m, side]
            while parent[x] != x:
                parent[x] = parent[parent[x]]
                x = parent[x]
            root[side] = x
        if root[0] == root[1]:
            continue
        clash = size[root[0]] + size[root[1]] > len(seen)
        for side in range(2):  # the frames of the first set are marked, those of the second compared with them
            x = root[side]
            for _ in range(size[x]):
                if clash:
                    break
                clash = seen[frame_of[x]] == m
                seen[frame_of[x]] = m
                x = ring[x]
        if clash:
            dropped += 1
            continue
        larger = 0 if size[root[0]] >= size[root[1]] else 1
        s, t = root[larger], root[1 - larger]
        parent[t] = s
        size[s] += size[t]
        ring[s], ring[t] = ring[t], ring[s]
    for x in range(len(parent)):
        while parent[x] != parent[parent[x]]:
            parent[x] = parent[parent[x]]
    return dropped
