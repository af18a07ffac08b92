"""Frames of a folder with colour images in one sub-folder and depth in another: by tables, or by their names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from miniloop_cli.datasets.beside import unused_associations
from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.pairing import Paired, pair, pair_rows
from miniloop_cli.datasets.paths import DEPTH_SUFFIXES, IMAGE_SUFFIXES, list_files, shown
from miniloop_cli.datasets.stream import Stream, named_stream
from miniloop_cli.datasets.tables import read_associations, read_table
from miniloop_cli.scene.sequence import Note, dropped_images

# Further folders for bare file names of a table, besides the folder that the table is named after.
COLOR_FOLDERS = ("rgb", "color", "colour", "image", "images", "cam0")
DEPTH_FOLDERS = ("depth", "depths")


def find_frames(root: Path, color: str, depth: str) -> Paired:
    """The frames of `root`, with images in its sub-folders `color` and `depth`.

    An association file pairs them row by row if a table <sub-folder>.txt is missing; else their times come from the
    tables, or from the names of the images. Raises InputError for images that cannot be read or paired.
    """
    tables = [root / f"{name}.txt" for name in (color, depth)]
    associations = association_files(root)
    if associations and not all(table.exists() for table in tables):
        both = read_associations(root, associations[0].name, COLOR_FOLDERS, DEPTH_FOLDERS)
        found = pair_rows(root, *both)
        return replace(found, notes=(*found.notes, *_unnamed(root, both)))
    streams = (
        _stream(root, color, (color, *COLOR_FOLDERS), IMAGE_SUFFIXES),
        _stream(root, depth, (depth, *DEPTH_FOLDERS), DEPTH_SUFFIXES),
    )
    found = pair(root, *streams, together=False)
    beside = unused_associations([path.name for path in associations])
    return replace(found, notes=(*found.notes, *_unnamed(root, streams), *beside))


def association_files(root: Path) -> list[Path]:
    """Files that look like an association table, by their names."""
    return sorted(path for path in root.glob("*assoc*.txt") if path.is_file())


def _unnamed(root: Path, streams: tuple[Stream, Stream]) -> Iterator[Note]:
    """Notes on images in the folders of a table that no row names."""
    named = {source.path for stream in streams for source in stream.sources if isinstance(source, ImageFile)}
    for stream in streams:
        folders = {source.path.parent for source in stream.sources if isinstance(source, ImageFile)}
        for folder in sorted(folders) if not stream.where.endswith("/") else ():
            if not folder.is_dir():
                continue
            images, _ = list_files(folder, ".", (*IMAGE_SUFFIXES, *DEPTH_SUFFIXES))
            left = [path for path in images if path not in named]
            if left:
                inside = shown(folder.relative_to(root))
                text = f"{len(left)} of {len(images)} images in {inside}/ are not used, such as {shown(left[0].name)}"
                text = f"{text}: {stream.where} has no usable row for them"
                yield dropped_images(text, len(left), len(images))


def _stream(root: Path, folder: str, folders: tuple[str, ...], suffixes: tuple[str, ...]) -> Stream:
    if (root / f"{folder}.txt").exists():
        return read_table(root, f"{folder}.txt", folders)
    return named_stream(root, folder, suffixes)
