"""thumbnails.npz of a results folder: a small JPEG file of every frame that tracking has read."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from miniloop_cli.results.stored_arrays import are_offsets, stored_arrays
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.typing import Bytes


def write_thumbnails(path: Path, files: Mapping[int, Bytes]) -> None:
    """Write JPEG files (n,) by frame number, one after the other."""
    frames = sorted(files)
    offsets = np.cumsum([0, *(len(files[k]) for k in frames)])
    jpeg = np.concatenate([np.zeros(0, np.uint8), *(files[k] for k in frames)])
    with atomic_write(path, "wb") as file:
        np.savez(file, frames=np.array(frames, np.int64), offsets=offsets, jpeg=jpeg)


def read_thumbnails(path: Path) -> dict[int, Bytes]:
    """The JPEG files (n,) that `write_thumbnails` wrote; {} without the file. Raises InputError for anything else."""
    if not path.is_file():
        return {}
    with stored_arrays(path, "frames", "offsets", "jpeg") as (frames, offsets, jpeg):
        sound = frames.dtype.kind + offsets.dtype.kind == "ii" and jpeg.dtype == np.uint8 and jpeg.ndim == 1
        if not sound or frames.ndim != 1:
            raise ValueError("expected frames (k,), offsets (k + 1,) and jpeg, bytes")
        if not are_offsets(offsets, len(frames), len(jpeg)) or (frames < 0).any():
            raise ValueError("offsets do not fit the files")
    ends = itertools.pairwise(offsets.tolist())
    return {k: jpeg[a:b] for k, (a, b) in zip(frames.tolist(), ends, strict=True)}
