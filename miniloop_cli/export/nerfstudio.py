"""nerfstudio's transforms.json: camera to world with OpenGL axes (x right, y up, z backward), depth paths and scale.

A pixel whose mask is black is ignored; if one frame has a mask, all have, as its data parser requires. Its lenses are
OpenCV's with k1 k2 k3 p1 p2, and the fisheye; for the rational lens, the images are undistorted.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets import ImageFile, read_color
from miniloop_cli.export.model import Model
from miniloop_cli.export.open3d_json import write_json
from miniloop_cli.export.plain import copy_model
from miniloop_cli.export.undistort import imaged, stored_scale, undistorter, write_color, write_depth, write_png
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.geometry.lens import PINHOLE, Lens
from miniloop_cli.runtime.progress import track
from miniloop_cli.scene.sequence import DepthFormat

NOTE = (
    "metres; transform_matrix is camera to world, camera axes x right, y up, z backward; pixel centres at halves; "
    "depth times depth_unit_scale_factor is metres (pass it to nerfstudio's data parser, whose default is 0.001)"
)


def write_nerfstudio(model: Model, folder: Path) -> list[Path]:
    """Write transforms.json, with paths from `folder` to the recording's images if they are files, and cloud.ply."""
    sequence = model.recording
    lens = nerfstudio_lens(sequence.camera.lens)
    camera = sequence.camera if lens else replace(sequence.camera, lens=PINHOLE)
    undistort = undistorter(sequence.camera)
    start = folder.resolve()

    def relative(path: Path) -> str:
        return Path(os.path.relpath(path.resolve(), start)).as_posix()

    def images(k: int) -> tuple[Path, Path]:
        if lens:
            return color_path(model, k, folder), depth_path(model, k, folder)
        scan, name = undistort(model.scan(k)), f"{k:06d}.png"
        depth = write_depth(folder / "depth" / name, scan, stored_scale(sequence))
        return write_color(folder / "images" / name, scan), depth

    rim = np.zeros((camera.height, camera.width), bool) if lens else ~imaged(sequence.camera)
    masked = rim.any() or any(sequence.frames[k].mask for k in model.recording_rows.tolist())

    def mask(k: int) -> dict[str, str]:
        if not masked:
            return {}
        scan = model.scan(k) if lens else undistort(model.scan(k))
        ignored = rim if scan.mask is None else rim | scan.mask
        keep = np.where(ignored, 0, 255).astype(np.uint8)
        return {"mask_path": relative(write_png(folder / "masks" / f"{k:06d}.png", keep))}

    numbers = model.recording_rows.tolist()
    paths = [(*images(k), mask(k)) for k in track(numbers, "images")]
    frames = [
        {
            "file_path": relative(color),
            "depth_file_path": relative(depth),
            **mask_path,
            "timestamp": sequence.frames[k].timestamp_s,
            "transform_matrix": (T @ OPENGL_AXES).tolist(),
        }
        for k, (color, depth, mask_path), T in zip(numbers, paths, model.trajectory.T_world_cam, strict=True)
    ]
    data = {
        "note": NOTE,
        **(lens or nerfstudio_lens(camera.lens) or {}),
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + 0.5,
        "cy": camera.cy + 0.5,
        "w": camera.width,
        "h": camera.height,
        "depth_unit_scale_factor": 1 / stored_scale(sequence),
    }
    clouds = copy_model(model, folder)
    if clouds:
        data["ply_file_path"] = "cloud.ply"
    return [write_json(folder / "transforms.json", data | {"frames": frames}), *clouds]


def nerfstudio_lens(lens: Lens) -> dict[str, Any] | None:
    """The camera model and its coefficients; None for a lens that the format cannot express."""
    if lens.model == "fisheye":
        return {"camera_model": "OPENCV_FISHEYE"} | lens.named
    values = dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), 0.0) | lens.named
    return {"camera_model": "OPENCV"} | values if len(values) == 5 else None


def color_path(model: Model, k: int, folder: Path) -> Path:
    """The recording's colour image of frame k if it is an unmodified file; else a copy."""
    frame = model.recording.frames[k]
    if isinstance(frame.color, ImageFile) and frame.color.on_disk and not frame.color.upright and frame.camera is None:
        return frame.color.path
    color = read_color(frame.color) if frame.camera is None else model.scan(k).color
    return write_png(folder / "images" / f"{k:06d}.png", color[..., ::-1])


def depth_path(model: Model, k: int, folder: Path) -> Path:
    """The recording's depth image of frame k if it is a file in a common format; else a copy in depth/."""
    sequence = model.recording
    frame = sequence.frames[k]
    plain = sequence.depth_format == DepthFormat() and frame.mask is frame.camera is sequence.depth_camera is None
    if isinstance(frame.depth, ImageFile) and frame.depth.on_disk and plain:
        return frame.depth.path
    return write_depth(folder / "depth" / f"{k:06d}.png", model.scan(k), stored_scale(sequence))
