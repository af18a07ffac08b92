"""Points tracked through a whole recording, as measurements for the adjustment of all its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.inputs import Between
from miniloop_cli.refinement.motion_term import MotionTerm
from miniloop_cli.refinement.timing import Measurements
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Bools, Floats, Ints

MIN_MEASURED = 60  # with so many points, the pose of a frame comes from them, not from its depth image of another time
MIN_LENGTH = 3  # frames: points tracked for less carry little information on the motion


def followed_measurements(between: Between, known: Bools, camera: Camera, per_frame: int) -> Measurements:
    """Measurements of tracks chosen so that every frame has about `per_frame` of them; tracks numbered from 0.

    Only frames whose poses are `known` (n,) take part: others would spoil the poses of frames that share points.
    """
    seen = between.tracked.seen.subset(known[between.tracked.seen.frame])
    seen = seen.subset(chosen_tracks(seen.frame, seen.track, per_frame)[seen.track])
    _, track = np.unique(seen.track, return_inverse=True)
    row_share = (seen.px[:, 1] - (camera.height - 1) / 2) / camera.height
    lag_s = (between.depth_stamps_s - between.stamps_s)[seen.frame]
    return Measurements(seen.frame, track, row_share, seen.px_ideal, seen.z_m, seen.slope, lag_s)


def chosen_tracks(frame: Ints, track: Ints, per_frame: int) -> Bools:
    """Which tracks (t,) take part: the longest first, as long as a frame they see has fewer than `per_frame`.

    `frame` and `track` (k,) of each observation.
    """
    order = np.lexsort((frame, track))
    start = np.searchsorted(track[order], np.arange(int(track.max(initial=-1)) + 2))
    longest = np.argsort(-np.diff(start), kind="stable")
    count = np.zeros(int(frame.max(initial=-1)) + 1, np.int64)
    return _choose(longest, start, frame[order], count, per_frame, MIN_LENGTH)


@njit(cache=True, nogil=True, error_model="numpy")
def _choose(longest: Ints, start: Ints, frame: Ints, count: Ints, per_frame: int, min_length: int) -> Bools:
    chosen = np.zeros(len(longest), np.bool_)
    for t in longest:
        if start[t + 1] - start[t] < min_length:
            break
        needed = False
        for k in range(start[t], start[t + 1]):
            needed |= count[frame[k]] < per_frame
        if needed:
            chosen[t] = True
            for k in range(start[t], start[t + 1]):
                count[frame[k]] += 1
    return chosen


def joined(of_keyframes: Measurements, keyframes: Ints, followed: Measurements) -> Measurements:
    """Measurements of the features of keyframes (K,) and of tracked points, by frames of the whole recording."""
    first = int(of_keyframes.track.max(initial=-1)) + 1
    parts = replace(of_keyframes, frame=keyframes[of_keyframes.frame]), replace(followed, track=followed.track + first)
    names = Measurements.__dataclass_fields__
    return Measurements(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def weakly_measured(between: Between, known: Bools, measured: Measurements) -> Ints:
    """Frames with a `known` (n,) pose, few measurements, and a motion by depth and brightness, if only in part."""
    few = np.bincount(measured.frame, minlength=len(known)) < MIN_MEASURED
    return np.flatnonzero(between.tracked.surface_information.any(axis=(1, 2)) & known & few)


def motions(between: Between, known: Bools, frames: Ints) -> list[MotionTerm]:
    """The motions from their keyframes to these frames (m,), where both are `known` (n,)."""
    tracked = between.tracked
    return _terms(between, known, frames, tracked.T_cam_key, tracked.information)


def surface_motions(between: Between, known: Bools, frames: Ints) -> list[MotionTerm]:
    """The same motions by depth and brightness alone, for frames (m,) with measured points; `known` (n,) as above."""
    tracked = between.tracked
    return _terms(between, known, frames, tracked.T_by_surface, tracked.surface_information)


def _terms(between: Between, known: Bools, frames: Ints, T_cam_key: Floats, information: Floats) -> list[MotionTerm]:
    key = between.tracked.key
    frames = frames[(key[frames] >= 0) & known[frames]]
    frames = frames[known[key[frames]]]
    if not len(frames):
        return []
    return [MotionTerm.of(np.stack([key[frames], frames], axis=1), T_cam_key[frames], information[frames])]
