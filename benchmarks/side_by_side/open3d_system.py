"""Open3D's reconstruction system: fragments, their registration and its refinement, one model, by its own programs.

The programs are not part of its wheel: `--programs` is the folder examples/python/reconstruction_system of its sources.
They read images of a camera without distortion, which `write_images` makes beforehand.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks.side_by_side.clock import arguments, write_poses
from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.export.undistort import stored_scale, undistorter, write_color, write_depth
from miniloop_cli.geometry import se3
from miniloop_cli.scene.sequence import Sequence

PROGRAM, CAMERA, SETTINGS = "run_system.py", "camera.json", "settings.json"
STEPS = ("--make", "--register", "--refine", "--integrate")


def write_images(recording: Sequence, folder: Path) -> None:
    """Write a recording as Open3D reads it, with its camera. Settings are Open3D's defaults, but one process."""
    if (folder / SETTINGS).is_file():
        return
    camera, scale, undistorted = recording.camera, stored_scale(recording), undistorter(recording.camera)
    for kind in ("image", "depth"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    for k in range(len(recording.frames)):
        scan = undistorted(read_scan(recording, k))
        write_color(folder / "image" / f"{k:06}.png", scan)
        write_depth(folder / "depth" / f"{k:06}.png", scan, scale)
    intrinsics = {"width": camera.width, "height": camera.height, "intrinsic_matrix": camera.K.T.ravel().tolist()}
    (folder / CAMERA).write_text(json.dumps(intrinsics), encoding="utf-8")
    settings = {"name": "recording", "path_dataset": str(folder), "path_intrinsic": str(folder / CAMERA)}
    # Several processes fail in Open3D's sources of August 2026. Each step still uses threads.
    settings |= {"depth_scale": scale, "python_multi_threading": False}
    (folder / SETTINGS).write_text(json.dumps(settings), encoding="utf-8")


def main() -> None:
    import open3d as o3d

    options = arguments(__doc__, programs=Path(), images=Path())
    command = [sys.executable, PROGRAM, "--config", str(options.images / SETTINGS), *STEPS]
    subprocess.run(command, cwd=options.programs, check=True)
    stamps = np.array([frame.timestamp_s for frame in open_sequence(options.sequence).frames])
    found = o3d.io.read_pinhole_camera_trajectory(str(options.images / "scene" / "trajectory.log")).parameters
    if len(found) != len(stamps):  # poses have no stamps of their own
        sys.exit(f"Open3D left {len(found)} poses of {len(stamps)} frames")
    write_poses(options.out, stamps, se3.inverse(np.array([camera.extrinsic for camera in found])))


if __name__ == "__main__":
    main()
