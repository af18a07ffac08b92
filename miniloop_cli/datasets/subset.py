"""An evenly spaced part of a recording as a new TUM folder: `python -m miniloop_cli.datasets.subset`."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.open import open_sequence
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.read import read_ground_truth
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.runtime.atomic_files import temporary_name
from miniloop_cli.scene.sequence import Frame, Sequence

USAGE = "usage: python -m miniloop_cli.datasets.subset SEQ DIR FRAMES"


def evenly_spaced(sequence: Sequence, count: int) -> tuple[Frame, ...]:
    """Frames round(linspace(0, last, count)) of those with ground truth, of all if there is none. Raises InputError."""
    frames = sequence.frames
    if truth := read_ground_truth(sequence):
        covered = truth.timestamps_s[[0, -1]]
        frames = tuple(f for f in frames if covered[0] <= f.timestamp_s <= covered[1])
    if not 1 <= count <= len(frames):
        raise InputError(f"{shown(sequence.root)} has {len(frames)} frames; choose at most so many, not {count}")
    return tuple(frames[k] for k in np.round(np.linspace(0, len(frames) - 1, count)).astype(int))


def write_subset(source: Path, target: Path, count: int) -> None:
    """Copy `count` frames of a TUM folder to `target`, with shortened tables and the whole ground truth, or nothing.

    Raises MiniloopError if the recording cannot be read, has too few frames, or the folder cannot be written.
    """
    frames = evenly_spaced(open_sequence(source, layout="tum"), count)
    temporary = temporary_name(target)
    try:
        for kind in ("rgb", "depth"):
            (temporary / kind).mkdir(parents=True)
            rows = []
            for frame in frames:
                path = Path((frame.color if kind == "rgb" else frame.depth).name)
                stamp = frame.timestamp_s if kind == "rgb" else frame.depth_timestamp_s
                shutil.copyfile(path, temporary / kind / path.name)
                rows.append(f"{stamp:.6f} {kind}/{path.name}\n")
            (temporary / f"{kind}.txt").write_text("".join(_header(source / f"{kind}.txt") + rows), encoding="utf-8")
        for name in ("groundtruth.txt", "accelerometer.txt", "camera.yaml"):
            if (source / name).exists():
                shutil.copyfile(source / name, temporary / name)
        temporary.rename(target)
    except OSError as error:
        raise MiniloopError(f"cannot write {shown(target)}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _header(table: Path) -> list[str]:
    if not table.exists():
        return []
    lines = table.read_text(encoding="utf-8", errors="replace").splitlines()
    return [f"{line}\n" for line in lines[:10] if line.startswith("#")]


if __name__ == "__main__":
    if len(sys.argv) != 4 or not sys.argv[3].isdigit():
        sys.exit(USAGE)
    try:
        write_subset(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
    except MiniloopError as problem:
        sys.exit(f"miniloop: {problem}")
