"""Priors of the frames: the vertical of each, and rough poses."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.accelerometer import read_accelerometer
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.priors import Priors
from miniloop_cli.scene.sequence import Note, Sequence
from miniloop_cli.typing import Bools

LOG = logging.getLogger("miniloop")


def read_priors(sequence: Sequence, gravity: Path | str | None = None, poses: Path | str | None = None) -> Priors:
    """Priors of the frames of a sequence from an accelerometer table and a trajectory, by their time stamps.

    Raises InputError naming file and line for malformed files, and for files of another time.
    """
    stamps = np.array([frame.timestamp_s for frame in sequence.frames])
    accelerometer = T = None
    notes: tuple[Note, ...] = ()
    if gravity is not None:
        accelerometer, notes = read_accelerometer(gravity, stamps)
        _require(np.all(np.isfinite(accelerometer.up), axis=1), gravity, "readings")
    if poses is not None:
        rough = read_trajectory(poses, stamps, lambda: {"frames of the recording": stamps})
        LOG.info("pose prior: %s", rough.source)
        T, near = associate(stamps, rough)
        T = np.where(near[:, None, None], T, np.nan)
        _require(near, poses, "poses")
    return Priors(accelerometer, T, notes)


def _require(known: Bools, path: Path | str, what: str) -> None:
    if not known.any():
        raise InputError(f"{shown(Path(path))}: no {what} at the times of the frames; is it of this recording?")
