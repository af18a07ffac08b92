"""rejected.npz of a results folder: some matches of each rejected edge, which show why it is rejected."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from miniloop_cli.results.stored_arrays import are_offsets, stored_arrays
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.registration import Registration
from miniloop_cli.typing import Bools, Floats, Ints

MOST_EDGES = 10_000  # those with most inliers, which were nearest to being verified
MOST_INLIERS, MOST_MATCHES = 20, 30  # of an edge: inliers of its best hypothesis, and all matches

Matches = tuple[Floats, Floats, Bools]


def write_rejected(run: Registration, path: Path) -> None:
    """Write rows of edges.csv with some matches each: rounded pixels in i and j, and whether they are inliers."""
    edges = run.edges
    rejected = np.flatnonzero(~edges.open & (edges.match_count > 0))
    order = np.lexsort((rejected, -edges.match_count[rejected], -edges.inlier_count[rejected]))
    rejected = np.sort(rejected[order][:MOST_EDGES])
    counts = [0]
    px: list[Floats] = [np.zeros((0, 4))]
    agrees: list[Bools] = [np.zeros(0, bool)]
    for e in rejected.tolist():
        own = slice(edges.start[e], edges.start[e + 1])
        rows = _some(edges.inliers[own])
        matches, inliers = edges.matches[own][rows], edges.inliers[own][rows]
        ends = (run.scans[edges.i[e]].features.px, run.scans[edges.j[e]].features.px)
        px.append(np.concatenate([ends[side][matches[:, side]] for side in (0, 1)], axis=1))
        agrees.append(inliers)
        counts.append(len(rows))
    pixels = np.clip(np.rint(np.concatenate(px)), 0, 65535).astype(np.uint16)
    with atomic_write(path, "wb") as file:
        offsets = np.cumsum(counts)
        np.savez_compressed(file, edges=rejected, offsets=offsets, px=pixels, agrees=np.concatenate(agrees))


def _some(inliers: Bools) -> Ints:
    """Rows of at most MOST_MATCHES matches (k,): inliers, then others, evenly spaced if there are more."""
    chosen: list[Ints] = []
    for rows, most in ((np.flatnonzero(inliers), MOST_INLIERS), (np.flatnonzero(~inliers), MOST_MATCHES)):
        count = min(most - sum(map(len, chosen)), len(rows))
        chosen.append(rows[np.linspace(0, len(rows) - 1, count).round().astype(np.int64)] if count else rows[:0])
    return np.concatenate(chosen)


def read_rejected(root: Path, edges: int) -> dict[int, Matches]:
    """For each rejected edge (row of edges.csv) px_i (k, 2), px_j (k, 2), agrees (k,); {} without the file.

    Raises InputError if it does not belong to this edges.csv.
    """
    path = root / "rejected.npz"
    if not path.is_file():
        return {}
    with stored_arrays(path, "edges", "offsets", "px", "agrees") as (rows, offsets, px, agrees):
        if rows.dtype.kind + offsets.dtype.kind + px.dtype.kind + agrees.dtype.kind != "iiub":
            raise ValueError("expected edges (r,), offsets (r + 1,), px (k, 4) and agrees (k,)")
        sound = rows.ndim == 1 and px.shape == (len(agrees), 4)
        if not sound or not are_offsets(offsets, len(rows), len(px)):
            raise ValueError("offsets do not fit the matches")
        if len(rows) and not (rows.min() >= 0 and rows.max() < edges):
            raise ValueError(f"edges beyond the {edges} of edges.csv")
    ends = itertools.pairwise(offsets.tolist())
    pixels = px.astype(float)
    return {k: (pixels[a:b, :2], pixels[a:b, 2:], agrees[a:b]) for k, (a, b) in zip(rows.tolist(), ends, strict=True)}
