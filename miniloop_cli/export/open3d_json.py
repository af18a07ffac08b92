"""Open3D's JSON files, written without Open3D: camera trajectory and pose graph.

Matrices are column-major lists. A trajectory's `extrinsic` is world to camera; a node's `pose` is camera to world;
an edge's `transformation` maps points of the source scan into the target scan, with the information of
(rotation, translation), rotation first. The format has no lenses: for a camera with one, color/ and depth/ hold
undistorted images (000012.png is frame 12), and the trajectory has their intrinsics.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from miniloop_cli.export.model import Model
from miniloop_cli.export.undistort import stored_scale, undistorter, write_color, write_depth
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.progress import track
from miniloop_cli.typing import Floats

VERSION = {"version_major": 1, "version_minor": 0}


def write_open3d(model: Model, folder: Path) -> list[Path]:
    """pose_graph.json (node k is pose k of trajectory.txt) and, with the recording, camera_trajectory.json."""
    written = [write_json(folder / "pose_graph.json", pose_graph(model))]
    if model.sequence:
        written.append(write_json(folder / "camera_trajectory.json", camera_trajectory(model)))
        if not model.recording.camera.lens.ideal:
            write_images(model, folder)
    return written


def write_images(model: Model, folder: Path) -> None:
    """Undistorted colour and depth (the recording's units), one of each a pose."""
    sequence = model.recording
    undistort = undistorter(sequence.camera)
    for row, frame in track(list(zip(model.recording_rows.tolist(), model.frame_numbers, strict=True)), "images"):
        scan, name = undistort(model.scan(row)), f"{frame:06d}.png"
        write_color(folder / "color" / name, scan)
        write_depth(folder / "depth" / name, scan, stored_scale(sequence))


def camera_trajectory(model: Model) -> dict[str, Any]:
    """A PinholeCameraTrajectory, of the undistorted images."""
    camera = model.recording.camera
    intrinsic = {"width": camera.width, "height": camera.height, "intrinsic_matrix": column_major(camera.K)}
    parameters = [
        {"class_name": "PinholeCameraParameters", "extrinsic": column_major(T), "intrinsic": intrinsic} | VERSION
        for T in se3.inverse(model.trajectory.T_world_cam)
    ]
    return {"class_name": "PinholeCameraTrajectory", "parameters": parameters} | VERSION


def pose_graph(model: Model) -> dict[str, Any]:
    """A PoseGraph; all edges except those between neighbours in time are uncertain, so that Open3D may prune them."""
    graph = model.graph
    nodes = [
        {"class_name": "PoseGraphNode", "pose": column_major(T), "frame": frame} | VERSION
        for frame, T in zip(graph.ids.tolist(), graph.T_world_cam, strict=True)
    ]
    edges = [
        {
            "class_name": "PoseGraphEdge",
            "source_node_id": i,
            "target_node_id": j,
            "transformation": column_major(T),
            "information": column_major(information),
            "uncertain": j - i != 1,
            "confidence": 1.0,
        }
        | VERSION
        for (i, j), T, information in zip(model.pair_rows.tolist(), graph.T_j_i, graph.information, strict=True)
    ]
    return {"class_name": "PoseGraph", "nodes": nodes, "edges": edges} | VERSION


def column_major(M: Floats) -> list[float]:
    """(r, c) matrix as Eigen stores it."""
    return M.ravel(order="F").tolist()


def write_json(path: Path, data: dict[str, Any]) -> Path:
    """Write JSON, whole or not at all."""
    with atomic_write(path) as file:
        json.dump(data, file, indent=1, allow_nan=False)
    return path
