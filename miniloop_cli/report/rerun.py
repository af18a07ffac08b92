"""A run as a recording for the Rerun viewer: frames, cameras, cloud, edges and cycles over time.

The world is that of trajectory.txt (the first camera: x right, y down, z forward). Timelines: `frame`, the frame's
number, and `seconds` since the first frame. An edge appears with its later frame.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from miniloop_cli.datasets import read_scan
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.export.undistort import undistorter
from miniloop_cli.results.ply import read_ply
from miniloop_cli.results.tables import frame_status
from miniloop_cli.runtime.atomic_files import replace, temporary_name
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import residuals
from miniloop_cli.scene.registration import Registration
from miniloop_cli.scene.sequence import Scan

# As in the report.
COLORS = {
    "cycle7": (194, 24, 91),
    "cycle6": (142, 68, 173),
    "cycle5": (31, 95, 191),
    "cycle4": (42, 157, 143),
    "cycle3": (224, 142, 11),
}
GREY = (140, 147, 157)
WANTED = "'miniloop[viz]'"
DEPTH_STRIDE = 4  # depth is shown in space, but the details are in the cloud
JPEG_QUALITY = 80


def import_rerun() -> ModuleType:
    """The Rerun SDK. Raises MiniloopError that names what to install."""
    try:
        rerun = importlib.import_module("rerun")
    except (ImportError, OSError) as error:
        raise MiniloopError(f"--rerun needs the Rerun SDK ({error}): pip install {WANTED}") from error
    if not hasattr(getattr(rerun, "RecordingStream", None), "set_time"):  # another package has the same name
        raise MiniloopError(
            f"the rerun that is installed is not the Rerun SDK, or older than 0.23: pip install {WANTED}"
        )
    return rerun


def write_rerun(run: Registration, results: Path, path: Path) -> Path:
    """Write `path` (.rrd), whole or not at all; `results` is the folder that the run was written to.

    Raises MiniloopError if Rerun is not installed or the file cannot be written.
    """
    rr = import_rerun()
    temporary = temporary_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
        stream = rr.RecordingStream("miniloop", recording_id=run.sequence.name)
        stream.save(temporary, default_blueprint=blueprint(rr))
        log_model(rr, stream, run, results)
        log_frames(rr, stream, run)
        stream.disconnect()
        replace(temporary, path)
    except OSError as error:
        raise MiniloopError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def blueprint(rr: ModuleType) -> Any:
    """The initial layout of the viewer: space beside the image, the counts below."""
    views = importlib.import_module("rerun.blueprint")
    side = views.Vertical(
        views.Spatial2DView(origin="world/camera/image", name="image"),
        views.TimeSeriesView(origin="counts", name="counts"),
        views.TextLogView(origin="log", name="log"),
    )
    return views.Blueprint(
        views.Horizontal(views.Spatial3DView(origin="world", name="model"), side, column_shares=[2, 1])
    )


def log_model(rr: ModuleType, stream: Any, run: Registration, results: Path) -> None:
    """Log the parts that do not change over time: axes, cloud, path."""
    stream.log("world", rr.ViewCoordinates.RDF, static=True)
    positions = run.poses.T_world_cam[run.poses.registered, :3, 3]
    stream.log("world/path", rr.LineStrips3D([positions], colors=[GREY]), static=True)
    try:
        points, colors = read_ply(results / "cloud.ply")
    except (InputError, OSError):
        return
    stream.log("world/cloud", rr.Points3D(points, colors=colors, radii=0.5 * run.settings.cloud.voxel_m), static=True)


def log_frames(rr: ModuleType, stream: Any, run: Registration) -> None:
    """Log frame after frame: camera, image, depth, the edges to earlier frames, and problems."""
    undistort, T = undistorter(run.sequence.camera), run.poses.T_world_cam
    used = run.edges.subset(run.edges.verified & run.poses.joins(run.edges))
    start_s = run.sequence.frames[0].timestamp_s
    for k, frame in enumerate(run.sequence.frames):
        stream.set_time("frame", sequence=k)
        stream.set_time("seconds", duration=frame.timestamp_s - start_s)
        stream.log("counts/features_with_depth", rr.Scalars(run.scans[k].features.with_depth))
        stream.log("counts/edges_to_earlier_frames", rr.Scalars(int((used.j == k).sum())))
        if run.poses.component[k] != 0:
            why = frame_status(run, k)[1]
            stream.log("log", rr.TextLog(f"frame {k} has no pose: {why}", level=rr.TextLogLevel.WARN))
            stream.log("world/camera", rr.Clear(recursive=True))
            continue
        stream.log("world/camera", rr.Transform3D(translation=T[k, :3, 3], mat3x3=T[k, :3, :3]))
        log_edges(rr, stream, run, k, used.subset(used.j == k))
        try:
            log_images(rr, stream, run, undistort(read_scan(run.sequence, k)))
        except InputError as error:
            stream.log("log", rr.TextLog(str(error), level=rr.TextLogLevel.WARN))


def log_edges(rr: ModuleType, stream: Any, run: Registration, k: int, edges: EdgeTable) -> None:
    """Edges from frame k to earlier ones, one entity a solver, each labelled with its cycle and residual."""
    T = run.poses.T_world_cam
    for solver in np.unique(edges.solver).tolist():
        own = edges.subset(edges.solver == solver)
        labels = [
            f"{i}-{j}{f', cycle {cycle}' if cycle >= 0 else ''}: {angle:.2f} deg, {100 * distance:.1f} cm"
            for i, j, cycle, angle, distance in zip(own.i, own.j, own.cycle, *residuals(own, T), strict=True)
        ]
        lines = rr.LineStrips3D(
            T[own.pairs, :3, 3], colors=[COLORS.get(solver, GREY)], labels=labels, show_labels=False
        )
        stream.log(f"world/edges/{solver}/{k:06d}", lines)


def log_images(rr: ModuleType, stream: Any, run: Registration, scan: Scan) -> None:
    """Colour (JPEG) and thinned depth, without lens distortion, each under its pinhole camera."""
    import cv2

    camera = run.sequence.camera
    _, data = cv2.imencode(
        ".jpg", np.ascontiguousarray(scan.color[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    stream.log(
        "world/camera/image",
        rr.Pinhole(image_from_camera=camera.K, width=camera.width, height=camera.height, image_plane_distance=0.2),
        rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg"),
    )
    depth_mm = np.rint(1000 * np.clip(scan.depth_m[::DEPTH_STRIDE, ::DEPTH_STRIDE], 0, 65)).astype(np.uint16)
    K = np.diag([1 / DEPTH_STRIDE, 1 / DEPTH_STRIDE, 1]) @ camera.K
    height, width = depth_mm.shape
    stream.log(
        "world/camera/depth",
        rr.Pinhole(image_from_camera=K, width=width, height=height, image_plane_distance=0.2),
        rr.DepthImage(depth_mm, meter=1000.0),
    )
