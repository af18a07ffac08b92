"""Opening a recording: which layout it has, its frames, its camera, what its depth means."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.depth_values import understand_depth
from miniloop_cli.datasets.foreign import what_it_is
from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.layout import Layout
from miniloop_cli.datasets.paths import require_inside, shown, within
from miniloop_cli.datasets.read import require_color_size
from miniloop_cli.datasets.registry import BUILT_IN, find_layout, known_layouts, load_layouts
from miniloop_cli.datasets.upright import with_upright_colour
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Note, NoteKind, Sequence

LOG = logging.getLogger("miniloop")
LOOKED_INTO = 20  # sub-folders in which a recording is looked for, to name it


def open_sequence(
    path: Path | str,
    layout: str | None = None,
    camera_path: Path | str | None = None,
    max_frames: int | None = None,
    follow_links: bool = False,
) -> Sequence:
    """Open a recording; its layout is found by looking at the folder (or file) unless `layout` names it.

    `camera_path` is a YAML camera file that overrules what the recording says; with `max_frames` only so many
    evenly spaced frames are kept. Images behind symbolic links that lead out of the folder are refused unless
    `follow_links`. Decoded are the headers of a few images, to check their size, and a few depth images, to tell
    their unit and which values mean "no reading".

    Raises InputError (or ConfigError for the camera file) that says what is missing and what to do.
    """
    root = Path(path).absolute()
    children = _children(root)
    name = layout or recognise(root)
    if name is None:
        raise InputError(_why_unknown(root, children))
    sequence = find_layout(name).open(root, Path(camera_path) if camera_path else None)
    sequence = replace(sequence, layout=name)
    sequence = _with_masks(sequence)
    if not follow_links:
        require_inside(root, _files(sequence))
    sequence = with_upright_colour(sequence)
    _check_size(sequence)
    sequence = understand_depth(sequence)
    if max_frames is not None and max_frames < len(sequence.frames):
        keep = np.round(np.linspace(0, len(sequence.frames) - 1, max(max_frames, 1))).astype(int)
        # Images that were left out on purpose are not images without partner.
        sequence = replace(sequence, frames=tuple(sequence.frames[i] for i in keep), available=(0, 0))
    return sequence


def _children(root: Path) -> list[Path]:
    """What lies in a folder, sorted; nothing for a file. Raises InputError for what is neither, or cannot be opened."""
    try:
        if not root.exists():
            raise InputError(f"{shown(root)} does not exist")
        return sorted(root.iterdir()) if root.is_dir() else []
    except (OSError, ValueError) as error:
        raise InputError(f"cannot open {shown(root)}: {error}") from error


def recognise(root: Path) -> str | None:
    """The name of the first layout that takes `root` for its own, None if none does. Raises InputError."""
    try:
        return _first_match(load_layouts(), root)
    except OSError as error:
        raise InputError(f"cannot look into {shown(root)}: {error.strerror or error}") from error


def _why_unknown(root: Path, children: list[Path]) -> str:
    if said := what_it_is(root, children):
        return said
    if not root.is_dir():
        return f"{shown(root)} is not a folder, and no layout known here reads such a file"
    if not children:
        return f"{shown(root)} is empty"
    folders = [child for child in children if child.is_dir()][:LOOKED_INTO]
    if inner := next((child for child in folders if recognise(child)), None):
        return f"{shown(root)} is not a recording itself; did you mean {shown(inner)}?"
    return f"{shown(root)} has no layout known here ({', '.join(known_layouts())}); see docs/recordings.md"


def _first_match(layouts: dict[str, Layout], root: Path) -> str | None:
    for name, layout in layouts.items():
        try:
            if layout.matches(root):
                return name
        except Exception as error:
            if name in BUILT_IN:
                raise
            reason = f"{type(error).__name__}: {error}"
            LOG.warning("layout '%s' cannot look at %s and is left out (%s)", name, shown(root), reason)
    return None


def _check_size(sequence: Sequence) -> None:
    """Refuse a camera made for other images at once, instead of every frame later; broken images do not vote."""
    problems: list[InputError] = []
    for k in np.linspace(0, len(sequence.frames) - 1, 5).round().astype(int):
        try:
            header = sequence.frames[k].color.header()
        except InputError:
            continue
        try:
            require_color_size((header.height, header.width), sequence.camera)
            return
        except InputError as error:
            problems.append(error)
    if problems:
        raise InputError(f"{shown(sequence.root)}: {problems[0]}; give the right one with --camera FILE")


def _with_masks(sequence: Sequence) -> Sequence:
    """Attach mask/<name of the colour image>.png where the recording has such a folder."""
    if not (sequence.root / "mask").is_dir():
        return sequence
    frames, found = [], 0
    for frame in sequence.frames:
        name = Path(frame.color.name)
        path = within(sequence.root, f"mask/{name.stem}.png", f"the mask of {shown(name)}")
        found += path.exists()
        frames.append(replace(frame, mask=ImageFile(path)) if path.exists() else frame)
    text = f"masks for {found} of {len(frames)} frames: their pixels are ignored"
    kind = NoteKind.PAIRED if found == len(frames) else NoteKind.DROPPED
    return replace(sequence, frames=tuple(frames), notes=(*sequence.notes, Note(kind, text)))


def _files(sequence: Sequence) -> Iterator[Path]:
    """The image files of all frames."""
    for frame in sequence.frames:
        for source in (frame.color, frame.depth, frame.mask):
            if isinstance(source, ImageFile):
                yield source.path
