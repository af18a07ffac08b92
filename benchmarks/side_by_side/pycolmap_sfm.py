"""COLMAP's incremental structure from motion through pycolmap: colour alone, so that its scale is unknown.

Images are undistorted first and the intrinsics are held fixed: with freiburg1's lens (k3 = 1.16) in the model the
mapper finds the parameter beyond its bound and returns no model at all, without a word.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from benchmarks.side_by_side.clock import Clock, arguments, write_poses, write_result
from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.export.undistort import undistorter
from miniloop_cli.scene.sequence import Sequence


def undistort_images(sequence: Sequence, folder: Path) -> None:
    """Write every colour image as an ideal pinhole camera of the same K would have taken it, named by its number."""
    undistort = undistorter(sequence.camera)
    for k in range(len(sequence.frames)):
        color = undistort(read_scan(sequence, k)).color
        cv2.imwrite(str(folder / f"{k:06d}.png"), cv2.cvtColor(color, cv2.COLOR_RGB2BGR))


def reconstruct(sequence: Sequence, folder: Path, clock: Clock) -> pycolmap.Reconstruction | None:
    """The model with most images, or None."""
    images, database, camera = folder / "images", folder / "database.db", sequence.camera
    images.mkdir()
    with clock.stage("undistortion"):
        undistort_images(sequence, images)
    # COLMAP's pixel centres lie at halves.
    intrinsics = ",".join(map(str, (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5)))
    reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE", camera_params=intrinsics)
    with clock.stage("features"):
        pycolmap.extract_features(
            database, images, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader, device=pycolmap.Device.cpu
        )
    with clock.stage("matching"):
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    mapping = pycolmap.IncrementalPipelineOptions(random_seed=0, extract_colors=False)
    mapping.ba_refine_focal_length = mapping.ba_refine_principal_point = mapping.ba_refine_extra_params = False
    mapping.mapper.abs_pose_refine_focal_length = mapping.mapper.abs_pose_refine_extra_params = False
    with clock.stage("mapping"):
        models = pycolmap.incremental_mapping(database, images, folder, mapping)
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def main() -> None:
    options = arguments(__doc__)
    clock, sequence = Clock(), open_sequence(options.sequence)
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    with tempfile.TemporaryDirectory() as folder:
        model = reconstruct(sequence, Path(folder), clock)
    poses = {}
    for image in model.images.values() if model else ():
        if image.has_pose:
            T_world_cam = np.eye(4)
            T_world_cam[:3] = image.cam_from_world().inverse().matrix()
            poses[int(Path(image.name).stem)] = T_world_cam
    scans = sorted(poses)
    stamps = np.array([frame.timestamp_s for frame in sequence.frames])
    if scans:
        write_poses(options.out, stamps[scans], np.array([poses[scan] for scan in scans]))
    write_result(options.out, {"stages": clock.stages, "frames": len(stamps), "edges": None})


if __name__ == "__main__":
    main()
