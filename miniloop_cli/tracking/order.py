"""Whether the frames lie on the path in the order of their stamps: some recorders exchange neighbouring images."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.scene.tracked import Tracked
from miniloop_cli.typing import Floats, Ints

SHORTER = 0.8  # of the path through four frames, after exchanging the middle two; 0.6 on an even path
LEAST_STEP = 0.004  # rad, or m: smaller ones may be noise
MANY = 0.05  # of all frames: with more, the stamps of the recording are not reliable


def notes_on_order(tracked: Tracked) -> list[Note]:
    """Notes on neighbouring frames that are in the wrong order on the path.

    Frames that only depth links are left out: their motion is too inaccurate.
    """
    path = followed_path(tracked)
    path[tracked.by_surface] = np.nan
    first = exchanged(path)
    if not len(first):
        return []
    share = 2 * len(first) / len(tracked)
    a, b = first[0], first[0] + 1
    pairs = f"{len(first)} pairs of neighbouring frames are in the wrong order on the path (the first: {a} and {b})"
    which = pairs if len(first) > 1 else f"the neighbouring frames {a} and {b} are in the wrong order on the path"
    text = f"{which}: their images or their time stamps are exchanged"
    return [Note(NoteKind.CONTRADICTED if share > MANY else NoteKind.ASSUMED, text)]


def followed_path(tracked: Tracked) -> Floats:
    """T_world_cam (n, 4, 4) chained from keyframe to keyframe; NaN for frames whose motion since one is not known.

    After such a frame the path starts again at the identity.
    """
    T, determined = np.full((len(tracked), 4, 4), np.nan), tracked.determined
    for k, key in enumerate(tracked.key.tolist()):
        if key < k and determined[k]:
            start = T[key] if np.isfinite(T[key, 0, 0]) else np.eye(4)
            T[key] = start
            T[k] = start @ se3.inverse(tracked.T_cam_key[k])
    return T


def exchanged(T_world_cam: Floats) -> Ints:
    """Frames k for which the path through k - 1, k, k + 1, k + 2 is much shorter with k and k + 1 exchanged.

    T_world_cam (n, 4, 4), rows in the order of time; NaN where there is no pose.
    """
    a, b, c, d = (T_world_cam[k : len(T_world_cam) - 3 + k] for k in range(4))
    middle = _length(b, c)
    way, other = _length(a, b) + middle + _length(c, d), _length(a, c) + middle + _length(b, d)
    return np.flatnonzero((other < SHORTER * way) & (middle > LEAST_STEP)) + 1


def _length(T_world_a: Floats, T_world_b: Floats) -> Floats:
    """(n,) angle in rad plus distance in m from poses (n, 4, 4) to others; NaN where one is not known."""
    T_a_b, length = se3.inverse(T_world_a) @ T_world_b, np.full(len(T_world_a), np.nan)
    known = np.flatnonzero(np.isfinite(T_a_b[:, 0, 0]))
    angle = np.radians(se3.rotation_angle_deg(T_a_b[known, :3, :3]))
    length[known] = angle + np.linalg.norm(T_a_b[known, :3, 3], axis=1)
    return length
