"""Intrinsics of single frames: phones refocus while they record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import Frame, Note, NoteKind, Sequence
from miniloop_cli.typing import Floats

SAME_FOCAL = 5e-4
MIN_MOVED_PX = 0.25  # at the corners of the image; with less it is not resampled


def with_own_cameras(
    frames: tuple[Frame, ...], pinholes: Mapping[ImageSource, Floats], common: Camera
) -> tuple[tuple[Frame, ...], tuple[Note, ...]]:
    """Frames with their own cameras (4,) fx fy cx cy where these differ from the common one; notes."""
    own = []
    for frame in frames:
        found = pinholes.get(frame.color)
        if found is None:
            own.append(frame)
            continue
        fx, fy, cx, cy = map(float, found)
        camera = replace(common, fx=fx, fy=fy, cx=cx, cy=cy)
        own.append(replace(frame, camera=camera) if _moved_px(camera, common) > MIN_MOVED_PX else frame)
    resampled = sum(frame.camera is not None for frame in own)
    if not resampled:
        return frames, ()
    stray = max(abs(frame.camera.fx / common.fx - 1) for frame in own if frame.camera)
    what = f"the focal length varies by up to {100 * stray:.1f} %"
    if stray < SAME_FOCAL:
        moved = max(max(abs(f.camera.cx - common.cx), abs(f.camera.cy - common.cy)) for f in own if f.camera)
        what = f"the principal point varies by up to {moved:.1f} px"
    text = (
        f"{what} from its median: {resampled} of {len(frames)} frames are resampled from their own camera to the "
        "median one"
    )
    return tuple(own), (Note(NoteKind.CONVERTED, text),)


def with_camera(sequence: Sequence, camera: Camera) -> Sequence:
    """The recording with another common camera; frames with their own camera are resampled as before."""
    frames = []
    for frame in sequence.frames:
        if frame.camera:
            M = _from_common(frame.camera, sequence.camera)
            fx, fy = M[0, 0] * camera.fx, M[1, 1] * camera.fy
            cx, cy = (M @ np.array([camera.cx, camera.cy, 1.0])).tolist()
            frames.append(replace(frame, camera=replace(camera, fx=float(fx), fy=float(fy), cx=cx, cy=cy)))
        else:
            frames.append(frame)
    return replace(sequence, camera=camera, frames=tuple(frames))


def to_common(
    color: NDArray[np.uint8], stored: NDArray, own: Camera, common: Camera
) -> tuple[NDArray[np.uint8], NDArray, NDArray[np.bool_]]:
    """Colour (h, w, 3) and depth (h, w) of a frame's own camera, resampled to the common one; pixels (h, w) it missed.

    Depth along the optical axis keeps its value; it is that of the nearest pixel, never interpolated.
    """
    import cv2

    M, size = _from_common(own, common), (common.width, common.height)
    linear = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    moved = np.asarray(cv2.warpAffine(color, M, size, flags=linear, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    depth = np.asarray(cv2.warpAffine(stored, M, size, flags=nearest), stored.dtype)
    seen = cv2.warpAffine(np.ones(stored.shape, np.uint8), M, size, flags=nearest)
    return moved, depth, np.asarray(seen) == 0


def _from_common(own: Camera, common: Camera) -> Floats:
    """(2, 3) affine map from pixels of the common camera to those of a frame's own."""
    x, y = own.fx / common.fx, own.fy / common.fy
    return np.array([[x, 0, own.cx - common.cx * x], [0, y, own.cy - common.cy * y]])


def _moved_px(own: Camera, common: Camera) -> float:
    corners = np.array([[0, 0, 1], [common.width - 1, common.height - 1, 1]], float)
    return float(np.abs(corners @ _from_common(own, common).T - corners[:, :2]).max())
