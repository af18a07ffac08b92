"""A mesh as a file, in the format of its suffix."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from miniloop_cli.export.glb import write_glb
from miniloop_cli.export.mesh_model import Mesh
from miniloop_cli.export.obj import write_bytes, write_obj
from miniloop_cli.export.texture_image import jpeg
from miniloop_cli.results.ply import write_ply
from miniloop_cli.typing import Floats

SUFFIXES = (".glb", ".obj", ".ply")
OTHER_SUFFIXES = tuple(".gltf .stl .off .fbx .dae .usd .usdz .3ds .x3d .3mf .vtk .drc".split())


def write_mesh(path: Path, mesh: Mesh, T_up_world: Floats) -> list[Path]:
    """Write the mesh with its material and texture; returns the files. T_up_world (4, 4): for GLB, which has y up.

    OBJ and PLY are in the world of trajectory.txt. Raises ValueError for another suffix.
    """
    suffix = path.suffix.lower()
    if suffix == ".glb":
        return [write_glb(path, mesh, T_up_world)]
    if suffix == ".obj":
        return write_obj(path, mesh)
    if suffix != ".ply":
        raise ValueError(f"no mesh format has the suffix {suffix!r}")
    if not mesh.texture:
        write_ply(path, mesh.vertices, mesh.colors, mesh.triangles)
        return [path]
    image = path.with_name(re.sub(r"\s", "_", path.stem) + ".jpg")
    write_bytes(image, jpeg(mesh.texture.image).tobytes())
    uv = np.stack([mesh.texture.uv[:, 0], 1 - mesh.texture.uv[:, 1]], axis=1)
    write_ply(path, mesh.vertices, mesh.colors, mesh.triangles, uv=uv, texture=image.name)
    return [path, image]
