"""Whether ground truth and result use the same convention: unit of length, axes, direction, tracked body.

A result with large errors for other reasons agrees with no convention; it is evaluated unchanged, with a note.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.conventions import CONVENTIONS, difference, length_ratio, motions
from miniloop_cli.typing import Floats, Ints

BODY = "body"  # the convention of a tracked body that is fixed to the camera
MOST_POSES = 60  # of which all pairs are compared
MIN_POSES_FOR_BODY = 8
SAME, RELATED = 0.15, 0.5  # differences of motions below which poses agree, and below which they belong to one path
CLEARLY = 0.5  # a better convention leaves at most this much of the difference
TURNED_DEG, LEVER_M, MAX_LEVER_M = 10.0, 0.05, 2.0
UNITS = {1000.0: "millimetres", 100.0: "centimetres", 0.001: "kilometres"}
UNIT_SURE, UNIT_LIKELY = 0.01, 0.1


def in_our_convention(T_est: Floats, T_given: Floats, convention: str, any_scale: bool) -> tuple[Floats, list[str]]:
    """(n, 4, 4) true poses of the camera in metres from those given, and notes on conversions and doubts.

    `T_est` (n, 4, 4): the result's poses at the same times; `any_scale`: it has no scale of its own (Sim3).
    Raises MiniloopError if another convention than `convention`, or another unit, explains the result's motions; it
    names that one.
    """
    i, j = _pairs(len(T_est))
    known = motions(T_est, i, j)
    if convention == BODY:
        given, notes = _in_metres(T_given, motions(T_given, i, j), known, any_scale)
        body = _hand_eye(given, T_est, i, j)
        if body is None:
            raise MiniloopError("too few poses, or too little rotation, to find how the body sits on the camera")
        return given @ body, [*notes, f"camera on the tracked body fitted: {_offset(body)}"]
    T_true = CONVENTIONS[convention].ours(T_given)
    T_true, notes = _in_metres(T_true, motions(T_true, i, j), known, any_scale)
    notes = [CONVENTIONS[convention].words, *notes] if convention != "camera-to-world" else notes
    off = difference(motions(T_true, i, j), known)
    if off > SAME:
        _refuse_other_convention(T_given, convention, off, known, i, j)
    body = _hand_eye(T_true, T_est, i, j)
    if body is not None and off > 0:
        after = difference(motions(T_true @ body, i, j), known)
        turned, arm_m = se3.rotation_angle_deg(body[:3, :3]), np.linalg.norm(body[:3, 3])
        if after < min(CLEARLY * off, RELATED) and arm_m < MAX_LEVER_M and (turned > TURNED_DEG or arm_m > LEVER_M):
            words = f"poses of a body that sits {_offset(body)} from the camera (IMU, markers)"
            if turned > TURNED_DEG:
                raise MiniloopError(
                    f"the ground truth looks like {words}: give poses of the camera, or fit the offset with "
                    "--gt-convention body"
                )
            return T_true, [*notes, f"looks like {words}; --gt-convention body fits the offset"]
    if off > RELATED:
        notes.append("the motions of the result and of the ground truth differ: is the ground truth of this recording?")
    return T_true, notes


def _pairs(count: int) -> tuple[Ints, Ints]:
    """All pairs of at most MOST_POSES evenly spaced poses."""
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_POSES)).round().astype(int))
    first, second = np.triu_indices(len(chosen), 1)
    return chosen[first], chosen[second]


def _in_metres(T: Floats, given: Floats, known: Floats, any_scale: bool) -> tuple[Floats, list[str]]:
    """Poses with positions in metres. Raises MiniloopError if another unit is likely, but not certain."""
    ratio = length_ratio(given, known)
    for factor, unit in UNITS.items():
        if factor == 1000.0 and abs(ratio / factor - 1) <= UNIT_SURE:
            T = T.copy()
            T[:, :3, 3] /= factor
            return T, [f"positions in {unit} (motions {ratio:.5g} times as long as the result's)"]
        if not any_scale and abs(ratio / factor - 1) <= UNIT_LIKELY:
            raise MiniloopError(
                f"the ground truth's motions are {ratio:.4g} times as long as the result's: positions in {unit}? "
                "Write both in metres"
            )
    return T, []


def _refuse_other_convention(T_given: Floats, convention: str, off: float, known: Floats, i: Ints, j: Ints) -> None:
    others = {
        name: difference(motions(other.ours(T_given), i, j), known)
        for name, other in CONVENTIONS.items()
        if name != convention
    }
    best = min(others, key=lambda name: others[name])
    if others[best] < min(CLEARLY * off, RELATED):
        raise MiniloopError(
            f"the ground truth does not fit the result's motions as {CONVENTIONS[convention].words}, but as "
            f"{CONVENTIONS[best].words}: give --gt-convention {best}"
        )


def _hand_eye(T_body: Floats, T_cam: Floats, i: Ints, j: Ints) -> Floats | None:
    """The (4, 4) pose X of the camera on a body with T_cam = T_body X up to the world, in least squares.

    Motions A of the body and B of the camera obey A X = X B: rotation vectors are rotated by R_X, and
    (R_A - 1) t_X = R_X t_B - t_A. None for few poses or rotations about one axis only, which do not determine X.
    """
    if len(T_cam) < MIN_POSES_FOR_BODY:
        return None
    A, B = motions(T_body, i, j), motions(T_cam, i, j)
    a, b = se3.log_so3(A[:, :3, :3]), se3.log_so3(B[:, :3, :3])
    small = np.linalg.norm(b, axis=1) < 2.5  # near half a turn the axis flips
    spread = np.linalg.svd(b[small], compute_uv=False) / np.sqrt(max(small.sum(), 1))
    if small.sum() < MIN_POSES_FOR_BODY or spread[1] < np.radians(2):
        return None
    R = se3.project_so3(a[small].T @ b[small])
    turns, left = A[:, :3, :3] - np.eye(3), B[:, :3, 3] @ R.T - A[:, :3, 3]
    t = np.linalg.lstsq(turns.reshape(-1, 3), left.ravel(), rcond=None)[0]
    return se3.pose(R, np.asarray(t, np.float64))


def _offset(X: Floats) -> str:
    return f"{np.linalg.norm(X[:3, 3]) * 100:.1f} cm and {float(se3.rotation_angle_deg(X[:3, :3])):.1f} deg"
