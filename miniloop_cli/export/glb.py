"""glTF 2.0 in one binary file (GLB), by the Khronos specification, without lighting, which the colours contain.

Positions are those of the world of trajectory.txt; the node's matrix rotates them to glTF's axes, y up.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.export.mesh_model import Mesh
from miniloop_cli.export.texture_image import jpeg
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.typing import Bytes, Floats
from miniloop_cli.version import __version__

FLOAT, USHORT, UINT = 5126, 5123, 5125
VERTICES, INDICES = 34962, 34963  # targets of buffer views
CLAMPED = {"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


def write_glb(path: Path, mesh: Mesh, T_up_world: Floats) -> Path:
    """One mesh. T_up_world (4, 4) turns its world so that y is up."""
    with atomic_write(path, "wb") as file:
        file.write(glb(mesh, T_up_world))
    return path


def glb(mesh: Mesh, T_up_world: Floats) -> bytes:
    """The bytes of the file that `write_glb` writes; T_up_world (4, 4)."""
    buffers = Buffers()
    attributes = {"POSITION": buffers.accessor(np.asarray(mesh.vertices, np.float32), "VEC3", VERTICES, bounds=True)}
    material: dict[str, Any] = {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}
    material["extensions"] = {"KHR_materials_unlit": {}}
    data: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"miniloop {__version__}"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "model", "matrix": T_up_world.ravel(order="F").tolist()}],
    }
    if mesh.texture:
        attributes["TEXCOORD_0"] = buffers.accessor(mesh.texture.uv, "VEC2", VERTICES)
        data["images"] = [{"bufferView": buffers.view(jpeg(mesh.texture.image).tobytes()), "mimeType": "image/jpeg"}]
        data["samplers"] = [CLAMPED]
        data["textures"] = [{"source": 0, "sampler": 0}]
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    else:
        attributes["COLOR_0"] = buffers.accessor(linear(mesh.colors), "VEC4", VERTICES)
    indices = buffers.accessor(mesh.triangles.astype(np.uint32).ravel(), "SCALAR", INDICES)
    data["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}]
    data["materials"] = [material]
    binary = b"".join(buffers.parts)
    data |= {"accessors": buffers.accessors, "bufferViews": buffers.views, "buffers": [{"byteLength": len(binary)}]}
    text = json.dumps(data, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
    return b"".join(
        (head, struct.pack("<II", len(text), JSON_CHUNK), text, struct.pack("<II", len(binary), BINARY_CHUNK), binary)
    )


class Buffers:
    """The growing binary part of a file, each array at a multiple of four bytes, and its description for the JSON."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []
        self._length = 0

    def view(self, data: bytes, **more: int) -> int:
        """The number of a new buffer view."""
        self.views.append({"buffer": 0, "byteOffset": self._length, "byteLength": len(data)} | more)
        self.parts.append(data + bytes(-len(data) % 4))
        self._length += len(self.parts[-1])
        return len(self.views) - 1

    def accessor(self, values: NDArray[Any], kind: str, target: int, bounds: bool = False) -> int:
        """The number of a new accessor of values (n, k) with its own view. `bounds`: with minimum and maximum."""
        component = {np.float32: FLOAT, np.uint16: USHORT, np.uint32: UINT}[values.dtype.type]
        view = self.view(np.ascontiguousarray(values).tobytes(), target=target)
        about: dict[str, Any] = {"bufferView": view, "componentType": component, "count": len(values), "type": kind}
        if component == USHORT:
            about["normalized"] = True
        if bounds:
            about |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.accessors.append(about)
        return len(self.accessors) - 1


def linear(colors: Bytes) -> NDArray[np.uint16]:
    """(n, 4) opaque vertex colours, linear in light as in glTF, from (n, 3) sRGB."""
    s = np.arange(256) / 255
    table = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    rgba = np.full((len(colors), 4), 65535, np.uint16)
    rgba[:, :3] = np.rint(65535 * table).astype(np.uint16)[colors]
    return rgba
