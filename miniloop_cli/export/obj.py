"""Wavefront OBJ with its material file and texture; without a texture, colours follow the vertices."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.export.mesh_model import Mesh
from miniloop_cli.export.texture_image import jpeg
from miniloop_cli.runtime.atomic_files import atomic_write

ROWS = 50_000  # formatted at once
HEAD = "# metres, world frame of trajectory.txt\n"
MATERIAL = "newmtl scan\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {image}\n"


def write_obj(path: Path, mesh: Mesh) -> list[Path]:
    """Write the mesh, and NAME.mtl and NAME.jpg if it has a texture; the OBJ last, as it names the others."""
    written, head = [path], HEAD
    if mesh.texture:
        stem = re.sub(r"\s", "_", path.stem)  # names end at a space in these files
        image, material = path.with_name(f"{stem}.jpg"), path.with_name(f"{stem}.mtl")
        write_bytes(image, jpeg(mesh.texture.image).tobytes())
        with atomic_write(material) as file:
            file.write(MATERIAL.format(image=image.name))
        written += [material, image]
        head += f"mtllib {material.name}\nusemtl scan\n"
    with atomic_write(path) as file:
        file.write(head)
        if mesh.texture:
            uv = mesh.texture.uv.astype(float)
            write_rows(file, "v %.6g %.6g %.6g\n", mesh.vertices)
            write_rows(file, "vt %.7g %.7g\n", np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1))  # v upwards
            write_rows(file, "f %d/%d %d/%d %d/%d\n", np.repeat(mesh.triangles + 1, 2, axis=1))
        else:
            values = np.concatenate([mesh.vertices, mesh.colors / 255.0], axis=1)
            write_rows(file, "v %.6g %.6g %.6g %.4g %.4g %.4g\n", values)
            write_rows(file, "f %d %d %d\n", mesh.triangles + 1)
    return written


def write_rows(file: Any, line: str, values: NDArray[Any]) -> None:
    """Write one line for each row of values (n, k)."""
    for start in range(0, len(values), ROWS):
        part = values[start : start + ROWS]
        file.write(line * len(part) % tuple(part.ravel().tolist()))


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file completely or not at all."""
    with atomic_write(path, "wb") as file:
        file.write(data)
