"""A COLMAP model as text and in binary: cameras, images with their observations, points with their tracks.

COLMAP puts the centre of the first pixel at (0.5, 0.5), so its pixels are ours plus a half. There is one camera, a
PINHOLE, with the number 1.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.results.g2o import pose_rows
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.landmarks import Landmarks
from miniloop_cli.typing import Bytes, Floats, Ints

CONVENTIONS = "# metres; poses world to camera (x right, y down, z forward); pixel centres at halves\n"
PINHOLE_NUMBER = 1  # of its camera models


@dataclass(frozen=True)
class ColmapModel:
    """Images: numbers (n,), names, T_cam_world (n, 4, 4); landmarks by rows of these images, colours and errors (p,).

    `colors` (p, 3) RGB and `error_px` (p,) mean distances of the points' projections from their observations.
    """

    camera: Camera
    image_ids: Ints
    names: list[str]
    T_cam_world: Floats
    landmarks: Landmarks
    colors: Bytes
    error_px: Floats

    def points_of_images(self) -> tuple[Ints, Ints, Ints]:
        """Observations in the order of images: their rows (k,), the start of each image (n + 1,), and the index (k,) of
        each observation, in the landmarks' order, among those of its image."""
        frame = self.landmarks.frame
        order = np.argsort(frame, kind="stable")
        start = np.searchsorted(frame[order], np.arange(len(self.names) + 1))
        place = np.empty(len(frame), np.int64)
        place[order] = np.arange(len(frame)) - start[frame[order]]
        return order, start, place


def reprojection_errors(landmarks: Landmarks, T_cam_world: Floats, camera: Camera) -> Floats:
    """(p,) mean distance in pixels between the projections of the points and their observations.

    T_cam_world (n, 4, 4) of the frames of the observations.
    """
    T = T_cam_world[landmarks.frame]
    p_cam = np.einsum("kij,kj->ki", T[:, :3, :3], landmarks.points_world[landmarks.point]) + T[:, :3, 3]
    distance = np.linalg.norm(camera.project(p_cam) - landmarks.px, axis=1)
    count = np.bincount(landmarks.point, minlength=len(landmarks.points_world))
    return np.bincount(landmarks.point, distance, minlength=len(count)) / np.maximum(count, 1)


def write_text(model: ColmapModel, folder: Path) -> list[Path]:
    """cameras.txt, images.txt and points3D.txt."""
    camera, seen = model.camera, model.landmarks
    order, start, place = model.points_of_images()
    paths = [folder / f"{name}.txt" for name in ("cameras", "images", "points3D")]
    with atomic_write(paths[0]) as file:
        file.write(CONVENTIONS + "# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy\n")
        parameters = " ".join(f"{v:.12g}" for v in intrinsics(camera))
        file.write(f"1 PINHOLE {camera.width} {camera.height} {parameters}\n")
    with atomic_write(paths[1]) as file:
        file.write(
            CONVENTIONS + "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; X, Y, POINT3D_ID of each point\n"
        )
        for k, row in enumerate(pose_rows(model.T_cam_world)):
            x, y, z, qx, qy, qz, qw = row.split()
            file.write(f"{model.image_ids[k]} {qw} {qx} {qy} {qz} {x} {y} {z} 1 {model.names[k]}\n")
            rows = order[start[k] : start[k + 1]]
            points = zip(seen.px[rows].tolist(), seen.point[rows].tolist(), strict=True)
            file.write(" ".join(f"{u + 0.5:.3f} {v + 0.5:.3f} {point + 1}" for (u, v), point in points) + "\n")
    first = np.searchsorted(seen.point, np.arange(len(seen.points_world) + 1))
    with atomic_write(paths[2]) as file:
        file.write(CONVENTIONS + "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n")
        for p, (point, color) in enumerate(zip(seen.points_world.tolist(), model.colors.tolist(), strict=True)):
            own = slice(first[p], first[p + 1])
            ids, places = model.image_ids[seen.frame[own]].tolist(), place[own].tolist()
            track = "".join(f" {image} {number}" for image, number in zip(ids, places, strict=True))
            values = " ".join(f"{v:.9g}" for v in point)
            file.write(f"{p + 1} {values} {' '.join(map(str, color))} {model.error_px[p]:.6g}{track}\n")
    return paths


def write_binary(model: ColmapModel, folder: Path) -> list[Path]:
    """cameras.bin, images.bin and points3D.bin, little endian."""
    camera, seen = model.camera, model.landmarks
    order, start, place = model.points_of_images()
    paths = [folder / f"{name}.bin" for name in ("cameras", "images", "points3D")]
    with atomic_write(paths[0], "wb") as file:
        file.write(struct.pack("<QiiQQ4d", 1, 1, PINHOLE_NUMBER, camera.width, camera.height, *intrinsics(camera)))
    rows = se3.to_rows(model.T_cam_world)
    with atomic_write(paths[1], "wb") as file:
        file.write(struct.pack("<Q", len(model.names)))
        for k, (x, y, z, qx, qy, qz, qw) in enumerate(rows.tolist()):
            file.write(struct.pack("<I7dI", model.image_ids[k], qw, qx, qy, qz, x, y, z, 1))
            own = order[start[k] : start[k + 1]]
            file.write(model.names[k].encode() + b"\0" + struct.pack("<Q", len(own)))
            points = np.empty(len(own), [("px", "<f8", 2), ("point", "<u8")])
            points["px"], points["point"] = seen.px[own].astype(float) + 0.5, seen.point[own] + 1
            file.write(points.tobytes())
    first = np.searchsorted(seen.point, np.arange(len(seen.points_world) + 1))
    track = np.stack([model.image_ids[seen.frame], place], axis=1).astype("<u4")
    with atomic_write(paths[2], "wb") as file:
        file.write(struct.pack("<Q", len(seen.points_world)))
        for p, (point, color) in enumerate(zip(seen.points_world.tolist(), model.colors.tolist(), strict=True)):
            own_track = track[first[p] : first[p + 1]]
            file.write(struct.pack("<Q3d3BdQ", p + 1, *point, *color, model.error_px[p], len(own_track)))
            file.write(own_track.tobytes())
    return paths


def intrinsics(camera: Camera) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy in COLMAP's pixels."""
    return camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5
