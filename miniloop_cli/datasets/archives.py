"""Archives of files: ZIP and tar, listed once and read member by member; nothing is unpacked.

A compressed tar has no index and can only be read from its start: it is decompressed once, as a whole, to one tar in
the cache folder.
"""

from __future__ import annotations

import bz2
import gzip
import hashlib
import io
import lzma
import os
import shutil
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import BinaryIO, TypeVar, cast

from miniloop_cli.datasets.damage import damage
from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import InputError
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.cache_folder import cache_folder
from miniloop_cli.runtime.kept_open import KeptOpen

ZIP_SUFFIXES = (".zip",)
TAR_SUFFIXES = (".tar",)
COMPRESSED_TARS = (".tgz", ".tar.gz", ".tbz2", ".tar.bz2", ".txz", ".tar.xz")
ARCHIVE_SUFFIXES = (*ZIP_SUFFIXES, *TAR_SUFFIXES, *COMPRESSED_TARS)
MOST_MEMBERS = 2_000_000
MAX_UNPACKED_BYTES = 64 << 30
FREE_BYTES = 1 << 30  # left on the disk
MAX_RATIO, ALWAYS_BYTES = (
    500,
    64 << 20,
)  # of a member: larger ones that expand more are refused
DAMAGE = (zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, EOFError, ValueError, RuntimeError, OSError)
T = TypeVar("T")


@dataclass
class Archive:
    """The files of an archive by name (folders with `/`), their sizes (bytes), and how each is opened."""

    sizes: dict[str, int]
    open_member: Callable[[str], BinaryIO]
    links: int = 0  # members that are neither files nor folders
    folders: dict[str, dict[str, None]] = field(default_factory=dict)  # names in each folder, in order; "" is the top

    def __post_init__(self) -> None:
        for name in self.sizes:
            parts = name.split("/")
            for k, part in enumerate(parts):
                inside = self.folders.setdefault("/".join(parts[:k]), {})
                if part in inside and k < len(parts) - 1:
                    continue
                inside[part] = None


def is_archive(path: Path) -> bool:
    """By the name."""
    return path.name.lower().endswith(ARCHIVE_SUFFIXES)


def open_archive(path: Path | str) -> Archive:
    """The archive at `path`, kept open. Raises InputError for one that is damaged or unsafe."""
    try:
        return _KEPT.get(path)
    except OSError as error:
        raise InputError(f"cannot read {shown(path)}: {error.strerror or error}") from error


def _open(path: Path) -> Archive:
    name = path.name.lower()
    with damage(lambda error: f"{shown(path)} is damaged, incomplete or not an archive: {shown(str(error))}"):
        if name.endswith(TAR_SUFFIXES):
            return _open_tar(path, path)
        if name.endswith(COMPRESSED_TARS):
            return _open_tar(path, _decompressed(path))
        return _open_zip(path)


_KEPT = KeptOpen(_open)


def _open_zip(path: Path) -> Archive:
    archive = zipfile.ZipFile(path)
    members = dict(_safe(path, ((info.filename, info) for info in archive.infolist() if not info.is_dir())))

    def open_member(name: str) -> BinaryIO:
        info = members[name]
        if info.flag_bits & 1:
            raise OSError("it is encrypted")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise OSError("its compression is not supported: ZIP archives must use deflate; pack it again")
        if info.file_size > max(ALWAYS_BYTES, MAX_RATIO * info.compress_size):
            raise OSError(
                f"it claims {info.file_size / 2**20:.0f} MB from {info.compress_size} compressed bytes, which is not "
                "plausible"
            )
        try:
            return io.BufferedReader(_Member(cast("zipfile.ZipExtFile", archive.open(info))))
        except DAMAGE as error:
            raise OSError(f"damaged in the archive: {error}") from error

    return Archive({name: info.file_size for name, info in members.items()}, open_member)


class _Member(io.RawIOBase):
    """A member of a ZIP archive; damage raises OSError, as with ordinary files."""

    def __init__(self, inner: zipfile.ZipExtFile) -> None:
        self._inner = inner

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return self._inner.seekable()

    def readinto(self, buffer: bytearray | memoryview) -> int:  # type: ignore[override]
        try:
            data = self._inner.read(len(buffer))
        except DAMAGE as error:
            raise OSError(f"damaged in the archive: {error}") from error
        buffer[: len(data)] = data
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        try:
            return self._inner.seek(offset, whence)
        except DAMAGE as error:
            raise OSError(f"damaged in the archive: {error}") from error

    def tell(self) -> int:
        return self._inner.tell()


def _open_tar(path: Path, tar: Path) -> Archive:
    """The tar file `tar`, which for messages is `path`. Members are read by their place in the file."""
    links = 0
    with tarfile.open(tar, "r:") as archive:

        def files() -> Iterator[tuple[str, tuple[int, int]]]:
            nonlocal links
            while (member := archive.next()) is not None:
                archive.members.clear()  # type: ignore[attr-defined]  # they would all be kept
                if member.isreg() and not member.issparse():
                    yield member.name, (member.offset_data, member.size)
                elif not member.isdir():
                    links += 1

        places = dict(_safe(path, files()))

    def open_member(name: str) -> BinaryIO:
        offset, size = places[name]
        with tar.open("rb") as file:
            if size > ALWAYS_BYTES << 2:
                raise OSError(f"it has {size / 2**20:.0f} MB")
            file.seek(offset)
            return io.BytesIO(file.read(size))

    return Archive({name: size for name, (_, size) in places.items()}, open_member, links)


def _safe(path: Path, members: Iterable[tuple[str, T]]) -> Iterator[tuple[str, T]]:
    """Members by normalised names. Raises InputError for names outside the folder, repeated ones, and too many."""
    seen: set[str] = set()
    for name, what in members:
        plain = name.replace("\\", "/")
        parts = [part for part in plain.split("/") if part not in ("", ".")]
        if ".." in parts or plain.startswith("/") or (parts and ":" in parts[0]) or "\0" in plain or not parts:
            raise InputError(
                f"{shown(path)}: the member {shown(name)} points outside the folder; pack the folder again"
            )
        normal = "/".join(parts)
        if normal in seen:
            raise InputError(f"{shown(path)}: two members are called {shown(normal)}; pack the folder again")
        if len(seen) >= MOST_MEMBERS:
            raise InputError(f"{shown(path)} has more than {MOST_MEMBERS} members: unpack it, then give the folder")
        seen.add(normal)
        yield normal, what
    folders = {str(parent) for name in seen for parent in PurePosixPath(name).parents}
    if both := next((name for name in seen if name in folders), None):
        raise InputError(f"{shown(path)}: {shown(both)} is both a file and a folder; pack the folder again")


def unpacked_path(path: Path) -> Path:
    """The cached content of a compressed tar, named by the file's path, size and time of change."""
    state = path.stat()
    key = hashlib.sha256(f"{path.resolve()}\0{state.st_size}\0{state.st_mtime_ns}".encode()).hexdigest()
    return cache_folder() / "unpacked" / f"{key}.tar"


def _decompressed(path: Path) -> Path:
    target = unpacked_path(path)
    if target.exists():
        os.utime(target)  # the time of last use, for pruning
        return target
    name = path.name.lower()
    kind = gzip.open if name.endswith("gz") else bz2.open if name.endswith("bz2") else lzma.open
    target.parent.mkdir(parents=True, exist_ok=True)
    limit = min(MAX_UNPACKED_BYTES, shutil.disk_usage(target.parent).free - FREE_BYTES)
    with atomic_write(target, "wb") as file, kind(path, "rb") as stream:
        written = 0
        while True:
            try:
                block = stream.read(1 << 20)
            except DAMAGE as error:  # atomic_write would report an OSError as one of writing
                raise InputError(
                    f"{shown(path)} is damaged, incomplete or not an archive: {shown(str(error))}"
                ) from error
            if not block:
                return target
            written += len(block)
            if written > limit:
                what = f"{shown(path)} holds more than the {max(limit, 0) / 2**30:.1f} GB that may be unpacked"
                raise InputError(f"{what} in {shown(target.parent)}; unpack it, then give the folder")
            file.write(block)
