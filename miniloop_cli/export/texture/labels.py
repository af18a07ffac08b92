"""The view that colours each triangle: good views, in large patches, as seams are visible.

A Potts model over the triangles (Lempitsky & Ivanov 2007), descended by iterated conditional modes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from miniloop_cli.export.mesh_model import Mesh, face_pairs
from miniloop_cli.export.texture.sight import Shown
from miniloop_cli.typing import Bools, Floats32, Ints

KEPT_VIEWS = 8  # candidates a triangle
SMOOTHING_ROUNDS = 4
SEAM_COST = 0.35  # of an edge between two views; 1 is the loss of all quality
ROUNDS = 24
SMALL_PATCH = 60  # triangles: smaller patches join a neighbour whose view sees them
ABSORBING_ROUNDS = 6

Labels = NDArray[np.int16]


class Candidates:
    """The best views of every triangle: numbers (m, KEPT_VIEWS), -1 for none, and their quality, 0 for none.

    seen (n,): vertices that at least one view sees.
    """

    def __init__(self, mesh: Mesh, smooth: csr_array) -> None:
        self.triangles = mesh.triangles
        self.view: Labels = np.full((len(mesh.triangles), KEPT_VIEWS), -1, np.int16)
        self.quality: Floats32 = np.zeros((len(mesh.triangles), KEPT_VIEWS), np.float32)
        self.seen = np.zeros(len(mesh.vertices), bool)
        self._smooth = smooth

    def add(self, view: int, shown: Shown, weight: np.float32) -> None:
        """Add a view. It must show two of the three vertices of a triangle well.

        Quality is averaged over neighbours, as that of single triangles follows the noise of the surface.
        """
        self.seen[shown.vertex] = True
        quality = np.zeros(len(self.seen), np.float32)
        quality[shown.vertex] = shown.quality * weight
        good = quality > 0
        for _ in range(SMOOTHING_ROUNDS):
            quality = self._smooth @ quality
        rows = np.flatnonzero(good[self.triangles].sum(axis=1) > 1)
        mean = quality[self.triangles[rows]].mean(axis=1)
        worst = self.quality[rows].argmin(axis=1)
        better = mean > self.quality[rows, worst]
        rows, worst = rows[better], worst[better]
        self.view[rows, worst], self.quality[rows, worst] = view, mean[better]


def choose_labels(mesh: Mesh, view: Labels, quality: Floats32) -> Labels:
    """(m,) the view of every triangle, -1 where none shows it; of the candidates `view` and their quality (m, k)."""
    relative = quality / np.maximum(quality.max(axis=1, keepdims=True), np.float32(1e-12))
    data = np.where(view >= 0, relative, np.float32(-np.inf))
    rows = np.arange(len(view))
    label: Labels = view[rows, data.argmax(axis=1)]
    pairs = face_pairs(mesh.triangles)
    around = neighbours(pairs, len(view))
    open_rows = np.flatnonzero((view >= 0).sum(axis=1) > 1)
    for turn in range(ROUNDS):
        # Neighbours must not change at the same time: a different half of the triangles is updated each time.
        half = open_rows[(open_rows >> turn % 5) & 1 == turn // 5 % 2]
        beside = np.where(around[half] >= 0, label[around[half]], np.int16(-1))
        agree = sum((view[half] == beside[:, k, None]).astype(np.float32) for k in range(3))
        label[half] = view[half, (data[half] + np.float32(SEAM_COST) * agree).argmax(axis=1)]
    return absorb_small(label, view, pairs)


def neighbours(pairs: Ints, count: int) -> NDArray[np.int32]:
    """(m, 3) triangles beside each triangle, -1 where there are fewer; of more than three, some.

    pairs (k, 2) of triangles with a common edge.
    """
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    ends = ends[np.argsort(ends[:, 0], kind="stable")]
    first = np.searchsorted(ends[:, 0], np.arange(count))
    place = np.arange(len(ends)) - first[ends[:, 0]]
    around = np.full((count, 3), -1, np.int32)
    fits = place < 3
    around[ends[fits, 0], place[fits]] = ends[fits, 1]
    return around


def patches(label: Labels, pairs: Ints) -> Ints:
    """(m,) number of the patch of every triangle: connected triangles with one view form a patch.

    label (m,) view of every triangle, pairs (k, 2) of triangles with a common edge.
    """
    same = label[pairs[:, 0]] == label[pairs[:, 1]]
    i, j = pairs[same].T
    joined = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(len(label),) * 2)
    return np.asarray(connected_components(joined, directed=False)[1], np.int64)


def absorb_small(label: Labels, view: Labels, pairs: Ints) -> Labels:
    """Labels (n,); small patches join the neighbour with most common edges, if its view sees them."""
    for _ in range(ABSORBING_ROUNDS):
        patch = patches(label, pairs)
        small: Bools = np.bincount(patch)[patch] < SMALL_PATCH
        both = np.concatenate([pairs, pairs[:, ::-1]])
        across = small[both[:, 0]] & (label[both[:, 0]] != label[both[:, 1]]) & (label[both[:, 1]] >= 0)
        i, j = both[across].T
        # The label across most edges of a patch: the last one of the patch, in the order of counts.
        votes, count = np.unique(np.stack([patch[i], label[j].astype(np.int64)]), axis=1, return_counts=True)
        order = np.lexsort((count, votes[0]))
        wanted = np.full(len(label), -1, np.int16)
        wanted[votes[0, order]] = votes[1, order]
        new = wanted[patch]
        rows = np.flatnonzero(small & (new >= 0) & (new != label))
        rows = rows[(view[rows] == new[rows, None]).any(axis=1)]
        if not len(rows):
            break
        label = label.copy()
        label[rows] = new[rows]
    return label
