"""Reading frames, one at a time: stored images become colour and depth in metres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.own_cameras import to_common
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.registry import find_layout
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.no_depth import NoDepth
from miniloop_cli.scene.sequence import Frame, Scan, Sequence, Trajectory
from miniloop_cli.typing import Bools, Bytes, Floats32

Shape = tuple[int, ...]
DEPTH_MUST_BE = "depth must have one channel of 16 bits"
FLOATING_MUST_BE = "depth must have one channel of 32-bit float, as the other frames have"
MAX_ASPECT_DIFFERENCE = 0.02  # of depth of lower resolution against colour


def read_color(source: ImageSource) -> Bytes:
    """(h, w, 3) uint8 RGB; grey is repeated, of 16 bits the upper 8 are used. Raises InputError (reason only)."""
    stored = source.read()
    if stored.dtype == np.uint16:
        stored = (stored >> 8).astype(np.uint8)
    return np.repeat(stored[..., None], 3, axis=2) if stored.ndim == 2 else stored


def read_depth(source: ImageSource, floating: bool = False) -> NDArray[Any]:
    """(h, w) uint16 as stored; float32 if `floating`, with 0 for values that are not finite or not positive.

    Raises InputError (reason only) for other types and for several channels.
    """
    stored = source.read()
    if stored.dtype != (np.float32 if floating else np.uint16) or stored.ndim != 2:
        raise InputError(f"{FLOATING_MUST_BE if floating else DEPTH_MUST_BE}, this is a {source.header()}")
    return np.where(np.isfinite(stored) & (stored > 0), stored, np.float32(0)) if floating else stored


def read_mask(source: ImageSource) -> Bools:
    """(h, w) bool: True = ignore, where any channel is not 0. Raises InputError (reason only)."""
    return read_color(source).max(axis=2) > 0


def read_scan(sequence: Sequence, index: int) -> Scan:
    """Decode frame `index`: colour as stored, depth in metres on the pixels of colour, 0 where it is not usable.

    Raises InputError naming frame and file for an image that is missing, broken, too large, or of another size than
    the camera's; other frames are not affected.
    """
    frame = sequence.frames[index]
    source = frame.color
    try:
        color = read_color(source)
        require_color_size(color.shape, sequence.camera)
        source = frame.depth
        stored = _stored_depth(sequence, source, color.shape)
        mask = None
        if frame.mask:
            source = frame.mask
            mask = read_mask(source)
            if mask.shape != color.shape[:2]:
                raise InputError(f"the mask is {_size(mask.shape)}, colour {_size(color.shape)}")
        if frame.camera and not sequence.depth_camera:
            color, stored, mask = _as_common(color, stored, mask, frame.camera, sequence.camera)
    except InputError as error:
        raise InputError(f"frame {index} ({_name_in(sequence.root, source)}): {error}") from None
    depth_m = _registered(sequence, frame, _in_metres(sequence, stored))
    if not sequence.camera.depth_model.exact:
        depth_m = sequence.camera.depth_model.of_image(depth_m)
    if mask is not None:
        depth_m[mask] = 0
    return Scan(color, depth_m, mask)


def read_own_depth(sequence: Sequence, index: int) -> Floats32:
    """The depth (h, w) m of frame `index` as its camera measured it, 0 = none. Raises InputError (reason only)."""
    size = sequence.camera.height, sequence.camera.width
    return _in_metres(sequence, _stored_depth(sequence, sequence.frames[index].depth, size))


def _in_metres(sequence: Sequence, stored: NDArray[Any]) -> Floats32:
    depth_m = stored.astype(np.float32) / np.float32(sequence.camera.depth_scale)
    for value in sequence.depth_format.no_reading:
        depth_m[stored == np.asarray(value, stored.dtype)] = 0
    return depth_m


def _registered(sequence: Sequence, frame: Frame, depth_m: Floats32) -> Floats32:
    """Depth of a separate depth camera on the pixels of colour."""
    own = sequence.depth_camera
    if own is None or isinstance(frame.depth, NoDepth) or own.sees_as(sequence.camera):
        return depth_m
    # Imported here, as most recordings are registered and need no compiled kernels.
    from miniloop_cli.geometry.depth_registration import register_depth

    return register_depth(depth_m, own.camera, sequence.camera, own.T_color_depth)


def _stored_depth(sequence: Sequence, source: ImageSource, color: Shape) -> NDArray[Any]:
    """Depth as stored, of the size for colour (h, w, 3)."""
    if isinstance(source, NoDepth):
        return np.zeros(color[:2], np.uint16)
    stored = read_depth(source, sequence.depth_format.floating)
    if sequence.depth_camera:
        _require_depth_size(stored.shape, sequence.depth_camera.camera)
    elif sequence.depth_format.resample:
        return _resampled(stored, color)
    else:
        _require_registered(stored.shape, color)
    return stored


def check_headers(sequence: Sequence, index: int) -> None:
    """Check by their headers that the images of frame `index` exist with the right types and sizes.

    Raises InputError (reason only) if `read_scan` would refuse the frame for these.
    """
    frame = sequence.frames[index]
    color, depth = frame.color.header(), frame.depth.header()
    require_color_size((color.height, color.width), sequence.camera)
    floating = sequence.depth_format.floating
    if (depth.bits, depth.channels) != (32 if floating else 16, 1):
        raise InputError(f"{FLOATING_MUST_BE if floating else DEPTH_MUST_BE}, this is a {depth}")
    if sequence.depth_camera:
        _require_depth_size((depth.height, depth.width), sequence.depth_camera.camera)
    elif not sequence.depth_format.resample:
        _require_registered((depth.height, depth.width), (color.height, color.width))


def read_ground_truth(sequence: Sequence) -> Trajectory | None:
    """The reference poses that came with the recording, in the convention of `Trajectory`; None if there are none.

    Raises InputError naming file and line if they cannot be read.
    """
    with_depth = tuple(frame for frame in sequence.frames if not isinstance(frame.depth, NoDepth))
    return find_layout(sequence.layout).ground_truth(replace(sequence, frames=with_depth))  # rows may count the pairs


def require_color_size(shape: Shape, camera: Camera) -> None:
    """Raise InputError (reason only) unless the camera is for images (h, w, ...) of this shape."""
    if shape[:2] != (camera.height, camera.width):
        raise InputError(f"colour is {_size(shape)}, the camera {camera.width} x {camera.height} ({camera.source})")


def _as_common(
    color: Bytes, stored: NDArray[Any], mask: Bools | None, own: Camera, common: Camera
) -> tuple[Bytes, NDArray[Any], Bools]:
    """A frame with its own camera, resampled to the common one; the mask also hides pixels that it did not see."""
    hidden = np.where(mask, np.uint16(1), np.uint16(0)) if mask is not None else np.zeros(stored.shape, np.uint16)
    _, hidden, _ = to_common(color, hidden, own, common)
    color, stored, unseen = to_common(color, stored, own, common)
    return color, stored, (hidden > 0) | unseen


def _require_depth_size(shape: Shape, camera: Camera) -> None:
    if shape[:2] != (camera.height, camera.width):
        raise InputError(f"depth is {_size(shape)}, the depth camera {camera.width} x {camera.height}")


def _require_registered(depth: Shape, color: Shape) -> None:
    if depth[:2] != color[:2]:
        raise InputError(f"depth is {_size(depth)}, colour {_size(color)}; depth must be registered")


def _resampled(stored: NDArray[Any], shape: Shape) -> NDArray[Any]:
    """Nearest neighbours, so that no depth is interpolated across an edge; the aspect ratio must agree."""
    import cv2

    ratio = stored.shape[0] * shape[1] / (stored.shape[1] * shape[0])
    if abs(ratio - 1) > MAX_ASPECT_DIFFERENCE:
        raise InputError(f"depth is {_size(stored.shape)}, colour {_size(shape)}; not the same field of view")
    return cv2.resize(stored, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST_EXACT)


def _size(shape: Shape) -> str:
    return f"{shape[1]} x {shape[0]}"


def _name_in(root: Path, source: ImageSource) -> str:
    path = Path(source.name)
    return shown(path.relative_to(root)) if path.is_relative_to(root) else shown(path)
