"""Recordings on disk, whatever their layout: `open_sequence`, then `read_scan` frame by frame.

A layout is one small module with three functions, listed in LAYOUTS: `matches(root)` looks at the folder,
`open_folder(root, camera_path)` returns the Sequence without decoding anything, and `ground_truth(sequence)`
returns its reference Trajectory or None.
"""

from __future__ import annotations

import difflib
import importlib
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from miniloop_cli.datasets.paths import inside, shown
from miniloop_cli.datasets.trajectory import read_trajectory, write_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Scan, Sequence, Trajectory

__all__ = ["LAYOUTS", "open_sequence", "read_ground_truth", "read_scan", "read_trajectory", "write_trajectory"]

LAYOUTS = {  # in the order in which a folder is tried: the more special ones first
    "7-scenes": "miniloop_cli.datasets.seven_scenes",
    "polycam": "miniloop_cli.datasets.polycam",
    "record3d": "miniloop_cli.datasets.record3d",
    "icl-nuim": "miniloop_cli.datasets.icl_nuim",
    "scannet": "miniloop_cli.datasets.scannet",
    "open3d": "miniloop_cli.datasets.redwood",
    "tum": "miniloop_cli.datasets.tum",
}


def open_sequence(
    path: Path | str,
    layout: str | None = None,
    camera_path: Path | str | None = None,
    max_frames: int | None = None,
) -> Sequence:
    """Open a recording; its layout is found by looking at the folder unless `layout` names it.

    `camera_path` is a YAML camera file that overrules what the recording says; with `max_frames` only so many
    evenly spaced frames are kept. Nothing is decoded but the headers of a few images, to check their size.

    Raises InputError (or ConfigError for the camera file) that says what is missing and what to do.
    """
    root = Path(path).absolute()
    module = _layout_module(root, layout)
    sequence = module.open_folder(root, Path(camera_path) if camera_path else None)
    _check_size(sequence)
    sequence = _with_masks(sequence)
    if max_frames is not None and max_frames < len(sequence.frames):
        keep = np.round(np.linspace(0, len(sequence.frames) - 1, max(max_frames, 1))).astype(int)
        # Images that were left out on purpose are not images without partner.
        sequence = replace(sequence, frames=tuple(sequence.frames[i] for i in keep), available=(0, 0))
    return sequence


def read_scan(sequence: Sequence, index: int) -> Scan:
    """Decode frame `index`: colour as stored, depth in metres on the pixels of colour, 0 where it is not usable.

    Raises InputError naming frame and file for an image that is missing, broken, too large, or not what the
    camera says; the rest of the sequence is not concerned.
    """
    from miniloop_cli.datasets.images import read_color, read_depth, read_mask

    frame = sequence.frames[index]
    path = frame.color_path
    try:
        color = read_color(path)
        _require_size(color.shape, sequence)
        path = frame.depth_path
        stored = read_depth(path)
        if sequence.depth_format.resample:
            stored = _resample(stored, color.shape)
        elif stored.shape != color.shape[:2]:
            raise InputError(f"depth is {_size(stored.shape)}, colour {_size(color.shape)}; depth must be registered")
        mask = None
        if frame.mask_path:
            path = frame.mask_path
            mask = read_mask(path)
            if mask.shape != color.shape[:2]:
                raise InputError(f"the mask is {_size(mask.shape)}, colour {_size(color.shape)}")
    except InputError as error:
        name = shown(path.relative_to(sequence.root)) if path.is_relative_to(sequence.root) else shown(path)
        raise InputError(f"frame {index} ({name}): {error}") from None
    depth_m = stored.astype(np.float32) / np.float32(sequence.camera.depth_scale)
    if sequence.depth_format.no_reading is not None:
        depth_m[stored == sequence.depth_format.no_reading] = 0
    if mask is not None:
        depth_m[mask] = 0
    return Scan(color, depth_m, mask)


def read_ground_truth(sequence: Sequence) -> Trajectory | None:
    """The reference poses that came with the recording, in the convention of `Trajectory`; None if there are none.

    Raises InputError naming file and line where they cannot be read.
    """
    return importlib.import_module(LAYOUTS[sequence.layout]).ground_truth(sequence)


def _layout_module(root: Path, layout: str | None) -> ModuleType:
    try:
        if not root.is_dir():
            raise InputError(f"{shown(root)} {'is not a folder' if root.exists() else 'does not exist'}")
        children = sorted(child for child in root.iterdir() if child.is_dir())
        empty = not children and not any(root.iterdir())
    except (OSError, ValueError) as error:
        raise InputError(f"cannot open {shown(root)}: {error}") from error
    if layout is not None:
        if layout not in LAYOUTS:
            near = difflib.get_close_matches(layout, LAYOUTS, n=1)
            raise InputError(
                f"unknown layout '{layout}'; {f'did you mean {near[0]!r}? ' if near else ''}known: {', '.join(LAYOUTS)}"
            )
        return importlib.import_module(LAYOUTS[layout])
    modules = [importlib.import_module(name) for name in LAYOUTS.values()]

    def known(folder: Path) -> ModuleType | None:
        return next((module for module in modules if module.matches(folder)), None)

    try:
        if module := known(root):
            return module
        inner = next((child for child in children[:20] if known(child)), None)
    except OSError as error:
        raise InputError(f"cannot look into {shown(root)}: {error.strerror or error}") from error
    if empty:
        raise InputError(f"{shown(root)} is empty")
    if inner:
        raise InputError(f"{shown(root)} is not a recording itself; did you mean {shown(inner)}?")
    raise InputError(f"{shown(root)} has no layout known here ({', '.join(LAYOUTS)}); see docs/recordings.md")


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"


def _require_size(shape: tuple[int, ...], sequence: Sequence) -> None:
    camera = sequence.camera
    if shape[:2] != (camera.height, camera.width):
        raise InputError(f"colour is {_size(shape)}, the camera {camera.width} x {camera.height} ({camera.source})")


def _check_size(sequence: Sequence) -> None:
    """Refuse a camera made for other images at once, instead of every frame later; broken images do not vote."""
    from miniloop_cli.datasets.images import read_header

    problems: list[InputError] = []
    for k in np.linspace(0, len(sequence.frames) - 1, 5).round().astype(int):
        try:
            header = read_header(sequence.frames[k].color_path)
        except InputError:
            continue
        try:
            _require_size((header.height, header.width), sequence)
            return
        except InputError as error:
            problems.append(error)
    if problems:
        raise InputError(f"{shown(sequence.root)}: {problems[0]}; give the right one with --camera FILE")


def _with_masks(sequence: Sequence) -> Sequence:
    """Attach mask/<name of the colour image>.png where the recording has such a folder."""
    folder = sequence.root / "mask"
    if not folder.is_dir():
        return sequence
    frames, found = [], 0
    for frame in sequence.frames:
        name = f"mask/{frame.color_path.stem}.png"
        path = inside(sequence.root, name, f"the mask of {shown(frame.color_path)}")
        found += path.exists()
        frames.append(replace(frame, mask_path=path) if path.exists() else frame)
    notes = (*sequence.notes, f"masks for {found} of {len(frames)} frames: their pixels are ignored")
    return replace(sequence, frames=tuple(frames), notes=notes)


def _resample(stored: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Nearest neighbours, so that no depth is made up across an edge; the aspect ratio must agree to 2 %."""
    import cv2

    if abs(stored.shape[0] * shape[1] / (stored.shape[1] * shape[0]) - 1) > 0.02:
        raise InputError(f"depth is {_size(stored.shape)}, colour {_size(shape)}; not the same field of view")
    return cv2.resize(stored, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST_EXACT)
