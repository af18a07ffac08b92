"""Some matches of each edge in the 3D view, packed, to show on the two images."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.results.columns import ReportData
from miniloop_cli.typing import Bools, Bytes, Floats, Ints

MOST_OF_EDGE, LEAST_OF_EDGE = 30, 8
MOST_MATCHES = 150_000  # of all edges together: some 5 bytes each


def drawn_matches(data: ReportData, rows: Ints) -> tuple[Ints, bytes]:
    """Number of drawn matches of each of these edges (m,), and all of them packed by `pack_matches`."""
    most = int(np.clip(MOST_MATCHES // max(len(rows), 1), LEAST_OF_EDGE, MOST_OF_EDGE))
    parts = [_of_edge(data, int(k), most) for k in rows]
    counts = np.array([len(px) for px, _ in parts], np.int64)
    px = np.concatenate([np.zeros((0, 4), np.uint16), *(px for px, _ in parts)])
    return counts, pack_matches(px, np.concatenate([np.zeros(0, bool), *(agrees for _, agrees in parts)]))


def _of_edge(data: ReportData, k: int, most: int) -> tuple[NDArray[np.uint16], Bools]:
    """(c, 4) whole pixels u_i v_i u_j v_j, and (c,) whether they are inliers, of at most `most` matches."""
    if k in data.rejected_px:
        px_i, px_j, agrees = data.rejected_px[k]
    elif k in data.inlier_px:
        px_i, px_j = data.inlier_px[k]
        agrees = np.ones(len(px_i), bool)
    else:
        return np.zeros((0, 4), np.uint16), np.zeros(0, bool)
    count = min(most, len(px_i))
    rows = np.linspace(0, max(len(px_i) - 1, 0), count).round().astype(np.int64)
    ends: Floats = np.concatenate([px_i[rows], px_j[rows]], axis=1)
    return np.rint(np.clip(np.nan_to_num(ends), 0, 65535)).astype(np.uint16), agrees[rows]


def pack_matches(px: NDArray[np.uint16], agrees: Bools) -> bytes:
    """(k, 4) pixels and (k,) bool, deflated (zlib): low bytes of the four columns, their high bytes, then 0 or 1."""
    planes: list[Bytes] = [(px[:, c] & 255).astype(np.uint8) for c in range(4)]
    planes += [(px[:, c] >> 8).astype(np.uint8) for c in range(4)]
    return zlib.compress(b"".join(plane.tobytes() for plane in (*planes, agrees.astype(np.uint8))), 6)


def unpack_matches(packed: bytes) -> tuple[NDArray[np.uint16], Bools]:
    """Pixels (k, 4) and marks (k,) from the bytes of `pack_matches`."""
    planes = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(9, -1)
    return (planes[:4] + 256 * planes[4:8].astype(np.uint16)).T.astype(np.uint16), planes[8].astype(bool)
