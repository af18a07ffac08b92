"""The results folder of `register`: every file whole or absent."""

from __future__ import annotations

import json
import platform
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from miniloop_cli.datasets import read_scan
from miniloop_cli.datasets.intrinsics import save_camera
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.results import calibration
from miniloop_cli.results.assessment import assess_run
from miniloop_cli.results.fuse_cloud import fuse_cloud
from miniloop_cli.results.g2o import write_g2o
from miniloop_cli.results.landmarks import write_landmarks
from miniloop_cli.results.map_folder import remove_map
from miniloop_cli.results.ply import write_ply
from miniloop_cli.results.rejected_matches import write_rejected
from miniloop_cli.results.tables import EDGE_COLUMNS, FRAME_COLUMNS, edge_rows, frame_rows, frame_status, write_csv
from miniloop_cli.results.thumbnails import write_thumbnails
from miniloop_cli.runtime.artifact_store import Arrays, Artifact, Store, library_versions
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.certificate import Certificate
from miniloop_cli.scene.frame_status import FrameStatus
from miniloop_cli.scene.registration import Registration
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.typing import Bytes, Floats, Floats32, Ints
from miniloop_cli.version import __version__

CLOUD = Artifact("cloud", 2)
# Files that depend on poses or describe a whole run: those of an earlier run are removed.
OF_ONE_RUN = (
    *("trajectory.txt", "graph.g2o", "cloud.ply", "covariances.npz", "landmarks.npz"),
    *("thumbnails.npz", "summary.json", "log.txt", "report.html"),
)

OF_ANY_RUN = ("config.yaml", "camera.yaml", "frames.csv", "edges.csv", "inliers.npz", "rejected.npz")
FILES = (*OF_ANY_RUN, *reversed(OF_ONE_RUN))  # all of a run, its trajectory last


def write_results(run: Registration, folder: Path, workers: Workers, store: Store) -> None:
    """Write all artefacts of a run; the trajectory last, so that a folder that has one is complete.

    A run that registered nothing writes everything except trajectory, graph and cloud.
    """
    for name in OF_ONE_RUN:
        (folder / name).unlink(missing_ok=True)
    remove_map(folder)
    stamps = np.array([frame.timestamp_s for frame in run.sequence.frames])
    _write_yaml(run, folder / "config.yaml")
    told = calibration.uncertainty(run.calibration) if run.calibration and run.calibration.changed else None
    save_camera(folder / "camera.yaml", run.sequence.camera, told, run.sequence.depth_camera)
    write_csv(folder / "frames.csv", FRAME_COLUMNS, frame_rows(run))
    write_csv(folder / "edges.csv", EDGE_COLUMNS, edge_rows(run))
    _write_inliers(run, folder / "inliers.npz")
    write_rejected(run, folder / "rejected.npz")
    if run.thumbnails:
        write_thumbnails(folder / "thumbnails.npz", run.thumbnails)
    registered = run.poses.registered
    if len(registered):
        _write_graph(run, folder / "graph.g2o")
        _write_covariances(run, folder / "covariances.npz")
        if len(run.landmarks.point):
            write_landmarks(folder / "landmarks.npz", run.landmarks)
        begin = time.perf_counter()
        write_ply(folder / "cloud.ply", *_cloud(run, workers, store))
        run.timings_s["model"] = round(time.perf_counter() - begin, 3)
    with atomic_write(folder / "summary.json") as file:
        json.dump(summary(run), file, indent=1)
        file.write("\n")
    if len(registered):
        write_trajectory(folder / "trajectory.txt", Trajectory(stamps[registered], run.poses.T_world_cam[registered]))


def summary(run: Registration) -> dict[str, Any]:
    """The run in numbers, JSON-able.

    `cycles`: edges by solver, as in the paper's table; `verdict`: how far the run can be trusted.
    """
    assessment = assess_run(run)
    sizes = np.bincount(run.poses.component[run.poses.component >= 0])
    verdicts = Counter(Verdict(int(number)).label for number in run.edges.verdict)
    problems = [k for k, scan in enumerate(run.scans) if scan.problem]
    return {
        "sequence": run.sequence.name,
        "recording": str(run.sequence.root),
        "layout": run.sequence.layout,
        **({"topics": run.sequence.topics} if run.sequence.topics else {}),
        "frames": len(run.sequence.frames),
        "registered": len(run.poses.registered),
        "components": len(sizes),
        "component_sizes": sizes.tolist(),
        "keyframes": len(run.scan_frames),
        "unreadable_frames": sum(frame_status(run, k)[0] == FrameStatus.UNREADABLE for k in problems),
        "edges": int(run.edges.verified.sum()),
        "verdicts": dict(sorted(verdicts.items())),
        "cycles": pairs_by_solver(run.edges.solver.tolist(), run.settings.cycles.longest),
        "camera": run.sequence.camera.source,
        "leveled": run.leveled,
        "rolling_shutter_s": round(run.timing.readout_s, 5),
        "depth_lag_s": round(run.timing.lag_s, 5),
        **({"calibration": calibration.numbers(run.calibration)} if run.calibration else {}),
        "verdict": {
            "level": assessment.level.value,
            "headline": assessment.headline,
            "reasons": list(assessment.reasons),
        },
        **({"certificate": certificate_numbers(run.certificate)} if run.certificate else {}),
        "notes": [{"kind": note.kind.value, "text": note.text} for note in run.notes],
        "timings_s": run.timings_s,
        "seed": run.seed,
        "versions": versions(),
    }


def certificate_numbers(certificate: Certificate) -> dict[str, Any]:
    """The certificate, JSON-able: numbers that are not known are None."""

    def known(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return {
        "certified": certificate.certified,
        "relative_gap": known(certificate.relative_gap),
        "moved_by_refinement_m": known(round(certificate.moved_m, 6)),
        "better_minimum_taken": certificate.escaped,
    }


def pairs_by_solver(solvers: Iterable[str], longest: int) -> dict[str, int]:
    """Number of pairs by solver: cycles from the longest on, pairs, and others."""
    counts = Counter(solvers)
    known = {str(n): f"cycle{n}" for n in range(max(longest, 5), 2, -1)} | {"pairwise": "pairwise"}
    others = {name: name for name in sorted(counts) if name not in known.values()}
    return {label: counts[name] for label, name in (known | others).items()}


def versions() -> dict[str, str]:
    """Versions of miniloop, Python and the libraries that the result depends on."""
    return {"miniloop": __version__, "python": platform.python_version()} | library_versions()


def _write_yaml(run: Registration, path: Path) -> None:
    with atomic_write(path) as file:
        yaml.safe_dump(run.settings.model_dump(), file, sort_keys=False)


def _write_inliers(run: Registration, path: Path) -> None:
    """Measured pixels of the inlier matches, edge after edge in the order of edges.csv; none of rejected ones."""
    edges = run.edges
    kept = edges.inliers & np.repeat(edges.open, edges.match_count)
    counts = np.where(edges.open, edges.inlier_count - edges.followed, 0)
    px = np.concatenate([np.zeros((0, 2)), *(scan.features.px for scan in run.scans)]).astype(np.float32)
    first = np.cumsum([0] + [len(scan.features) for scan in run.scans])  # of each scan in px
    rows = edges.matches[kept]
    px_i, px_j = (px[first[scans].repeat(counts) + rows[:, k]] for k, scans in enumerate((edges.i, edges.j)))
    with atomic_write(path, "wb") as file:
        np.savez(file, offsets=np.cumsum([0, *counts]), px_i=px_i, px_j=px_j)


def _write_covariances(run: Registration, path: Path) -> None:
    """Covariance of every registered frame whose pose has one."""
    registered = run.poses.registered
    known = registered[np.isfinite(run.covariance[registered]).all(axis=(1, 2))]
    with atomic_write(path, "wb") as file:
        np.savez(file, frames=known, covariance=run.covariance[known])


def _write_graph(run: Registration, path: Path) -> None:
    registered = run.poses.registered
    edges = run.edges.subset(run.edges.verified & (run.poses.component[run.edges.i] == 0))
    write_g2o(path, registered, run.poses.T_world_cam[registered], edges.pairs, edges.T_j_i, edges.information)


def _cloud(run: Registration, workers: Workers, store: Store) -> tuple[Floats32, Bytes]:
    """Points and colours of the model, from the cache if the same scans were fused at the same poses."""
    scans = modelled(run)
    poses = run.poses.T_world_cam[scans]
    inputs = ([run.scans[k].key for k in scans], poses, run.settings.cloud, run.settings.depth)

    def fused() -> Arrays:
        points, colors = fuse_cloud(_world_points(run, workers), run.settings.cloud.voxel_m)
        return {"points": points, "colors": colors}

    kept = store.cached(CLOUD, inputs, fused)
    return kept["points"], kept["colors"]


def modelled(run: Registration) -> Ints:
    """Frames (k,) of the model: registered scans, as frames between keyframes add little."""
    return np.intersect1d(run.poses.registered, run.scan_frames)


def _world_points(run: Registration, workers: Workers) -> Iterator[tuple[Floats, Bytes]]:
    """Coloured points of every registered scan, in order, computed a few scans ahead."""
    camera, depth, stride = run.sequence.camera, run.settings.depth, run.settings.cloud.stride_px

    @cache
    def ideal(height: int, width: int) -> Floats:
        v, u = np.mgrid[0:height:stride, 0:width:stride]
        return camera.undistort(np.stack([u.ravel(), v.ravel()], axis=1))

    def points(index: int) -> tuple[Floats, Bytes]:
        try:
            scan = read_scan(run.sequence, index)
        except InputError:
            return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
        z = scan.depth_m[::stride, ::stride].ravel().astype(float)
        good = (z >= depth.min_m) & (z <= depth.max_m)
        p_cam = camera.backproject(ideal(*scan.depth_m.shape)[good], z[good])
        return se3.transform(run.poses.T_world_cam[index], p_cam), scan.color[::stride, ::stride].reshape(-1, 3)[good]

    scans = modelled(run).tolist()
    return workers.map(points, scans, "building the model", len(scans))
