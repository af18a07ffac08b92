"""Models for the server: clouds in tiles, meshes as GLB files."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.errors import InputError
from miniloop_cli.export.glb import glb
from miniloop_cli.export.mesh import import_open3d
from miniloop_cli.export.mesh_model import Mesh
from miniloop_cli.report.viewer import packing
from miniloop_cli.report.viewer.levels import Levels, coarse_first, tiles
from miniloop_cli.results.ply import MAX_HEADER_BYTES, read_ply
from miniloop_cli.typing import Bytes

GREY = 160  # of a model without colours


@dataclass(frozen=True)
class Tiled:
    """A cloud in tiles. `colors` (n, 3) in the order of `levels`."""

    levels: Levels
    colors: Bytes
    values: dict[str, Any]

    def points(self, begin: int, end: int) -> bytes:
        """Points begin..end - 1, packed."""
        return packing.pack_points(self.levels.steps[begin:end], self.colors[begin:end])


@dataclass(frozen=True)
class Glb:
    """A mesh as the bytes of a GLB file; `values` name its address and its rotation."""

    file: bytes
    values: dict[str, Any]


def tiled(points: NDArray[np.floating], colors: Bytes) -> Tiled:
    """The (n, 3) points with (n, 3) RGB in tiles; points that are not finite are left out."""
    sane = np.isfinite(points).all(axis=1)
    levels, found = tiles(coarse_first(points[sane]))
    values = {
        "kind": "tiles",
        "count": len(levels),
        "corner": levels.corner.tolist(),
        "side": levels.side,
        "tiles": [[tile.depth, *tile.cell, tile.begin, tile.end] for tile in found],
    }
    return Tiled(levels, colors[sane][levels.order], values)


def read_model(path: Path) -> Tiled | Glb:
    """A PLY cloud, a PLY mesh or a GLB file. Raises InputError for other files."""
    if path.suffix.lower() == ".glb":
        return read_glb(path)
    if not _has_faces(path):
        try:
            points, colors = read_ply(path)
        except InputError:  # of another program
            points, colors = _open3d_cloud(path)
        if not len(points):
            raise InputError(f"{path} holds no points")
        return tiled(points, colors)
    return Glb(_open3d_mesh(path), {"kind": "mesh", "url": "model.glb", "turn": [0, 0, 0, 1]})


def read_glb(path: Path) -> Glb:
    """An unchanged GLB file. Raises InputError for another file, and for one that needs further files."""
    file = path.read_bytes()
    if file[:4] != b"glTF" or len(file) < 20:
        raise InputError(f"{path}: not a GLB file")
    try:
        length = struct.unpack_from("<I", file, 12)[0]
        head = json.loads(file[20 : 20 + length])
        beside = [part["uri"] for name in ("buffers", "images") for part in head.get(name, []) if "uri" in part]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: damaged GLB file ({error})") from error
    if any(not str(uri).startswith("data:") for uri in beside):
        raise InputError(f"{path} needs other files ({beside[0]}): write a GLB file that holds everything")
    return Glb(file, {"kind": "mesh", "url": "model.glb", "turn": [0, 0, 0, 1]})


def _has_faces(path: Path) -> bool:
    with path.open("rb") as file:
        head, end, _ = file.read(MAX_HEADER_BYTES).partition(b"end_header")
    if not head.startswith(b"ply") or not end:
        raise InputError(f"{path}: not a PLY file")
    counts = [line.split()[2] for line in head.splitlines() if line.startswith(b"element face")]
    return bool(counts) and counts[0] != b"0"


def _open3d_cloud(path: Path) -> tuple[NDArray[np.floating], Bytes]:
    cloud = import_open3d().io.read_point_cloud(str(path))
    return np.asarray(cloud.points), _colors(np.asarray(cloud.colors), len(cloud.points))


def _open3d_mesh(path: Path) -> bytes:
    mesh = import_open3d().io.read_triangle_mesh(str(path))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    if not len(faces) or not np.isfinite(vertices).all():
        raise InputError(f"{path}: its faces cannot be read")
    colors = _colors(np.asarray(mesh.vertex_colors), len(vertices))
    return glb(Mesh(vertices.astype(np.float32), colors, faces.astype(np.int32)), np.eye(4))


def _colors(shares: NDArray[np.floating], count: int) -> Bytes:
    if len(shares) != count:
        return np.full((count, 3), GREY, np.uint8)
    return np.rint(255 * np.clip(shares, 0, 1)).astype(np.uint8)
