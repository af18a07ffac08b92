"""landmarks.npz of a results folder: the points of the bundle adjustment and their observations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.results.stored_arrays import stored_arrays
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.landmarks import NO_LANDMARKS, Landmarks


def write_landmarks(path: Path, landmarks: Landmarks) -> None:
    """Write points (p, 3) and observations (k,) as arrays."""
    with atomic_write(path, "wb") as file:
        np.savez(
            file, points=landmarks.points_world, point=landmarks.point, frame=landmarks.frame, px_ideal=landmarks.px
        )


def read_landmarks(path: Path) -> Landmarks:
    """The landmarks of the file; none without it. Raises InputError for a damaged file."""
    if not path.is_file():
        return NO_LANDMARKS
    with stored_arrays(path, "points", "point", "frame", "px_ideal") as (points, point, frame, px):
        k, kinds = len(point), [array.dtype.kind for array in (points, point, frame, px)]
        if kinds != list("fiif") or points.shape != (len(points), 3) or frame.shape != (k,) or px.shape != (k, 2):
            raise ValueError("expected points (p, 3), point (k,), frame (k,) and px_ideal (k, 2)")
        if not (np.isfinite(points).all() and np.isfinite(px).all()):
            raise ValueError("coordinates must be finite")
        if k and not (point.min() >= 0 and point.max() < len(points) and frame.min() >= 0):
            raise ValueError(f"sightings of points beyond the {len(points)}, or of negative frames")
    return Landmarks(points.astype(float), point.astype(np.int32), frame.astype(np.int32), px.astype(np.float32))
