"""Charts: patches of triangles that are coloured by one view, cut out of its image.

A chart needs no unwrapping, as the projection of the view flattens it, and its texels are the camera's pixels.
Triangles that no view shows have a cell each, filled from the colours of their vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.export.mesh_model import Mesh, Triangles, face_pairs
from miniloop_cli.export.texture.labels import Labels, patches
from miniloop_cli.export.texture.pack import pack
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.typing import Bytes, Floats, Floats32, Ints

PAD_PX = 2
CELL_PX = 4  # of a triangle that no view shows: corners two pixels apart, and a border
CELL_CORNERS_PX = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]])
ROOM = 0.98  # charts that do not fit shrink a little more than computed


@dataclass(frozen=True)
class Charts:
    """Nodes (n): a vertex in a patch. `vertex` (n,) and `patch` (n,) of each, `corners` (m, 3) nodes of the triangles.

    view (p,) of every patch, -1 without a view; px (n, 2) pixels of the nodes in their views.
    """

    vertex: Ints
    patch: Ints
    corners: Triangles
    view: Labels
    px: Floats


@dataclass(frozen=True)
class Layout:
    """Charts in a texture of `width` and `height`: rectangles (p, 4: left, top, right, bottom) in the images.

    corner (p, 2) and size (p, 2) in the texture. Rows of cells, of the triangles `bare` (k,), begin at `cells_top`.
    """

    width: int
    height: int
    source: Ints
    corner: Ints
    size: Ints
    cells_top: int
    bare: Ints


def make_charts(mesh: Mesh, label: Labels, poses: Floats, camera: Camera) -> Charts:
    """Charts of the triangles' labels (m,): numbers of views at `poses` (k, 4, 4) T_world_cam."""
    patch = patches(label, face_pairs(mesh.triangles))
    keys = mesh.triangles.astype(np.int64) | patch[:, None] << 32
    nodes, corners = np.unique(keys, return_inverse=True)
    vertex, node_patch = nodes & 0xFFFFFFFF, nodes >> 32
    view = np.empty(int(patch.max(initial=-1)) + 1, np.int16)
    view[patch] = label
    px = np.zeros((len(nodes), 2))
    T_cam_world = se3.inverse(poses)
    of_view = view[node_patch]
    for number in np.unique(of_view[of_view >= 0]).tolist():
        rows = np.flatnonzero(of_view == number)
        px[rows] = camera.project(se3.transform(T_cam_world[number], mesh.vertices[vertex[rows]].astype(float)))
    return Charts(vertex, node_patch, corners.reshape(-1, 3).astype(np.int32), view, px)


def lay_out(charts: Charts, camera: Camera, largest_px: int) -> Layout:
    """A texture of at most `largest_px` a side; charts shrink together if they do not fit."""
    order = np.argsort(charts.patch, kind="stable")
    start = np.flatnonzero(np.diff(charts.patch[order], prepend=-1))
    low = np.floor(np.minimum.reduceat(charts.px[order], start)).astype(np.int64) - PAD_PX
    high = np.ceil(np.maximum.reduceat(charts.px[order], start)).astype(np.int64) + PAD_PX + 1
    image = np.array([camera.width, camera.height])
    source = np.concatenate([low.clip(0, image - 1), high.clip(1, image)], axis=1)
    shown = charts.view >= 0
    bare = np.flatnonzero(~shown[charts.patch[charts.corners[:, 0]]])
    scale = 1.0
    while True:
        size = np.ceil(scale * (source[:, 2:] - source[:, :2])).astype(np.int64)
        size[~shown] = 0
        corner = np.zeros_like(size)
        corner[shown], width, height = pack(size[shown])
        width = max(width, CELL_PX)
        whole = height + CELL_PX * -(-len(bare) // (width // CELL_PX))
        if max(width, whole) <= largest_px or scale < 0.01:
            return Layout(width, max(whole, 1), source, corner, size, height, bare)
        scale *= ROOM * largest_px / max(width, whole)


def texture_coordinates(charts: Charts, layout: Layout) -> tuple[Floats32, Triangles, Ints]:
    """UV (n', 2), triangles (m, 3) over them, and the node (n',) of each: bare triangles have their own corners."""
    p = charts.patch
    scale = layout.size / np.maximum(layout.source[:, 2:] - layout.source[:, :2], 1)
    at = layout.corner[p] + (charts.px + 0.5 - layout.source[p, :2]) * scale[p]
    column = max(layout.width // CELL_PX, 1)
    number = np.arange(len(layout.bare))
    cell = np.stack([number % column, number // column], axis=1) * CELL_PX + [0, layout.cells_top]
    at_bare = (cell[:, None] + CELL_CORNERS_PX + 0.5).reshape(-1, 2)
    node = np.concatenate([np.arange(len(p)), charts.corners[layout.bare].ravel()])
    triangles = charts.corners.astype(np.int64)
    triangles[layout.bare] = len(p) + np.arange(len(at_bare)).reshape(-1, 3)
    used, triangles = np.unique(triangles, return_inverse=True)
    uv = np.concatenate([at, at_bare])[used] / [layout.width, layout.height]
    return uv.astype(np.float32), triangles.reshape(-1, 3).astype(np.int32), node[used]


def paint_cells(texture: Bytes, layout: Layout, colors: Floats32) -> None:
    """Fill the cells of the bare triangles, whose corners have `colors` (k, 3, 3), in `texture` (h, w, 3)."""
    place = np.arange(CELL_PX) / 2
    u, v = np.meshgrid(place, place)
    weight = np.stack([1 - u - v, u, v], axis=-1)
    cells = np.einsum("yxc,kcn->kyxn", weight, colors)
    column = max(layout.width // CELL_PX, 1)
    rows = -(-len(cells) // column)
    block = np.zeros((rows * column, CELL_PX, CELL_PX, 3), np.uint8)
    block[: len(cells)] = np.rint(cells.clip(0, 255)).astype(np.uint8)
    block = block.reshape(rows, column, CELL_PX, CELL_PX, 3).swapaxes(1, 2)
    texture[layout.cells_top :, : column * CELL_PX] = block.reshape(rows * CELL_PX, column * CELL_PX, 3)
