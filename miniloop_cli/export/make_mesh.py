"""From a result to a mesh: fused, without small pieces, closed, textured, as requested."""

from __future__ import annotations

from dataclasses import dataclass

from miniloop_cli.export.floaters import without_floaters
from miniloop_cli.export.mesh import Surface, fuse, import_open3d
from miniloop_cli.export.mesh_model import Mesh
from miniloop_cli.export.model import Model


@dataclass(frozen=True)
class Wishes:
    """Options of the mesh: lengths in metres, memory of the fusion in MB, the texture's largest side in pixels."""

    voxel_m: float = 0.01
    max_depth_m: float = 4.0
    memory_mb: int = 3000
    min_weight: float = 3.0
    min_piece_m: float = 0.2
    texture: bool = False
    texture_px: int = 8192
    keep_unseen: bool = False
    watertight: bool = False


@dataclass(frozen=True)
class Made:
    """The mesh, the fused surface, and notes for the user."""

    mesh: Mesh
    surface: Surface
    notes: tuple[str, ...]


def make_mesh(model: Model, wishes: Wishes, quiet: bool = False) -> Made:
    """The mesh of a result. Raises MiniloopError without open3d, or without any depth."""
    o3d, glimpses = import_open3d(), None
    if wishes.texture:
        from miniloop_cli.export.texture.glimpses import Glimpses

        glimpses = Glimpses()
    surface = fuse(
        model, wishes.voxel_m, wishes.max_depth_m, wishes.memory_mb, wishes.min_weight, quiet, observe=glimpses
    )
    notes = [f"skipped {reason}" for reason in surface.skipped]
    if surface.voxel_m > wishes.voxel_m:
        notes.append(f"voxels of {1000 * surface.voxel_m:.0f} mm, to stay within {wishes.memory_mb} MB")
    mesh, floaters = without_floaters(Mesh(surface.vertices, surface.colors, surface.triangles), wishes.min_piece_m)
    if floaters:
        notes.append(f"left out {floaters} pieces smaller than {wishes.min_piece_m:g} m (--min-piece)")
    if wishes.watertight:
        from miniloop_cli.export.watertight import watertight

        mesh = watertight(o3d, mesh, surface.voxel_m)
    if glimpses is not None:
        from miniloop_cli.export.texture.bake import textured

        keep = wishes.keep_unseen or wishes.watertight
        before = len(mesh.triangles)
        mesh = textured(o3d, model, mesh, glimpses, surface.voxel_m, wishes.texture_px, keep, quiet)
        if len(mesh.triangles) < before:
            share = 1 - len(mesh.triangles) / before
            notes.append(f"left out {100 * share:.0f} % of the surface that no image used shows (--keep-unseen)")
    return Made(mesh, surface, tuple(notes))
