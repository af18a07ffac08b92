"""What maps are worth: images of a recording found in a map of its other images; recordings joined to one map."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from miniloop_cli import datasets
from miniloop_cli.datasets.read import read_ground_truth, read_scan
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.procrustes import align_points
from miniloop_cli.mapping.alone import map_of
from miniloop_cli.mapping.location import Location
from miniloop_cli.mapping.part import part_of
from miniloop_cli.maps import register_many
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.results.map import Map
from miniloop_cli.results.map_folder import write_map
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.typing import Floats

WRONG_M, WRONG_DEG = 0.1, 5.0
ROWS = (  # name, whether depth is shown, and by what the focal length is wrong where it is told as a guess
    ("with depth", True, None),
    ("colour alone", False, None),
    ("colour, focal length a guess, 10 % too short", False, 0.9),
    ("colour, focal length a guess, 10 % too long", False, 1.1),
)


def show_located(path: Path, every: int, others: tuple[Path, ...]) -> None:
    """Every so manieth frame of a recording looked for in the map of the others; then frames of other places."""
    whole = datasets.open_sequence(path)
    left_out = np.arange(every // 2, len(whole.frames), every)
    rest = np.setdiff1d(np.arange(len(whole.frames)), left_out)
    with tempfile.TemporaryDirectory() as folder:
        opened = _map_of(replace(whole, frames=tuple(whole.frames[k] for k in rest)), Path(folder))
        print(f"{len(opened.content.joined.T_world_cam)} keyframes, {len(left_out)} frames left out")
        print("| | found | sure | median cm | median deg | largest cm | wrong and sure | CPU s a frame |")
        print("|---|---:|---:|---:|---:|---:|---:|---:|")
        for name, with_depth, focal in ROWS:
            print(_row(name, opened, whole, left_out, with_depth, focal))
        for other in others:
            sequence = datasets.open_sequence(other)
            found = [opened.locate(*_images(sequence, k, True)) for k in range(len(sequence.frames))]
            count = sum(location.found for location in found)
            print(f"{sequence.name}: {count} of {len(found)} found, {sum(location.sure for location in found)} sure")


def show_joined(paths: tuple[Path, ...]) -> None:
    """Recordings with ground truths in one frame, joined: errors of each with an alignment of its own and with one."""
    with tempfile.TemporaryDirectory() as folder:
        numbers = register_many(paths, folder)
        pairs = []
        for recording, path in zip(numbers["recordings"], paths, strict=True):
            found = read_trajectory(Path(folder) / recording["name"] / "trajectory.txt")
            truth = read_ground_truth(datasets.open_sequence(path))
            if truth is None:
                raise MiniloopError(f"{path} has no ground truth")
            t, p = truth.timestamps_s, truth.T_world_cam[:, :3, 3]
            at = np.stack([np.interp(found.timestamps_s, t, column) for column in p.T], axis=1)
            pairs.append((found.T_world_cam[:, :3, 3], at))
        together = align_points(*(np.concatenate(side) for side in zip(*pairs, strict=True)))
        print(f"{numbers['pieces']} pieces")
        print("| | aligned alone, ATE cm | aligned together, ATE cm |")
        print("|---|---:|---:|")
        for recording, (p, q) in zip(numbers["recordings"], pairs, strict=True):
            errors = [_rmse_cm(fit.points(p), q) for fit in (align_points(p, q), together)]
            print(f"| {recording['name']} | {errors[0]:.2f} | {errors[1]:.2f} |")


def _rmse_cm(p: Floats, q: Floats) -> float:
    return 100 * float(np.sqrt(((p - q) ** 2).sum(axis=1).mean()))


def _map_of(sequence: Sequence, folder: Path) -> Map:
    settings = load_settings("default", ())
    run = register(sequence, settings, Store(default_folder()), Workers(-1, True))
    write_map(folder, map_of(part_of(run, settings.features.type), settings.model_dump(), 0))
    return Map.open(folder)


def _row(
    name: str, opened: Map, whole: Sequence, frames: np.ndarray, with_depth: bool, focal: float | None = None
) -> str:
    part = opened.content.parts[0]
    found: list[Location] = []
    begin = time.process_time()
    for k in frames.tolist():
        color, depth_m = _images(whole, k, with_depth)
        if focal is None:
            found.append(opened.locate(color, depth_m))
        else:
            camera = replace(part.camera, fx=focal * part.camera.fx, fy=focal * part.camera.fy)
            found.append(opened.locate_roughly(color, depth_m, camera))
    seconds = (time.process_time() - begin) / len(frames)
    truth = _between(part.stamps_s, part.T_world_cam, whole.stamps_s[frames])
    off = np.full((len(frames), 2), np.nan)
    for k, location in enumerate(found):
        if location.T_world_cam is not None:
            E = se3.inverse(truth[k]) @ location.T_world_cam
            off[k] = np.linalg.norm(E[:3, 3]), float(se3.rotation_angle_deg(E[:3, :3]))
    sure = np.array([location.sure for location in found])
    wrong = sure & ((off[:, 0] > WRONG_M) | (off[:, 1] > WRONG_DEG))
    share = [100 * np.mean([getattr(location, key) for location in found]) for key in ("found", "sure")]
    return (
        f"| {name} | {share[0]:.1f} % | {share[1]:.1f} % | {100 * np.nanmedian(off[:, 0]):.2f} |"
        f" {np.nanmedian(off[:, 1]):.2f} | {100 * np.nanmax(off[:, 0]):.1f} | {wrong.sum()} | {seconds:.2f} |"
    )


def _images(sequence: Sequence, frame: int, with_depth: bool) -> tuple[np.ndarray, np.ndarray | None]:
    scan = read_scan(sequence, frame)
    return scan.color, scan.depth_m if with_depth else None


def _between(stamps_s: Floats, T_world_cam: Floats, at_s: Floats) -> Floats:
    """Poses (m, 4, 4) at other times, by splines through the map's own."""
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    R = RotationSpline(stamps_s, Rotation.from_matrix(T_world_cam[:, :3, :3]))(at_s).as_matrix()
    return se3.pose(R, CubicSpline(stamps_s, T_world_cam[:, :3, 3])(at_s))
