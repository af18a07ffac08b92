"""A COLMAP workspace in metres: images without lens distortion, a model with tracks, masks and depth maps.

images/000012.png is frame 12. sparse/ holds the model as text (world to camera), sparse/0/ the same in binary. Its
points and tracks are those of the bundle adjustment; without landmarks.npz, a thinned cloud.ply without tracks.
masks/000012.png.png exists if pixels are to be ignored, and is black there. stereo/depth_maps/000012.png.geometric.bin
holds depth along the optical axis in metres, 0 = none.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.export.colmap_model import ColmapModel, reprojection_errors, write_binary, write_text
from miniloop_cli.export.model import Model
from miniloop_cli.export.undistort import imaged, undistorter, write_color, write_png
from miniloop_cli.geometry import se3
from miniloop_cli.results.ply import read_ply
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.progress import track
from miniloop_cli.scene.landmarks import NO_LANDMARKS, Landmarks
from miniloop_cli.typing import Bytes, Floats32

MOST_POINTS = 100_000


def write_colmap(model: Model, folder: Path) -> list[Path]:
    """Write the workspace; returns the files of the model. Raises InputError for a missing frame."""
    names = [f"{number:06d}.png" for number in model.frame_numbers]
    camera = model.recording.camera
    landmarks, T_cam_world = landmarks_of_images(model), se3.inverse(model.trajectory.T_world_cam)
    colors = write_images(model, folder, names, landmarks)
    error_px = reprojection_errors(landmarks, T_cam_world, camera)
    if not len(landmarks.point):
        points, colors = thinned_cloud(model)
        landmarks = Landmarks(points.astype(float), NO_LANDMARKS.point, NO_LANDMARKS.frame, NO_LANDMARKS.px)
        error_px = np.zeros(len(points))
    written = ColmapModel(camera, model.frame_numbers + 1, names, T_cam_world, landmarks, colors, error_px)
    return [*write_text(written, folder / "sparse"), *write_binary(written, folder / "sparse" / "0")]


def landmarks_of_images(model: Model) -> Landmarks:
    """The landmarks by rows of the trajectory, with observations within the images only."""
    found, camera = model.results.landmarks, model.recording.camera
    rows = np.searchsorted(model.frame_numbers, found.frame).clip(0, len(model.frame_numbers) - 1)
    inside = (found.px > -0.5).all(axis=1) & (found.px < [camera.width - 0.5, camera.height - 0.5]).all(axis=1)
    known = model.frame_numbers[rows] == found.frame
    by_row = Landmarks(found.points_world, found.point, rows.astype(np.int32), found.px)
    return by_row.seen_at(inside & known)


def write_images(model: Model, folder: Path, names: list[str], landmarks: Landmarks) -> Bytes:
    """Undistorted colour as PNG, masks, and the depth that the run used in COLMAP's own format, one of each a pose.

    Returns the colours (p, 3) of the landmarks: means over their observations.
    """
    sequence = model.recording
    undistort, rim = undistorter(sequence.camera), ~imaged(sequence.camera)
    order = np.argsort(landmarks.frame, kind="stable")
    start = np.searchsorted(landmarks.frame[order], np.arange(len(names) + 1))
    total = np.zeros((len(landmarks.points_world), 3))
    for row, (k, name) in enumerate(track(list(zip(model.recording_rows.tolist(), names, strict=True)), "images")):
        scan = undistort(model.scan(k))
        write_color(folder / "images" / name, scan)
        ignored = rim if scan.mask is None else rim | scan.mask
        if ignored.any():
            write_png(folder / "masks" / f"{name}.png", np.where(ignored, 0, 255).astype(np.uint8))
        with atomic_write(folder / "stereo" / "depth_maps" / f"{name}.geometric.bin", "wb") as file:
            file.write(f"{scan.depth_m.shape[1]}&{scan.depth_m.shape[0]}&1&".encode("ascii"))
            file.write(scan.depth_m.astype("<f4").tobytes())
        own = order[start[row] : start[row + 1]]
        u, v = np.rint(landmarks.px[own]).astype(np.int64).T
        total[landmarks.point[own]] += scan.color[
            v.clip(0, scan.color.shape[0] - 1), u.clip(0, scan.color.shape[1] - 1)
        ]
    count = np.bincount(landmarks.point, minlength=len(total))
    return np.rint(total / np.maximum(count, 1)[:, None]).astype(np.uint8)


def thinned_cloud(model: Model) -> tuple[Floats32, Bytes]:
    """Every N-th point (n, 3) of cloud.ply and its colour, at most MOST_POINTS; none without the file."""
    path = model.results.root / "cloud.ply"
    if not path.is_file():
        return np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    points, colors = read_ply(path)
    step = 1 + len(points) // MOST_POINTS
    return points[::step], colors[::step]
