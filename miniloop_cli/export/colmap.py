"""A COLMAP workspace in metres: images without lens distortion, text model, depth maps.

images/000012.png is frame 12; sparse/ holds cameras.txt, images.txt (world to camera) and points3D.txt (a thinned
cloud.ply, without tracks); stereo/depth_maps/000012.png.geometric.bin holds depth along the optical axis in metres,
0 = none. COLMAP puts the centre of the first pixel at (0.5, 0.5), so its principal point is ours plus a half.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.export.model import Model
from miniloop_cli.export.undistort import undistorter, write_color
from miniloop_cli.geometry import se3
from miniloop_cli.results.g2o import pose_rows
from miniloop_cli.results.ply import read_ply
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.progress import track
from miniloop_cli.typing import Bytes, Floats32

MOST_POINTS = 100_000
CONVENTIONS = "# metres; poses world to camera (x right, y down, z forward); pixel centres at halves\n"


def write_colmap(model: Model, folder: Path) -> list[Path]:
    """Write the workspace; returns the three files of the model. Raises InputError for a frame that is not there."""
    names = [f"{number:06d}.png" for number in model.frame_numbers]
    write_images(model, folder, names)
    sparse = folder / "sparse"
    camera = model.recording.camera
    with atomic_write(sparse / "cameras.txt") as file:
        file.write(CONVENTIONS + "# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy\n")
        file.write(f"1 PINHOLE {camera.width} {camera.height} {camera.fx:.12g} {camera.fy:.12g} ")
        file.write(f"{camera.cx + 0.5:.12g} {camera.cy + 0.5:.12g}\n")
    with atomic_write(sparse / "images.txt") as file:
        file.write(CONVENTIONS + "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then a line of 2D points\n")
        rows = pose_rows(se3.inverse(model.trajectory.T_world_cam))
        for number, name, row in zip(model.frame_numbers, names, rows, strict=True):
            x, y, z, qx, qy, qz, qw = row.split()
            file.write(f"{number + 1} {qw} {qx} {qy} {qz} {x} {y} {z} 1 {name}\n\n")
    with atomic_write(sparse / "points3D.txt") as file:
        file.write(CONVENTIONS + "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n")
        for k, (point, color) in enumerate(zip(*thinned_cloud(model), strict=True), 1):
            file.write(f"{k} {' '.join(f'{v:.6g}' for v in point)} {' '.join(map(str, color))} 0\n")
    return [sparse / name for name in ("cameras.txt", "images.txt", "points3D.txt")]


def write_images(model: Model, folder: Path, names: list[str]) -> None:
    """Undistorted colour as PNG and the depth that the run used in COLMAP's own format, one of each a pose."""
    sequence = model.recording
    undistort = undistorter(sequence.camera)
    for k, name in track(list(zip(model.recording_rows.tolist(), names, strict=True)), "images"):
        scan = undistort(model.scan(k))
        write_color(folder / "images" / name, scan)
        with atomic_write(folder / "stereo" / "depth_maps" / f"{name}.geometric.bin", "wb") as file:
            file.write(f"{scan.depth_m.shape[1]}&{scan.depth_m.shape[0]}&1&".encode("ascii"))
            file.write(scan.depth_m.astype("<f4").tobytes())


def thinned_cloud(model: Model) -> tuple[Floats32, Bytes]:
    """Every so many points of cloud.ply, at most MOST_POINTS; none without the file."""
    path = model.results.root / "cloud.ply"
    if not path.is_file():
        return np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    points, colors = read_ply(path)
    step = 1 + len(points) // MOST_POINTS
    return points[::step], colors[::step]
