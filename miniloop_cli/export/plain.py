"""Poses in simple formats: TUM, KITTI, numpy, PLY, g2o."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.export.model import Model
from miniloop_cli.results.g2o import write_g2o
from miniloop_cli.results.ply import write_ply
from miniloop_cli.runtime.atomic_files import atomic_write

CONVENTIONS = (
    "T_world_cam (n, 4, 4) maps points of the camera (x right, y down, z forward, metres) into the world; "
    "frames (n,) are numbers in the recording; T_j_i (m, 4, 4) maps points of scan i into scan j for pairs (m, 2) of "
    "frame numbers; information (m, 6, 6) of xi = (rotation vector, translation), T_j_i(true) = Exp(xi) T_j_i"
)


def write_tum(model: Model, folder: Path) -> list[Path]:
    """trajectory.txt: timestamp tx ty tz qx qy qz qw, camera to world."""
    path = folder / "trajectory.txt"
    write_trajectory(path, model.trajectory)
    return [path]


def write_kitti(model: Model, folder: Path) -> list[Path]:
    """poses.txt: the upper three rows of camera to world, row by row, as in KITTI odometry; times.txt: seconds.

    The format has no comments. Its cameras also look along z (x right, y down).
    """
    poses, times = folder / "poses.txt", folder / "times.txt"
    with atomic_write(poses) as file:
        for T in model.trajectory.T_world_cam:
            file.write(" ".join(f"{v:.12g}" for v in T[:3].ravel()) + "\n")
    with atomic_write(times) as file:
        file.writelines(f"{stamp:.6f}\n" for stamp in model.trajectory.timestamps_s)
    return [poses, times]


def write_numpy(model: Model, folder: Path) -> list[Path]:
    """poses.npz: everything as arrays, with the conventions as a string inside; loads without pickle."""
    path, graph = folder / "poses.npz", model.graph
    arrays: dict[str, Any] = {
        "conventions": np.array(CONVENTIONS),
        "frames": graph.ids,
        "timestamps_s": model.trajectory.timestamps_s,
        "T_world_cam": graph.T_world_cam,
        "pairs": graph.pairs,
        "T_j_i": graph.T_j_i,
        "information": graph.information,
    }
    if model.sequence:
        camera = model.sequence.camera
        lens = dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0) if camera.lens.ideal else camera.lens.named
        kind = "fisheye" if camera.lens.model == "fisheye" else "distortion"
        arrays |= {"K": camera.K, f"{kind}_{'_'.join(lens)}": np.array(list(lens.values()))}
        arrays |= {"depth_units_per_m": np.array(camera.depth_scale)}
    with atomic_write(path, "wb") as file:
        np.savez(file, **arrays)
    return [path]


def write_clouds(model: Model, folder: Path) -> list[Path]:
    """cameras.ply: camera centres in order of time, blue to red; cloud.ply: the model, if the run has one."""
    cameras = folder / "cameras.ply"
    centres = model.trajectory.T_world_cam[:, :3, 3]
    share = np.linspace(0, 1, len(centres))[:, None]
    colors = np.rint((1 - share) * [40, 90, 200] + share * [220, 60, 40]).astype(np.uint8)
    write_ply(cameras, centres, colors, comment="camera centres in order of time, metres", precise=True)
    return [cameras, *copy_model(model, folder)]


def copy_model(model: Model, folder: Path) -> list[Path]:
    """cloud.ply: the model, if the run has one."""
    cloud, copy = model.results.root / "cloud.ply", folder / "cloud.ply"
    if not cloud.is_file():
        return []
    with cloud.open("rb") as source, atomic_write(copy, "wb") as file:
        shutil.copyfileobj(source, file)
    return [copy]


def write_graph(model: Model, folder: Path) -> list[Path]:
    """graph.g2o: poses and verified edges with their information."""
    path, graph = folder / "graph.g2o", model.graph
    write_g2o(path, graph.ids, graph.T_world_cam, graph.pairs, graph.T_j_i, graph.information)
    return [path]
