"""Frames of a folder with colour images in one sub-folder and depth in another: by tables, or by their names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from miniloop_cli.datasets.beside import unused_associations
from miniloop_cli.datasets.pairing import Paired, pair, pair_rows
from miniloop_cli.datasets.paths import DEPTH_SUFFIXES, IMAGE_SUFFIXES
from miniloop_cli.datasets.stream import Stream, named_stream
from miniloop_cli.datasets.tables import read_associations, read_table

# Where bare file names of a table are looked for, beside the folder that the table is named after.
COLOR_FOLDERS = ("rgb", "color", "colour", "image", "images", "cam0")
DEPTH_FOLDERS = ("depth", "depths")


def find_frames(root: Path, color: str, depth: str) -> Paired:
    """The frames of `root`, with images in its sub-folders `color` and `depth`.

    An association file pairs them row by row where a table <sub-folder>.txt is missing; else the tables, or the names
    of the images, say when each was taken. Raises InputError for what cannot be read or paired.
    """
    tables = [root / f"{name}.txt" for name in (color, depth)]
    associations = association_files(root)
    if associations and not all(table.exists() for table in tables):
        return pair_rows(root, *read_associations(root, associations[0].name, COLOR_FOLDERS, DEPTH_FOLDERS))
    streams = (
        _stream(root, color, (color, *COLOR_FOLDERS), IMAGE_SUFFIXES),
        _stream(root, depth, (depth, *DEPTH_FOLDERS), DEPTH_SUFFIXES),
    )
    found = pair(root, *streams, together=False)
    return replace(found, notes=(*found.notes, *unused_associations([path.name for path in associations])))


def association_files(root: Path) -> list[Path]:
    """Files that look like an association table, by their names."""
    return sorted(path for path in root.glob("*assoc*.txt") if path.is_file())


def _stream(root: Path, folder: str, folders: tuple[str, ...], suffixes: tuple[str, ...]) -> Stream:
    if (root / f"{folder}.txt").exists():
        return read_table(root, f"{folder}.txt", folders)
    return named_stream(root, folder, suffixes)
