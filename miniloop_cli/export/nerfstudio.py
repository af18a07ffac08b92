"""nerfstudio's transforms.json: camera to world with OpenGL axes (x right, y up, z backward), depth paths and scale."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets import ImageFile, read_color
from miniloop_cli.export.model import Model
from miniloop_cli.export.open3d_json import write_json
from miniloop_cli.export.plain import write_clouds
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.sequence import DepthFormat, Sequence

NOTE = (
    "metres; transform_matrix is camera to world, camera axes x right, y up, z backward; pixel centres at halves; "
    "depth times depth_unit_scale_factor is metres (pass it to nerfstudio's data parser, whose default is 0.001)"
)


def write_nerfstudio(model: Model, folder: Path) -> list[Path]:
    """transforms.json, with paths from `folder` to the recording's own images where they are files; cloud.ply."""
    sequence = model.recording
    camera = sequence.camera
    k1, k2, p1, p2, k3 = camera.distortion
    start = folder.resolve()

    def relative(path: Path) -> str:
        return Path(os.path.relpath(path.resolve(), start)).as_posix()

    frames = [
        {
            "file_path": relative(color_path(model, k, folder)),
            "depth_file_path": relative(depth_path(model, k, folder)),
            "timestamp": sequence.frames[k].timestamp_s,
            "transform_matrix": (T @ OPENGL_AXES).tolist(),
        }
        for k, T in zip(model.recording_rows.tolist(), model.trajectory.T_world_cam, strict=True)
    ]
    data = {
        "note": NOTE,
        "camera_model": "OPENCV",
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + 0.5,
        "cy": camera.cy + 0.5,
        "w": camera.width,
        "h": camera.height,
        "k1": k1,
        "k2": k2,
        "k3": k3,
        "p1": p1,
        "p2": p2,
        "depth_unit_scale_factor": 1 / stored_scale(sequence),
    }
    clouds = [path for path in write_clouds(model, folder) if path.name == "cloud.ply"]
    if clouds:
        data["ply_file_path"] = "cloud.ply"
    return [write_json(folder / "transforms.json", data | {"frames": frames}), *clouds]


def color_path(model: Model, k: int, folder: Path) -> Path:
    """The recording's colour image of frame k where it is a file that shows what the camera sees; else a copy."""
    frame = model.recording.frames[k]
    if isinstance(frame.color, ImageFile) and not frame.color.upright and frame.camera is None:
        return frame.color.path
    color = read_color(frame.color) if frame.camera is None else model.scan(k).color
    return write_png(folder / "images" / f"{k:06d}.png", color[..., ::-1])


def stored_scale(sequence: Sequence) -> float:
    """Units a metre of the depth images: millimetres where the recording's are floating-point."""
    return 1000.0 if sequence.depth_format.floating else sequence.camera.depth_scale


def depth_path(model: Model, k: int, folder: Path) -> Path:
    """The recording's depth image of frame k where it is a file that any reader understands; else a copy in depth/."""
    sequence = model.recording
    frame = sequence.frames[k]
    if (
        isinstance(frame.depth, ImageFile)
        and sequence.depth_format == DepthFormat()
        and frame.mask is frame.camera is None
    ):
        return frame.depth.path
    stored = np.rint(model.scan(k).depth_m * stored_scale(sequence)).clip(0, 65535)
    return write_png(folder / "depth" / f"{k:06d}.png", stored.astype(np.uint16))


def write_png(path: Path, image: NDArray[Any]) -> Path:
    """Write (h, w) or (h, w, 3) BGR pixels as a PNG file."""
    import cv2

    _, data = cv2.imencode(".png", np.ascontiguousarray(image))
    with atomic_write(path, "wb") as file:
        file.write(data.tobytes())
    return path
