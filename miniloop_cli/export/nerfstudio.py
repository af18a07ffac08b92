"""nerfstudio's transforms.json: camera to world with OpenGL axes (x right, y up, z backward), depth paths and scale."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from miniloop_cli.datasets import read_scan
from miniloop_cli.export.model import Model
from miniloop_cli.export.open3d_json import write_json
from miniloop_cli.export.plain import write_clouds
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.sequence import DepthFormat, Sequence

OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
NOTE = (
    "metres; transform_matrix is camera to world, camera axes x right, y up, z backward; pixel centres at halves; "
    "depth times depth_unit_scale_factor is metres (pass it to nerfstudio's data parser, whose default is 0.001)"
)


def write_nerfstudio(model: Model, folder: Path) -> list[Path]:
    """transforms.json, its paths relative to `folder` and leading to the recording's own images; and cloud.ply."""
    sequence = model.recording
    camera = sequence.camera
    k1, k2, p1, p2, k3 = camera.distortion
    start = folder.resolve()

    def relative(path: Path) -> str:
        return Path(os.path.relpath(path.resolve(), start)).as_posix()

    frames = [
        {
            "file_path": relative(sequence.frames[k].color_path),
            "depth_file_path": relative(depth_path(sequence, k, folder)),
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
        "depth_unit_scale_factor": 1 / camera.depth_scale,
    }
    clouds = [path for path in write_clouds(model, folder) if path.name == "cloud.ply"]
    if clouds:
        data["ply_file_path"] = "cloud.ply"
    return [write_json(folder / "transforms.json", data | {"frames": frames}), *clouds]


def depth_path(sequence: Sequence, k: int, folder: Path) -> Path:
    """The recording's depth image of frame k where any reader understands it; else a plain copy in depth/."""
    frame = sequence.frames[k]
    if sequence.depth_format == DepthFormat() and frame.mask_path is None:
        return frame.depth_path
    import cv2

    path = folder / "depth" / f"{k:06d}.png"
    stored = np.rint(read_scan(sequence, k).depth_m * sequence.camera.depth_scale)
    _, data = cv2.imencode(".png", stored.astype(np.uint16))
    with atomic_write(path, "wb") as file:
        file.write(data.tobytes())
    return path
