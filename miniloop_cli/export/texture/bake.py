"""A mesh's texture from the sharpest scans that show it, with equalised exposure and levelled seams."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import ModuleType

import cv2
import numpy as np

from miniloop_cli.datasets import read_scan
from miniloop_cli.export.mesh_model import Mesh, Texture, averaging
from miniloop_cli.export.model import Model
from miniloop_cli.export.texture.charts import Charts, Layout, lay_out, make_charts, paint_cells, texture_coordinates
from miniloop_cli.export.texture.exposure import gains
from miniloop_cli.export.texture.glimpses import Glimpses
from miniloop_cli.export.texture.labels import Candidates, Labels, choose_labels
from miniloop_cli.export.texture.seams import level, seam_pairs
from miniloop_cli.export.texture.sight import Hits, Sight, smooth_normals
from miniloop_cli.export.texture.views import choose_views, sharpness_weight
from miniloop_cli.export.undistort import undistorter
from miniloop_cli.runtime.progress import track
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.typing import Bytes, Floats, Floats32, Ints

EXPOSURE_SAMPLES = 20_000
IMAGE_BYTES = 200_000_000  # of decoded images in memory
SAMPLE_BLUR_PX = 5  # colours at seams are means over so many pixels
SPREAD_PX = 15  # margin of the offsets of a patch
Read = Callable[[int], Scan]


def textured(o3d: ModuleType, model: Model, mesh: Mesh, glimpses: Glimpses, voxel_m: float,
             largest_px: int = 8192, keep_unseen: bool = False, quiet: bool = False) -> Mesh:  # fmt: skip
    """The mesh with a texture of at most `largest_px` a side.

    Every triangle is coloured by one scan that sees it sharply, from nearby and frontally. Triangles hidden from all
    scans are left out; with `keep_unseen` they keep the colours of their vertices. `glimpses`: of the fused scans,
    whose images are read again. Raises InputError for one that can no longer be read.
    """
    camera, read = model.recording.camera, reader(model)
    rows = choose_views(mesh, glimpses, model.trajectory.T_world_cam, camera)
    poses = model.trajectory.T_world_cam[rows]
    smooth = averaging(mesh)
    sight, normals = Sight(o3d, mesh, camera, voxel_m), smooth_normals(mesh, smooth)
    candidates, samples = Candidates(mesh, smooth), []
    every = 1 + len(mesh.vertices) // EXPOSURE_SAMPLES
    for view, row in enumerate(track(rows.tolist(), "texture: looking", quiet=quiet)):
        scan = read(row)
        shown = sight.quality(poses[view], scan, sight.hits(poses[view]), normals)
        candidates.add(view, shown, sharpness_weight(glimpses[row]))
        some = np.flatnonzero((shown.quality > 0) & (shown.vertex % every == 0))
        colors = colors_at(blurred(scan.color), shown.px[some])
        samples.append((np.full(len(some), view), shown.vertex[some], colors))
    of_view, point, colors = (np.concatenate([sample[k] for sample in samples]) for k in range(3))
    gain = gains(of_view, point, colors, len(rows))
    kept = np.flatnonzero(candidates.seen[mesh.triangles].any(axis=1))
    if keep_unseen:
        kept = np.arange(len(mesh.triangles))
    mesh = mesh.subset(kept)
    sight = Sight(o3d, mesh, camera, voxel_m)
    label = choose_labels(mesh, candidates.view[kept], candidates.quality[kept])
    charts = make_charts(mesh, label, poses, camera)
    offset, bare_colors = levelled(charts, mesh, rows, read, gain)
    layout = lay_out(charts, camera, largest_px)
    image = np.zeros((layout.height, layout.width, 3), np.uint8)
    used = np.unique(label[label >= 0]).tolist()
    for view in track(used, "texture: painting", quiet=quiet):
        picture = read(int(rows[view])).color * gain[view].astype(np.float32)
        picture += offset_image(charts, offset, label, view, sight.hits(poses[view]), picture.shape[:2])
        paste(image, layout, np.flatnonzero(charts.view == view), np.rint(picture.clip(0, 255)).astype(np.uint8))
    paint_cells(image, layout, bare_colors[charts.corners[layout.bare]])
    uv, triangles, node = texture_coordinates(charts, layout)
    vertex = charts.vertex[node]
    return Mesh(mesh.vertices[vertex], mesh.colors[vertex], triangles, Texture(uv, image))


def reader(model: Model) -> Read:
    """A reader of undistorted scans by row of the trajectory, with a cache."""
    undistort, numbers = undistorter(model.recording.camera), model.recording_rows
    camera = model.recording.camera

    @lru_cache(maxsize=max(1, IMAGE_BYTES // (7 * camera.width * camera.height)))
    def read(row: int) -> Scan:
        return undistort(read_scan(model.recording, int(numbers[row])))

    return read


def blurred(color: Bytes) -> Bytes:
    """The mean around each pixel of (h, w, 3)."""
    return np.asarray(cv2.blur(color, (SAMPLE_BLUR_PX, SAMPLE_BLUR_PX)), np.uint8)


def colors_at(color: Bytes, px: Floats | Floats32) -> Floats32:
    """(k, 3) colours at the nearest of pixels (k, 2)."""
    u, v = np.rint(px).astype(np.int64).T
    h, w = color.shape[:2]
    return color[v.clip(0, h - 1), u.clip(0, w - 1)].astype(np.float32)


def levelled(charts: Charts, mesh: Mesh, rows: Ints, read: Read, gain: Floats) -> tuple[Floats32, Floats32]:
    """Offsets (n, 3) of the nodes that close the seams; and the colours of the mesh at the nodes with these offsets.

    rows (v,): the frame of each view; gain (v, 3): what its colours are multiplied by.
    """
    pairs = seam_pairs(charts.vertex)
    color = mesh.colors[charts.vertex].astype(np.float32)
    bare = color.copy()
    of_view = charts.view[charts.patch]
    at_seam = np.unique(pairs)
    for view in np.unique(of_view[of_view >= 0]).tolist():
        nodes = at_seam[of_view[at_seam] == view]
        if len(nodes):
            color[nodes] = colors_at(blurred(read(int(rows[view])).color), charts.px[nodes]) * gain[view]
    offset = level(charts.corners, pairs, color)
    return offset, bare + offset


def offset_image(
    charts: Charts, offset: Floats32, label: Labels, view: int, hits: Hits, shape: tuple[int, int]
) -> Floats32:
    """(h, w, 3) the offsets of the nodes, interpolated over the triangles of a view, with a margin."""
    hit = hits.triangle
    own = (hit >= 0) & (label[hit] == view)
    corners, u, v = charts.corners[hit[own]], hits.uv[own][:, :1], hits.uv[own][:, 1:]
    image = np.zeros((*hit.shape, 4), np.float32)
    inside = (1 - u - v) * offset[corners[:, 0]] + u * offset[corners[:, 1]] + v * offset[corners[:, 2]]
    image[own, :3], image[own, 3] = inside, 1
    around = cv2.blur(image, (SPREAD_PX, SPREAD_PX))
    around = around[..., :3] / np.maximum(around[..., 3:], 1e-6)
    filled = np.where(own[..., None], image[..., :3], around)
    if filled.shape[:2] == shape:
        return filled
    return np.asarray(cv2.resize(filled, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def paste(texture: Bytes, layout: Layout, patches: Ints, picture: Bytes) -> None:
    """Copy the rectangles of patches (k,) from the picture (h, w, 3) of their view into the texture (s, s, 3)."""
    for p in patches.tolist():
        left, top, right, bottom = layout.source[p].tolist()
        (x, y), (w, h) = layout.corner[p].tolist(), layout.size[p].tolist()
        part = picture[top:bottom, left:right]
        if part.shape[:2] != (h, w):
            part = np.asarray(cv2.resize(part, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
        texture[y : y + h, x : x + w] = part
