"""One surface from all scans: truncated signed distances (Curless & Levoy 1996) in Open3D's VoxelBlockGrid."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets import read_scan
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.export.model import Model
from miniloop_cli.export.undistort import undistorter
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.progress import track
from miniloop_cli.runtime.signals import uninterrupted
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.typing import Bytes, Floats32, Ints

BLOCK = 16  # voxels a side
# The voxels of a block (distance and weight float32, colour 3 float32), and the same again while the mesh is made.
BYTES_A_BLOCK = BLOCK**3 * 20 * 2
COARSER = 1.5  # factor on the voxel size if memory does not suffice
Observer = Callable[[int, Scan], None]  # takes a row of the trajectory and its undistorted scan
SYSTEM_PACKAGES = "libegl1 libgl1 libgomp1 libidn2-0 libusb-1.0-0"


@dataclass(frozen=True)
class Surface:
    """A coloured mesh, (n, 3) vertices (m), (n, 3) RGB, (m, 3) vertex numbers; its cloud; the voxel size used."""

    vertices: Floats32
    colors: Bytes
    triangles: NDArray[np.int32]
    points: Floats32
    point_colors: Bytes
    voxel_m: float
    skipped: tuple[str, ...] = ()


def import_open3d() -> ModuleType:
    """Open3D. Raises MiniloopError that names what to install."""
    try:
        with uninterrupted():  # half loaded, Open3D reports a memory leak and ends the process with status 1
            return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise MiniloopError(f"meshes need open3d ({error}): pip install open3d") from error
    except (ImportError, OSError) as error:
        raise MiniloopError(
            f"open3d cannot be loaded ({error}); on Debian and Ubuntu: apt-get install {SYSTEM_PACKAGES}"
        ) from error


def fuse(
    model: Model,
    voxel_m: float = 0.01,
    max_depth_m: float = 4.0,
    memory_mb: int = 3000,
    min_weight: float = 3.0,
    quiet: bool = False,
    observe: Observer | None = None,
) -> Surface:
    """Fuse every registered scan. A voxel must be seen `min_weight` times to count.

    If the surface needs more than `memory_mb`, the fusion starts again with voxels larger by COARSER.
    `observe` gets every fused scan, again after such a restart.
    Raises MiniloopError if open3d cannot be imported or nothing was fused; unreadable frames are skipped.
    """
    o3d = import_open3d()
    most_blocks = max(1, int(memory_mb * 1e6 / BYTES_A_BLOCK))
    while True:
        grid, skipped = integrate(o3d, model, voxel_m, max_depth_m, most_blocks, quiet, observe)
        if grid is not None:
            break
        voxel_m *= COARSER
    if grid.hashmap().size() == 0:
        raise MiniloopError(f"no scan has depth within {max_depth_m:g} m: nothing to fuse; see --max-depth")
    mesh = grid.extract_triangle_mesh(weight_threshold=min_weight)
    cloud = grid.extract_point_cloud(weight_threshold=min_weight)
    if not len(mesh.triangle.indices):
        raise MiniloopError(f"no surface was seen {min_weight:g} times: too few scans; see --min-weight")
    vertices, colors, order = in_order(mesh.vertex)
    points, point_colors, _ = in_order(cloud.point)
    triangles = np.argsort(order).astype(np.int32)[mesh.triangle.indices.numpy()]
    first = triangles.argmin(axis=1)[:, None]
    triangles = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    triangles = triangles[np.lexsort(triangles.T[::-1])]
    return Surface(vertices, colors, triangles, points, point_colors, voxel_m, tuple(skipped))


def in_order(points: Any) -> tuple[Floats32, Bytes, Ints]:
    """Positions (n, 3), colours (n, 3) and their order (n,), sorted, as the order of Open3D's threads varies."""
    positions, colors = points.positions.numpy(), to_bytes(points.colors.numpy())
    order = np.lexsort((*colors.T, *positions.T[::-1]))
    return positions[order], colors[order], order


def integrate(
    o3d: ModuleType,
    model: Model,
    voxel_m: float,
    max_depth_m: float,
    most_blocks: int,
    quiet: bool,
    observe: Observer | None = None,
) -> tuple[Any, list[str]]:
    """The filled grid, None if it needs more than `most_blocks`; and why frames were skipped."""
    core = o3d.core
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight", "color"),
        attr_dtypes=(core.float32,) * 3,
        attr_channels=((1,), (1,), (3,)),
        voxel_size=voxel_m,
        block_resolution=BLOCK,
        block_count=min(most_blocks, 2000),
    )
    sequence = model.recording
    undistort = undistorter(sequence.camera)
    K = core.Tensor(sequence.camera.K)
    poses = se3.inverse(model.trajectory.T_world_cam)
    skipped: list[str] = []
    jobs = list(zip(model.recording_rows.tolist(), poses, strict=True))
    for row, (k, T_cam_world) in enumerate(track(jobs, f"fusing at {1000 * voxel_m:.0f} mm", quiet=quiet)):
        try:
            scan = undistort(read_scan(sequence, k))
        except InputError as error:
            skipped.append(str(error))
            continue
        if observe is not None:
            observe(row, scan)
        if not ((scan.depth_m > 0) & (scan.depth_m < max_depth_m)).any():
            continue
        depth = o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(scan.depth_m)))
        color = o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(scan.color, np.float32) / 255))
        extrinsic = core.Tensor(np.ascontiguousarray(T_cam_world))
        blocks = grid.compute_unique_block_coordinates(depth, K, extrinsic, 1.0, max_depth_m)
        if grid.hashmap().size() + len(blocks) > most_blocks and exceeds(grid, blocks, most_blocks):
            return None, skipped
        grid.integrate(blocks, depth, color, K, K, extrinsic, 1.0, max_depth_m)
    return grid, skipped


def exceeds(grid: Any, blocks: Any, most_blocks: int) -> bool:
    """Whether the grid would hold more than `most_blocks` with these blocks."""
    known = grid.hashmap().find(blocks)[1].numpy()
    return grid.hashmap().size() + int((~known).sum()) > most_blocks


def to_bytes(colors: Floats32) -> Bytes:
    """Colours (n, 3) from [0, 1] to [0, 255]."""
    return np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8)
