"""PLY clouds and meshes: binary little endian, float32 metres, uint8 colours. Needs nothing but numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.errors import InputError
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.typing import Bytes, Floats32

VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
PRECISE_VERTEX = np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3)])
FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
VERTEX_LINES = [f"property float {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
FACE_LINE = "property list uchar int vertex_indices"
MAX_HEADER_BYTES = 10_000


def write_ply(
    path: Path,
    points: NDArray[np.floating],
    colors: Bytes,
    faces: NDArray[np.integer] | None = None,
    comment: str = "metres, world frame of trajectory.txt",
    precise: bool = False,
    uv: NDArray[np.floating] | None = None,
    texture: str = "",
) -> None:
    """Write (n, 3) points (m), (n, 3) RGB and, for a mesh, (m, 3) vertex numbers a triangle.

    `precise`: coordinates as float64. `uv` (n, 2): positions in the image file `texture` beside the PLY, from its lower
    left corner. `read_ply` reads neither. Raises ValueError for shapes that do not fit.
    """
    points, colors = np.asarray(points), np.asarray(colors)
    if points.ndim != 2 or points.shape[1] != 3 or colors.shape != points.shape:
        raise ValueError(f"points and colors must both be (n, 3), got {points.shape} and {colors.shape}")
    layout = PRECISE_VERTEX if precise else VERTEX
    vertices = np.empty(len(points), layout if uv is None else np.dtype([*layout.descr, ("st", "<f4", 2)]))
    vertices["xyz"], vertices["rgb"] = points, colors
    header = ["ply", "format binary_little_endian 1.0", f"comment {comment}"]
    header += [f"comment TextureFile {texture}"] if texture else []
    header += [f"element vertex {len(points)}"]
    header += [line.replace("float", "double") for line in VERTEX_LINES] if precise else VERTEX_LINES
    if uv is not None:
        vertices["st"] = uv
        header += ["property float s", "property float t"]
    if faces is not None:
        header += [f"element face {len(faces)}", FACE_LINE]
    with atomic_write(Path(path), "wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        file.write(vertices.tobytes())
        if faces is not None:
            triangles = np.empty(len(faces), FACE)
            triangles["count"], triangles["vertices"] = 3, faces
            file.write(triangles.tobytes())


def read_ply(path: Path) -> tuple[Floats32, Bytes]:
    """(n, 3) points and (n, 3) colours of a file that `write_ply` wrote (faces are left out).

    Raises InputError for other kinds of PLY and for a truncated file.
    """
    with Path(path).open("rb") as file:
        head, end, _ = file.read(MAX_HEADER_BYTES).partition(b"end_header\n")
        lines = head.decode("ascii", "replace").splitlines()
        if not end or lines[:2] != ["ply", "format binary_little_endian 1.0"]:
            raise InputError(f"{path}: not a binary little-endian PLY file")
        body = [line for line in lines[2:] if not line.startswith("comment")]
        count = body[0].removeprefix("element vertex ") if body else ""
        more = body[7:8] and not body[7].startswith("element ")
        if body[1:7] != VERTEX_LINES or more or not count.isascii() or not count.isdigit():
            raise InputError(f"{path}: expected vertices with float x y z and uchar red green blue only")
        size = int(count) * VERTEX.itemsize
        if Path(path).stat().st_size < len(head) + len(end) + size:
            raise InputError(f"{path} ends before its {count} vertices: the file is cut short")
        file.seek(len(head) + len(end))
        vertices = np.frombuffer(file.read(size), VERTEX)
    return vertices["xyz"].copy(), vertices["rgb"].copy()
