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
    strength: m scalars or (k,) arrays, larger is joined earlier; by default the number of matches of the pair, since
    a pair with many inliers is rarely wrong. Ties keep the order given, so the result depends on nothing else.

    A union-find takes the matches from the strongest on and refuses one that would put two features of a frame into
    one track: a wrong match costs its own link, not the two tracks it would have fused.
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
    root, dropped = _join(nodes[:, 0].copy(), nodes[:, 1].copy(), frame_of, len(offsets) - 1)

    # Nodes are numbered by frame, then feature, so the smallest node of a track names it and a stable sort does it.
    size = np.bincount(root, minlength=len(root))
    kept = np.flatnonzero(size[root] >= max(min_frames, 2))
    _, first, track = np.unique(root[kept], return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    track = rank[track]
    by_track = np.argsort(track, kind="stable")
    kept, track = kept[by_track], track[by_track]
    frame = frame_of[kept]
    return Tracks(frame, track, kept - offsets[frame], len(first), int(dropped))


@njit(cache=True, nogil=True)
def _find(parent: Ints, x: int) -> int:
    while parent[x] != x:
        parent[x] = parent[parent[x]]
        x = parent[x]
    return x


@njit(cache=True, nogil=True)
def _join(a: Ints, b: Ints, frame_of: Ints, n_frames: int) -> tuple[Ints, int]:
    """Root of every node (k,), and the number of matches refused. Members of a set form a ring through `ring`."""
    n = len(frame_of)
    parent, ring, size = np.arange(n), np.arange(n), np.ones(n, np.int64)
    seen = np.full(n_frames, -1)
    dropped = 0
    for m in range(len(a)):
        s, t = _find(parent, a[m]), _find(parent, b[m])
        if s == t:
            continue
        clash = size[s] + size[t] > n_frames
        if not clash:
            x = s
            while True:
                seen[frame_of[x]] = m
                x = ring[x]
                if x == s:
                    break
            x = t
            while not clash:
                clash = seen[frame_of[x]] == m
                x = ring[x]
                if x == t:
                    break
        if clash:
            dropped += 1
            continue
        if size[s] < size[t]:
            s, t = t, s
        parent[t] = s
        size[s] += size[t]
        ring[s], ring[t] = ring[t], ring[s]
    for x in range(n):
        parent[x] = _find(parent, x)
    return parent, dropped
