"""The files beside a map of several recordings, all derived from it: trajectories, one model, a summary."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.trajectory import read_trajectory, write_trajectory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.mapping.carry import map_trajectories
from miniloop_cli.results.fuse_cloud import fuse_cloud
from miniloop_cli.results.map_folder import manifest_hash, map_bytes, read_manifest
from miniloop_cli.results.map_numbers import map_numbers
from miniloop_cli.results.map_verdict import map_verdict
from miniloop_cli.results.ply import read_ply, write_ply
from miniloop_cli.results.write import versions
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.scene_map import SceneMap
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Bytes, Floats

TRAJECTORY, CLOUD, SUMMARY = "trajectory.txt", "cloud.ply", "summary.json"


def write_map_files(result: Path, scene_map: SceneMap, extra: Mapping[str, Any]) -> dict[str, Any]:
    """Write <recording>/trajectory.txt, the common model and, last, summary.json; returns the summary.

    Clouds of recordings move with their recordings. `extra`: further entries of the summary.
    """
    (result / SUMMARY).unlink(missing_ok=True)
    clouds = []
    for part, T, piece in zip(scene_map.parts, map_trajectories(scene_map), scene_map.joined.piece, strict=True):
        folder = result / part.name
        _move_cloud(folder, part.stamps_s, T)
        write_trajectory(folder / TRAJECTORY, Trajectory(part.stamps_s, T))
        if piece == 0:
            clouds.append(folder / CLOUD)
    voxel_m = float(scene_map.settings.get("cloud", {}).get("voxel_m", 0.01))
    write_ply(result / CLOUD, *fuse_cloud(_read(clouds), voxel_m), comment="metres, the world of the largest piece")
    numbers = {"map_sha256": manifest_hash(result)} | dict(extra)
    joined, gap = scene_map.joined, scene_map.joined.relative_gap
    proof = {"certified": joined.certified, "relative_gap": gap if np.isfinite(gap) else None}
    numbers["certificate"] = proof
    numbers["verdict"] = map_verdict(result, scene_map, extra.get("failed", {}))
    numbers |= map_numbers(scene_map, map_bytes(read_manifest(result)), read_manifest(result)) | {
        "versions": versions()
    }
    with atomic_write(result / SUMMARY) as file:
        json.dump(numbers, file, indent=1)
        file.write("\n")
    return numbers


def up_to_date(result: Path) -> bool:
    """Whether the files beside a map belong to its present state."""
    try:
        summary = json.loads((result / SUMMARY).read_text(encoding="utf-8"))
        return summary.get("map_sha256") == manifest_hash(result)
    except (OSError, ValueError, AttributeError, RecursionError):
        return False


def _move_cloud(folder: Path, stamps_s: Floats, T_world_cam: Floats) -> None:
    """Move a recording's cloud from the poses of its trajectory.txt to the present poses."""
    cloud, trajectory = folder / CLOUD, folder / TRAJECTORY
    if not (cloud.is_file() and trajectory.is_file()):
        return
    try:
        before = read_trajectory(trajectory)
        points, colors = read_ply(cloud)
    except MiniloopError:
        return
    _, a, b = np.intersect1d(np.round(before.timestamps_s, 6), np.round(stamps_s, 6), return_indices=True)
    if not len(a):
        return
    old, new = before.T_world_cam[a], T_world_cam[b]
    R = se3.project_so3((new[:, :3, :3] @ np.swapaxes(old[:, :3, :3], 1, 2)).sum(axis=0))
    t = (new[:, :3, 3] - old[:, :3, 3] @ R.T).mean(axis=0)
    if np.abs(R - np.eye(3)).max() > 1e-9 or np.abs(t).max() > 1e-9:
        write_ply(cloud, points @ R.T + t, colors)


def _read(clouds: list[Path]) -> Iterator[tuple[Floats, Bytes]]:
    for path in clouds:
        if path.is_file():
            points, colors = read_ply(path)
            yield points.astype(float), colors
