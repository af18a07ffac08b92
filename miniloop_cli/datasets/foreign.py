"""Recordings of other tools that no layout reads yet: their names, and how to convert them."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from miniloop_cli.datasets.archive_path import ArchivePath
from miniloop_cli.datasets.paths import shown

ARCHIVE = "an archive: unpack it, then give the folder"
FILES = {
    ".mkv": "a file of another kind than its name says: Azure Kinect recordings are Matroska files",
    ".oni": "an OpenNI recording: write its frames to rgb/ and depth/ (16-bit PNG, registered, named by time)",
    ".mp4": "a video, which holds no depth: give the folder with the depth images",
    ".mov": "a video, which holds no depth: give the folder with the depth images",
    ".ply": "a model, not a recording",
    ".pcd": "a model, not a recording",
    ".gz": ARCHIVE,
    ".bz2": ARCHIVE,
    ".xz": ARCHIVE,
    ".7z": ARCHIVE,
}
RECORDINGS = (".oni",)
READ_AS_FILES = (
    ".bag",
    ".db3",
    ".mcap",
    ".mkv",
    ".klg",
    ".sens",
    ".r3d",
)  # by a layout, if given themselves

# The files of a folder, and the kind of recording that they show.
FOLDERS: tuple[tuple[Collection[str], str], ...] = (
    (("iphone", "dslr"), "a scene of ScanNet++ whose iphone/ lacks rgb.mp4, depth.bin or pose_intrinsic_imu.json"),
    (("mav0",), "a EuRoC recording, which has no depth images"),
)


def what_it_is(root: Path, children: list[Path]) -> str | None:
    """One line on a known file or folder of another tool, with what to do; None if it is unknown."""
    if not root.is_dir():
        said = FILES.get(root.suffix.lower())
        return f"{shown(root)} is {said}" if said else None
    names = {child.name for child in children}
    for needed, said in FOLDERS:
        if names.issuperset(needed):
            return f"{shown(root)} is {said}"
    files = [child for child in children if child.suffix.lower() in READ_AS_FILES and child.is_file()]
    if files:
        where = "unpack it, then give" if isinstance(root, ArchivePath) else "give"
        return f"{shown(root)} holds {shown(files[0].name)}: {where} that file itself"
    held = next((child for child in children if child.suffix.lower() in RECORDINGS and child.is_file()), None)
    return f"{shown(root)} holds {shown(held.name)}, {FILES[held.suffix.lower()]}" if held else None
