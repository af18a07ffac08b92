"""Arrays of the .npz files beside the tables of a result: these may be damaged, or belong to another run."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.errors import InputError
from miniloop_cli.typing import Floats, Ints


@contextmanager
def stored_arrays(path: Path, *names: str) -> Iterator[list[NDArray[Any]]]:
    """The arrays (...) of these names, for a block that checks them and raises ValueError for wrong ones.

    Raises InputError for that, and for a file that cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = [np.asarray(stored[name]) for name in names]
        yield arrays
    except Exception as error:  # numpy, zipfile and zlib raise many types for a damaged archive
        raise InputError(f"{path}: {error}; run `miniloop register` again") from error


def are_offsets(offsets: Ints, parts: int, total: int) -> bool:
    """Whether offsets (parts + 1,) cut `total` rows into so many parts, one after the other."""
    ends = offsets.shape == (parts + 1,) and offsets[0] == 0 and offsets[-1] == total
    return bool(ends and (np.diff(offsets) >= 0).all())


def read_inliers(root: Path, edges: int) -> dict[int, tuple[Floats, Floats]]:
    """inliers.npz: offsets (m + 1,), px_i and px_j (k, 2), the edges in the order of edges.csv; {} without it.

    Raises InputError where it does not belong to this edges.csv.
    """
    path = root / "inliers.npz"
    if not path.is_file():
        return {}
    with stored_arrays(path, "offsets", "px_i", "px_j") as (offsets, px_i, px_j):
        starts = offsets.astype(np.int64)
        sound = px_i.shape == px_j.shape == (len(px_i), 2) and px_i.dtype.kind + px_j.dtype.kind == "ff"
        if not sound or not are_offsets(starts, edges, len(px_i)):
            raise ValueError(f"arrays do not fit {edges} edges")
    return {k: (px_i[a:b], px_j[a:b]) for k, (a, b) in enumerate(itertools.pairwise(starts))}


def read_covariances(root: Path, frames: int) -> Floats | None:
    """covariances.npz as (n, 6, 6), NaN for frames that are not in it; None without the file.

    Raises InputError where it does not belong to a run of so many frames.
    """
    path = root / "covariances.npz"
    if not path.is_file():
        return None
    found = np.full((frames, 6, 6), np.nan)
    with stored_arrays(path, "frames", "covariance") as (numbers, covariance):
        if numbers.dtype.kind not in "iu" or covariance.dtype.kind != "f" or covariance.shape != (len(numbers), 6, 6):
            raise ValueError("expected frames (k,) and covariance (k, 6, 6)")
        if len(numbers) and not (numbers.min() >= 0 and numbers.max() < frames):
            raise ValueError(f"frames beyond the {frames} of the run")
        found[numbers] = covariance
    return found
