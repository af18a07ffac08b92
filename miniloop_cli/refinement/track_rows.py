"""The rows of all observations, sorted by track: which frames see which points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Bools, Floats, Ints


class TrackRows(NamedTuple):
    """Track p owns the rows start[p]..start[p + 1] - 1, by frame; frame (k,) is the frame of each row."""

    start: Ints
    frame: NDArray[np.uint32]

    def subset(self, kept: Bools) -> TrackRows:
        """The rows that are kept (k,); a track may have none left."""
        start = np.concatenate([np.zeros(1, np.int64), np.cumsum(kept)])[self.start]
        return TrackRows(start, self.frame[kept])

    def pairs(self, frames: int) -> Ints:
        """(m, 2) the pairs (i, j), i < j, of `frames` frames that share a track, sorted."""
        from scipy.sparse import csr_array

        seen = csr_array((np.ones(len(self.frame)), self.frame, self.start), shape=(len(self.start) - 1, frames))
        together = (seen.T @ seen).tocoo()
        upper = together.row < together.col
        pairs = np.stack([together.row[upper], together.col[upper]], axis=1).astype(np.int64)
        return pairs[np.lexsort(pairs.T[::-1])]


@njit(cache=True, nogil=True, error_model="numpy")
def camera_points(tracks: TrackRows, R: Floats, t: Floats, X: Floats) -> Floats:
    """p_cam (3, k) of the points X (p, 3) in the frames that see them, whose poses are R (n, 3, 3), t (n, 3)."""
    p_cam = np.empty((3, len(tracks.frame)))
    for p in range(len(tracks.start) - 1):
        for k in range(tracks.start[p], tracks.start[p + 1]):
            f = tracks.frame[k]
            for i in range(3):
                p_cam[i, k] = 0.0
                for c in range(3):
                    p_cam[i, k] += R[f, c, i] * (X[p, c] - t[f, c])
    return p_cam
