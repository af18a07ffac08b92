"""The folder of a map: data files named by their hashes, and one manifest that lists those of the map.

Data files are never changed. A new state of the map is a new manifest, which replaces the old one in one step; files
that are no longer listed are removed afterwards. A process that reads while another one writes gets either the old
state or the new one, never a mixture, as every file must have the hash in the manifest.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Settings
from miniloop_cli.errors import MiniloopError
from miniloop_cli.results.map_arrays import joined_arrays, joined_from, part_arrays, part_from, part_header
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.scene_map import MapPart, SceneMap
from miniloop_cli.version import __version__

FOLDER, MANIFEST = "map", "map.json"
FORMAT, VERSION = "miniloop-map", 2
MAX_MANIFEST_BYTES = 64 << 20
OWN = re.compile(r"[0-9a-f]{32}\.npz")  # names of data files
ATTEMPTS = 5  # to read a map while it is changed
LEVEL = 1  # of compression: descriptors hardly shrink at higher ones


class MapError(MiniloopError):
    """A folder has no map, or one that is damaged or of an unknown version; the message names which."""


def has_map(result: Path) -> bool:
    """Whether a results folder holds a map."""
    return (result / FOLDER / MANIFEST).is_file()


def write_map(result: Path, scene_map: SceneMap, before: SceneMap | None = None) -> None:
    """Write the map of a results folder. If interrupted, the old map is unchanged.

    `before`: the result of `read_map` for this folder; files of recordings that are the same object in both are kept.
    """
    folder = result / FOLDER
    there = {id(part) for part in before.parts} if before else set()
    files = {str(entry["name"]): entry for entry in read_manifest(result)["recordings"]} if before else {}

    def kept(part: MapPart) -> dict[str, Any]:
        if id(part) in there:
            return {name: files[part.name][name] for name in ("file", "sha256", "bytes")}
        return _write(folder, part_arrays(part))

    recordings = [part_header(part) | kept(part) for part in scene_map.parts]
    joined = _write(folder, joined_arrays(scene_map.joined))
    content = {
        "format": FORMAT,
        "version": VERSION,
        "miniloop": __version__,
        "seed": scene_map.seed,
        "settings": dict(scene_map.settings),
        "recordings": recordings,
        "joined": joined,
    }
    with atomic_write(folder / MANIFEST) as file:
        json.dump(content | {"sha256": _hash(content)}, file, indent=1, allow_nan=False)
        file.write("\n")
    named = {joined["file"], *(entry["file"] for entry in recordings)}
    for path in folder.glob("*.npz"):
        if path.name not in named:
            with suppress(OSError):  # on Windows, a reader has it open: the next call removes it
                path.unlink()


def remove_map(result: Path) -> None:
    """Remove the map of a results folder, the manifest first; other files are kept."""
    folder = result / FOLDER
    (folder / MANIFEST).unlink(missing_ok=True)
    for path in folder.glob("*.npz"):
        if OWN.fullmatch(path.name):
            with suppress(OSError):
                path.unlink()
    with suppress(OSError):  # not empty, or missing
        folder.rmdir()


def read_manifest(result: Path) -> dict[str, Any]:
    """The content of the manifest of a results folder, checked by its hash.

    Raises MapError if there is none, or if it is damaged or of another version.
    """
    path = result / FOLDER / MANIFEST
    try:
        if path.stat().st_size > MAX_MANIFEST_BYTES:
            raise MapError(f"{path} is too large for a manifest of a map; register the recordings again")
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise MapError(f"{result} holds no map: give a folder that `miniloop register` wrote") from None
    except (OSError, ValueError, RecursionError) as error:
        raise MapError(f"{path} is damaged ({error}); register the recordings again") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise MapError(f"{path} is not the manifest of a map; register the recordings again")
    if content.get("version") != VERSION:
        raise MapError(
            f"{path} is of version {content.get('version')!r} of maps, and miniloop {__version__} reads version"
            f" {VERSION}: use the miniloop that wrote it ({content.get('miniloop')!r}), or register again"
        )
    if content.pop("sha256", None) != _hash(content):
        raise MapError(f"{path} is damaged: its content is not what its hash says; register the recordings again")
    return content


def read_map(result: Path) -> SceneMap:
    """The map of a results folder, every file checked by its hash.

    Raises MapError if there is none, or if it is damaged or of another version.
    """
    content = read_manifest(result)
    for _ in range(ATTEMPTS):
        try:
            return _read(result / FOLDER, content)
        except MapError:
            # Another process may have replaced the state while it was read.
            before, content = content, read_manifest(result)
            if content == before:
                raise
    raise MapError(f"{result}: the map changes faster than it can be read; try again")


def map_settings(result: Path, scene_map: SceneMap) -> Settings:
    """The settings of a map. Raises MapError if this version of miniloop does not know them."""
    try:
        return Settings.model_validate(dict(scene_map.settings))
    except ValueError as error:
        why = str(error).splitlines()[0]
        raise MapError(f"{result}: the settings of the map are of another version of miniloop ({why})") from error


def manifest_hash(result: Path) -> str:
    """The hash of the present state of a map. Raises MapError as `read_manifest`."""
    return _hash(read_manifest(result))


def map_bytes(content: Mapping[str, Any]) -> int:
    """Size of all data files that a manifest names."""
    return int(content["joined"]["bytes"]) + sum(int(entry["bytes"]) for entry in content["recordings"])


def _read(folder: Path, content: Mapping[str, Any]) -> SceneMap:
    where = folder / MANIFEST
    try:
        parts: list[MapPart] = []
        for entry in content["recordings"]:
            where = folder / entry["file"]
            parts.append(part_from(entry, _load(where, entry)))
        where = folder / content["joined"]["file"]
        joined = joined_from(_load(where, content["joined"]))
        return SceneMap(tuple(parts), joined, content["settings"], int(content["seed"]))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise MapError(f"{where} is not what a map holds ({error}); register the recordings again") from error


def _write(folder: Path, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Write arrays to a file named by its hash; returns its entry in the manifest."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=LEVEL) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                # Whole numbers of a column are more alike than those of a row, and take less room one after another.
                by_columns = array.ndim == 2 and array.dtype.kind in "iu"
                ordered = np.asfortranarray(array) if by_columns else np.ascontiguousarray(array)
                np.lib.format.write_array(file, ordered, allow_pickle=False)
    content = packed.getbuffer()
    digest = hashlib.sha256(content).hexdigest()
    path = folder / f"{digest[:32]}.npz"
    if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
        with atomic_write(path, "wb") as out:
            out.write(content)
    return {"file": path.name, "sha256": digest, "bytes": len(content)}


def _load(path: Path, entry: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    if path.name != entry["file"]:
        raise MapError(f"{path} is outside of the map's folder; register the recordings again")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise MapError(f"{path} cannot be read ({error.strerror or error}); register the recordings again") from None
    if hashlib.sha256(content).hexdigest() != entry["sha256"]:
        raise MapError(f"{path} is damaged: its content is not what the manifest says; register the recordings again")
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: np.ascontiguousarray(file[name]) for name in file.files}


def _hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
