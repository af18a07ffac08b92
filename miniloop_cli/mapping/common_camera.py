"""Scans of different cameras in one common pinhole camera, so that scans can be compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from miniloop_cli.features.thumbnail import COLUMNS
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import PINHOLE
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.typing import Floats


def pinhole(camera: Camera) -> Camera:
    """The ideal camera of the same intrinsics."""
    return replace(camera, lens=PINHOLE)


def same_rays(px_ideal: Floats, own: Camera, common: Camera) -> Floats:
    """Undistorted pixels (n, 2) of one camera to those of another one at the same pose with the same rays."""
    scale = np.array([common.fx / own.fx, common.fy / own.fy])
    return (px_ideal - [own.cx, own.cy]) * scale + [common.cx, common.cy]


def features_in(features: ScanFeatures, own: Camera, common: Camera) -> ScanFeatures:
    """Features in the common camera; their measured pixels are the undistorted ones there."""
    px = same_rays(features.px_ideal, own, common)
    return replace(features, px=px, px_ideal=px)


def view_in(view: View | None, own: Camera, common: Camera) -> View | None:
    """A view in the common camera: the nearest cells, 0 where there is none."""
    if view is None or _sees_alike(own, common):
        return view
    size_px, own_size_px = common.width / COLUMNS, own.width / COLUMNS
    rows = int(np.ceil(common.height / size_px))
    v, u = np.mgrid[0:rows, 0:COLUMNS]
    px = (np.stack([u.ravel(), v.ravel()], axis=1) + 0.5) * size_px - 0.5
    column, row = np.floor((same_rays(px, common, own) + 0.5) / own_size_px).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < view.gray.shape[1]) & (row < view.gray.shape[0])
    at = np.where(inside, row, 0), np.where(inside, column, 0)
    planes = (np.where(inside, plane[at], np.float32(0)) for plane in (view.gray, view.z_m, view.low_m, view.high_m))
    return View(*(plane.reshape(rows, COLUMNS) for plane in planes))


def _sees_alike(own: Camera, common: Camera) -> bool:
    names = ("fx", "fy", "cx", "cy", "width", "height")
    return all(getattr(own, name) == getattr(common, name) for name in names)
