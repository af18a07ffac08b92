"""Some matches of each edge in the 3D view, packed, to show on the two images."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.report.spacing import evenly_spaced
from miniloop_cli.results.columns import ReportData
from miniloop_cli.typing import Bools, Bytes, Floats, Ints

MOST_OF_EDGE, LEAST_OF_EDGE = 30, 8
MOST_MATCHES = 150_000  # of all edges together: some 5 bytes each


def drawn_matches(data: ReportData, rows: Ints) -> tuple[Ints, bytes]:
    """Number of drawn matches of each of these edges (m,), and all of them packed by `pack_matches`."""
    most = int(np.clip(MOST_MATCHES // max(len(rows), 1), LEAST_OF_EDGE, MOST_OF_EDGE))
    parts = [_of_edge(data, int(k), most) for k in rows]
    counts = np.array([len(agrees) for _, _, agrees in parts], np.int64)
    nothing = np.zeros((0, 2))
    ends = [np.concatenate([nothing, *(part[side] for part in parts)]) for side in (0, 1)]
    px = np.rint(np.clip(np.nan_to_num(np.concatenate(ends, axis=1)), 0, 65535)).astype(np.uint16)
    return counts, pack_matches(px, np.concatenate([np.zeros(0, bool), *(agrees for _, _, agrees in parts)]))


def _of_edge(data: ReportData, k: int, most: int) -> tuple[Floats, Floats, Bools]:
    """Pixels (c, 2) in i and in j, and (c,) whether they are inliers, of at most `most` matches."""
    if k in data.rejected_px:
        px_i, px_j, agrees = data.rejected_px[k]
        rows = evenly_spaced(len(px_i), most)
        return px_i[rows], px_j[rows], agrees[rows]
    if k not in data.inlier_px:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, bool)
    px_i, px_j = data.inlier_px[k]
    rows = evenly_spaced(len(px_i), most)
    return px_i[rows], px_j[rows], np.ones(len(rows), bool)


def pack_matches(px: NDArray[np.uint16], agrees: Bools) -> bytes:
    """(k, 4) pixels and (k,) bool, deflated (zlib): low bytes of the four columns, their high bytes, then 0 or 1."""
    planes: list[Bytes] = [(px[:, c] & 255).astype(np.uint8) for c in range(4)]
    planes += [(px[:, c] >> 8).astype(np.uint8) for c in range(4)]
    return zlib.compress(b"".join(plane.tobytes() for plane in (*planes, agrees.astype(np.uint8))), 6)


def unpack_matches(packed: bytes) -> tuple[NDArray[np.uint16], Bools]:
    """Pixels (k, 4) and marks (k,) from the bytes of `pack_matches`."""
    planes = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(9, -1)
    return (planes[:4] + 256 * planes[4:8].astype(np.uint16)).T.astype(np.uint16), planes[8].astype(bool)
