"""Opening a recording: its layout, its frames, its camera, the unit of its depth."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.archive_path import ArchivePath, entered, from_archive, is_archive, levels
from miniloop_cli.datasets.camera_files import read_depth_camera
from miniloop_cli.datasets.camera_trust import with_trust
from miniloop_cli.datasets.confidence import MIN_CONFIDENCE, ConfidentDepth, with_min_confidence
from miniloop_cli.datasets.depth_values import understand_depth
from miniloop_cli.datasets.foreign import what_it_is
from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.layout import Layout, TopicLayout
from miniloop_cli.datasets.paths import require_inside, shown, within
from miniloop_cli.datasets.read import require_color_size
from miniloop_cli.datasets.registry import BUILT_IN, find_layout, known_layouts, load_layouts
from miniloop_cli.datasets.upright import with_upright_colour
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Trust
from miniloop_cli.scene.sequence import Frame, Note, NoteKind, Sequence

LOG = logging.getLogger("miniloop")
LOOKED_INTO = 20  # sub-folders that are searched for a recording, to suggest it


def open_sequence(
    path: Path | str,
    layout: str | None = None,
    camera_path: Path | str | None = None,
    max_frames: int | None = None,
    follow_links: bool = False,
    topics: str = "",
    min_confidence: int = MIN_CONFIDENCE,
) -> Sequence:
    """Open a recording; its layout is recognised from the folder (or file) unless `layout` names it.

    `camera_path` is a camera file that replaces the camera of the recording; with `max_frames`, only so many evenly
    spaced frames are used. Images behind symbolic links that point outside the folder are refused unless
    `follow_links`. `topics` names the streams of a bag, as color=/a,depth=/b; `min_confidence` is the setting
    depth.min_confidence. Only the headers of a few images are decoded, to check their size, and a few depth images, to
    find their unit and the values that mean "no reading".

    Raises InputError (or ConfigError for the camera file) that names what is missing and what to do.
    """
    root = entered(Path(path).absolute())
    children = _children(root)
    if root.is_file() and is_archive(root):
        folders = (root, *levels(root))
        known = (p for p in folders if (find_layout(layout).matches(p) if layout else recognise(p)))
        root = next(known, folders[-1])
        children = _children(root)
    name = layout or recognise(root)
    if name is None:
        raise InputError(_why_unknown(root, children))
    reader = find_layout(name)
    if topics:
        _set_topics(reader, topics, root, name)
    sequence = reader.open(root, Path(camera_path) if camera_path else None)
    camera = with_trust(sequence.camera, name, camera_path is not None)
    sequence = with_min_confidence(replace(sequence, camera=camera, layout=name, topics=topics), min_confidence)
    sequence = _with_depth_camera(sequence, Path(camera_path) if camera_path else root / "camera.yaml")
    if isinstance(root, ArchivePath):
        sequence = from_archive(sequence, root)
    sequence = _with_masks(sequence)
    if not follow_links:
        require_inside(root, _files(sequence))
    sequence = with_upright_colour(sequence)
    _check_size(sequence)
    sequence = understand_depth(sequence)
    return sequence if max_frames is None else sequence.thinned(max_frames)


def _with_depth_camera(sequence: Sequence, path: Path) -> Sequence:
    """The recording with the depth camera that its camera file names, if it names one."""
    own = read_depth_camera(path, sequence.camera) if path.is_file() else None
    if own is None:
        return sequence
    if own.camera.trust == Trust.GUESS:
        return replace(sequence, depth_camera=own)
    text = "the camera file describes a separate depth camera: depth is registered to colour while it is read"
    return replace(sequence, depth_camera=own, notes=(*sequence.notes, Note(NoteKind.CONVERTED, text)))


def _set_topics(reader: Layout, topics: str, root: Path, name: str) -> None:
    from miniloop_cli.datasets.bags.topics import parse_topics

    if not isinstance(reader, TopicLayout):
        raise InputError(f"--topics is for bags; {shown(root)} is a recording of layout {name}")
    reader.topics = parse_topics(topics)


def _children(root: Path) -> list[Path]:
    """The content of a folder, sorted; nothing for a file. Raises InputError for other paths and unreadable ones."""
    try:
        if not root.exists():
            raise InputError(f"{shown(root)} does not exist")
        return sorted(root.iterdir()) if root.is_dir() else []
    except (OSError, ValueError) as error:
        raise InputError(f"cannot open {shown(root)}: {error}") from error


def recognise(root: Path) -> str | None:
    """The name of the first layout that matches `root`, None if none does. Raises InputError."""
    try:
        return _first_match(load_layouts(), root)
    except OSError as error:
        raise InputError(f"cannot look into {shown(root)}: {error.strerror or error}") from error


def _why_unknown(root: Path, children: list[Path]) -> str:
    if said := what_it_is(root, children):
        return said
    if not root.is_dir():
        return f"{shown(root)} is not a folder, and no supported layout reads such a file"
    if not children:
        return f"{shown(root)} is empty"
    folders = [child for child in children if child.is_dir()][:LOOKED_INTO]
    if inner := next((child for child in folders if recognise(child)), None):
        return f"{shown(root)} is not a recording itself; did you mean {shown(inner)}?"
    return f"{shown(root)} has no supported layout ({', '.join(known_layouts())}); see docs/recordings.md"


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
    """Raise InputError for a camera of another image size, before any frame is read; broken images do not count."""
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
    """Attach mask/<name of the colour image>.png if the recording has such a folder."""
    if not (sequence.root / "mask").is_dir():
        return sequence

    def masked(frame: Frame) -> Frame:
        name = Path(frame.color.name)
        path = within(sequence.root, f"mask/{name.stem}.png", f"the mask of {shown(name)}")
        return replace(frame, mask=ImageFile(path)) if path.exists() else frame

    sequence = sequence.with_frames(masked)
    found = sum(frame.mask is not None for frame in sequence.frames)
    text = f"masks for {found} of {len(sequence.frames)} frames: their pixels are ignored"
    kind = NoteKind.PAIRED if found == len(sequence.frames) else NoteKind.DROPPED
    return replace(sequence, notes=(*sequence.notes, Note(kind, text)))


def _files(sequence: Sequence) -> Iterator[Path]:
    """The files of the images of all frames, other than the recording itself."""
    for frame in sequence.with_color_only()[0].frames:
        depth = frame.depth
        parts = (depth.depth, depth.confidence) if isinstance(depth, ConfidentDepth) else (depth,)
        for source in (frame.color, *parts, frame.mask):
            path = getattr(source, "path", None)
            if isinstance(path, Path) and path != sequence.root:
                yield path
