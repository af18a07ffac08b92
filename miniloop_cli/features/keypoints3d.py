"""Features with depth: the 3D points of a scan's keypoints, in the camera's frame."""

from __future__ import annotations

import numpy as np

from miniloop_cli.config import Depth, Features
from miniloop_cli.feature_types import FEATURE_TYPES
from miniloop_cli.features.detect import detect
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.typing import Bools, Floats, Floats32


def scan_features(scan: Scan, camera: Camera, features: Features, depth: Depth) -> ScanFeatures:
    """Detect, undistort and look up depth in one scan."""
    import cv2

    gray = np.asarray(cv2.cvtColor(scan.color, cv2.COLOR_RGB2GRAY), np.uint8)
    hidden = 0.0 if scan.mask is None else scan.mask.mean()
    # More features, so that about `count` of them are outside of the mask.
    count, octave = int(np.ceil(features.count / max(1 - hidden, 0.1))), 0 if features.first_octave == 0 else -1
    found = detect(gray, features.type, count, features.contrast, octave)
    if scan.mask is not None:
        found = found.rows(np.flatnonzero(clear_of(scan.mask, found.px, found.radius_px))[: features.count])
    z_m = depth_at(scan.depth_m, found.px, depth)
    slope = depth_slope(scan.depth_m, found.px, z_m, depth)
    outline = on_outline(scan.depth_m, found.px, found.radius_px, z_m)
    blob = FEATURE_TYPES[features.type].blob
    middle = found.px + blob_shift(found.radius_px, z_m, slope) if blob else found.px
    order = np.argsort(np.isnan(z_m), kind="stable")
    px_ideal = camera.undistort(middle)
    return ScanFeatures(
        found.px[order], px_ideal[order], z_m[order], slope[order], outline[order], found.descriptors[order]
    )


def clear_of(mask: Bools, px: Floats, radius_px: Floats32) -> Bools:
    """Whether (n,) features at pixels (n, 2) are at least their radius (n,) away from a mask (h, w)."""
    import cv2

    away_px = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    x, y = np.clip(np.rint(px).astype(int), 0, np.array(mask.shape[::-1]) - 1).T
    return away_px[y, x] > radius_px


def depth_at(depth_m: Floats32, px: Floats, settings: Depth) -> Floats:
    """Bilinear depth (m) at (n, 2) measured pixels of a (h, w) depth image; NaN where it cannot be trusted.

    All four neighbours must have a reading and agree within `edge_ratio` (a depth edge mixes two surfaces), and the
    result must lie in [min_m, max_m].
    """
    height, width = depth_m.shape
    corner = np.floor(px).astype(int)
    inside = (corner >= 0).all(axis=1) & (corner[:, 0] < width - 1) & (corner[:, 1] < height - 1)
    x, y = np.where(inside[:, None], corner, 0).T
    fx, fy = (px - corner).T
    z = np.stack([depth_m[y, x], depth_m[y, x + 1], depth_m[y + 1, x], depth_m[y + 1, x + 1]], axis=1).astype(float)
    weight = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    z[~np.isfinite(z)] = 0
    near, far = z.min(axis=1), z.max(axis=1)
    smooth = (near > 0) & (far - near <= settings.edge_ratio * near)
    value = np.einsum("ij,ij->i", np.where(smooth[:, None], z, 0), weight)
    usable = inside & smooth & (value >= settings.min_m) & (value <= settings.max_m)
    return np.where(usable, value, np.nan)


SLOPE_STEP_PX = 5.0  # nearer readings differ by noise, farther ones by other surfaces


def depth_slope(depth_m: Floats32, px: Floats, z_m: Floats, settings: Depth) -> Floats:
    """Change of depth_m (h, w) along x and y (n, 2), m/px, at px (n, 2) of depth z_m (n,); 0 across edges and holes."""
    slope = np.zeros((len(px), 2))
    for axis in range(2):
        step = np.eye(2)[axis] * SLOPE_STEP_PX
        before, after = depth_at(depth_m, px - step, settings), depth_at(depth_m, px + step, settings)
        slope[:, axis] = smooth_slope(before, z_m, after)
    return slope


def smooth_slope(before_m: Floats, z_m: Floats, after_m: Floats) -> Floats:
    """Slope (n,) in m/px from depths (n,) at pixels, and `before_m` and `after_m` (n,) SLOPE_STEP_PX beside them.

    0 where depths bend or are NaN.
    """
    smooth = np.abs(before_m + after_m - 2 * z_m) < 0.01 + 0.03 * z_m
    return np.where(smooth, (after_m - before_m) / (2 * SLOPE_STEP_PX), 0.0)


# Variance of a blob over its radius squared: SIFT's radius is two sigma, and the variance is 2^(1/3) sigma^2, between
# those of the two Gaussians of a layer.
BLOB = 2 ** (1 / 3) / 4


def blob_shift(radius_px: Floats32, z_m: Floats, slope: Floats) -> Floats:
    """Offsets (n, 2) px from SIFT's keypoints, blobs of radius (n,) at depths z_m (n,) of slope (n, 2), to the middles.

    A round blob on a slanted surface is larger on the nearer side. The extremum of its Laplacian at its variance t is
    shifted by t slope / z from its middle to that side (docs/refinement.md). 0 where there is no depth.
    """
    return np.nan_to_num(BLOB * radius_px[:, None] ** 2 * slope / z_m[:, None])


OUTLINE_PX = 3.0  # depth is not as sharp as colour
JUMP = 0.05  # of the depth: more than noise, less than from furniture to the wall behind


def on_outline(depth_m: Floats32, px: Floats, radius_px: Floats32, z_m: Floats) -> Bools:
    """Whether depth jumps (n,) within the radius (n,) of features at pixels (n, 2) of depth z_m (n,).

    Such a feature is at the outline of an object, where its position on the surfaces changes with the viewpoint. False
    if the feature has no depth.
    """
    height, width = depth_m.shape
    found = np.zeros(len(px), bool)
    reach = np.maximum(radius_px, OUTLINE_PX)[:, None]
    for part in (0.5, 1.0):
        for angle in np.arange(8) * np.pi / 4:
            x, y = np.rint(px + part * reach * [np.cos(angle), np.sin(angle)]).astype(int).T
            inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
            z = depth_m[np.where(inside, y, 0), np.where(inside, x, 0)]
            found |= inside & (z > 0) & (np.abs(z - z_m) > JUMP * z_m)  # NaN compares false
    return found
