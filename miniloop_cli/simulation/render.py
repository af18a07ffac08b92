"""Ray casting of textured boxes and spheres: colour, depth along the optical axis, incidence, and what was hit."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats, Floats32

NOTHING = -1
MIN_HIT_M = 1e-3
BLANK_GREY = 165.0
BUNDLE_PX = 16  # neighbours in a row that share the search for boxes


@njit(cache=True, nogil=True)
def _hit_box(o: Floats, d: Floats, half: Floats, within: bool) -> tuple[float, int, int]:
    """Distance, axis and side (0 low, 1 high) at which o + t d, in the frame of the box, meets it; 1e30 if never."""
    near, far = -1e30, 1e30
    near_axis, far_axis, near_side, far_side = 0, 0, 0, 0
    for axis in range(3):
        step = d[axis] if abs(d[axis]) > 1e-12 else 1e-12
        a, b = (-half[axis] - o[axis]) / step, (half[axis] - o[axis]) / step
        side = 0
        if a > b:
            a, b = b, a
            side = 1
        if a > near:
            near, near_axis, near_side = a, axis, side
        if b < far:
            far, far_axis, far_side = b, axis, 1 - side
    if near > far:
        return 1e30, 0, 0
    if within:
        return (far if far > MIN_HIT_M else 1e30), far_axis, far_side
    return (near if near > MIN_HIT_M else 1e30), near_axis, near_side


@njit(cache=True, nogil=True)
def _add_texel(atlas: NDArray, level: NDArray, scale: float, x: float, y: float, weight: float, rgb: Floats) -> None:
    """Add the bilinear colour at (x, y), pixels of the finest level, of one level (offset, width, height) to rgb."""
    offset, width, height = level
    x = max(min((x + 0.5) * scale - 0.5, width - 1.001), 0.0)
    y = max(min((y + 0.5) * scale - 0.5, height - 1.001), 0.0)
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    right = 3 if column + 1 < width else 0
    below = 3 * width if row + 1 < height else 0
    at = offset + 3 * (row * width + column)
    for c in range(3):
        top = (1 - fx) * atlas[at + c] + fx * atlas[at + right + c]
        bottom = (1 - fx) * atlas[at + below + c] + fx * atlas[at + below + right + c]
        rgb[c] += weight * ((1 - fy) * top + fy * bottom)


@njit(cache=True, nogil=True)
def _cones(o: Floats, radius: Floats, within: NDArray, cones: Floats) -> None:
    """Values of each box for `_nearby`, in rows of `cones` (boxes, 6): the direction of its centre, cosine and sine of
    the angle of the ball around it, and its least distance (m), 0 for boxes around the camera.

    o (boxes, 3): from the camera to the centres, in the camera's axes; radius (boxes,): of the balls (m).
    """
    for k in range(len(o)):
        away = math.sqrt(o[k, 0] ** 2 + o[k, 1] ** 2 + o[k, 2] ** 2)
        cones[k, 5] = 0.0
        if not within[k] and away > radius[k]:
            for c in range(3):
                cones[k, c] = o[k, c] / away
            cones[k, 4] = radius[k] / away
            cones[k, 3] = math.sqrt(1 - cones[k, 4] ** 2)
            cones[k, 5] = away - radius[k]


@njit(cache=True, nogil=True)
def _nearby(rays: Floats, cones: Floats, near: Floats, number: NDArray) -> int:
    """The boxes that a bundle of (k, 3) camera rays may meet, the nearest first, with the least distance of each (m);
    returns their number.
    """
    first, last, middle = rays[0], rays[-1], rays[len(rays) // 2]
    length = math.sqrt(middle[0] ** 2 + middle[1] ** 2 + middle[2] ** 2)
    spread = 0.0
    for end in (first, last):
        across = math.sqrt(end[0] ** 2 + end[1] ** 2 + end[2] ** 2) * length
        cosine = (end[0] * middle[0] + end[1] * middle[1] + end[2] * middle[2]) / across
        spread = max(spread, math.acos(min(max(cosine, -1.0), 1.0)))
    spread += 1e-3  # the bundle may be curved
    wide, narrow = math.cos(spread) * length, math.sin(spread) * length
    count = 0
    for k in range(len(cones)):
        least = cones[k, 5]
        if least > 0:
            cosine = cones[k, 0] * middle[0] + cones[k, 1] * middle[1] + cones[k, 2] * middle[2]
            if cosine < cones[k, 3] * wide - cones[k, 4] * narrow:  # of the sum of both angles
                continue
        place = count
        while place > 0 and near[place - 1] > least:
            near[place], number[place] = near[place - 1], number[place - 1]
            place -= 1
        near[place], number[place] = least, k
        count += 1
    return count


@njit(cache=True, nogil=True, fastmath=True)
def render_rows(
    rows: tuple[int, int],
    rays: Floats,
    T_world_row: Floats,
    pixel_rad: float,
    scene: tuple,
    color: Floats32,
    depth: Floats32,
    cosine: Floats32,
    hit: NDArray[np.int16],
) -> None:
    """Fill rows [first, last) of the images from (h, w, 3) camera rays with z = 1 and one camera pose a row (h, 4, 4).

    `scene` is `Scene.arrays()`. color (h, w, 3): 0 to 255; depth (h, w): metres along the optical axis; cosine (h, w):
    of the angle between ray and surface normal; hit (h, w): number of the box, boxes + number of the sphere, NOTHING.
    """
    T_box_world, half, within, box_texture, sphere, sphere_texture, table, texel_per_m, atlas, light, blank = scene
    boxes, levels = len(half), table.shape[1]
    T, o, cones = np.empty((boxes, 3, 4)), np.empty((boxes, 3)), np.empty((boxes, 6))
    near, nearby, radius = np.empty(boxes), np.empty(boxes, np.int64), np.empty(boxes)
    for k in range(boxes):
        radius[k] = math.sqrt(half[k, 0] ** 2 + half[k, 1] ** 2 + half[k, 2] ** 2) + 1e-6
    candidates = 0
    d, n, p, rgb = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for v in range(rows[0], rows[1]):
        W = T_world_row[v]
        for k in range(boxes):
            for r in range(3):
                for c in range(4):
                    total = T_box_world[k, r, 3] if c == 3 else 0.0
                    for i in range(3):
                        total += T_box_world[k, r, i] * W[i, c]
                    T[k, r, c] = total
            for c in range(3):
                o[k, c] = -(T[k, 0, c] * T[k, 0, 3] + T[k, 1, c] * T[k, 1, 3] + T[k, 2, c] * T[k, 2, 3])
        _cones(o, radius, within, cones)
        for u in range(rays.shape[1]):
            if u % BUNDLE_PX == 0:
                candidates = _nearby(rays[v, u : u + BUNDLE_PX], cones, near, nearby)
            ray = rays[v, u]
            length = math.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
            best, what, best_axis, best_side = 1e30, NOTHING, 0, 0
            for candidate in range(candidates):
                k = nearby[candidate]
                if near[candidate] > best * length:
                    break
                for r in range(3):
                    d[r] = T[k, r, 0] * ray[0] + T[k, r, 1] * ray[1] + T[k, r, 2] * ray[2]
                t, axis, side = _hit_box(T[k, :, 3], d, half[k], within[k])
                if t < best:
                    best, what, best_axis, best_side = t, k, axis, side
            for r in range(3):
                d[r] = W[r, 0] * ray[0] + W[r, 1] * ray[1] + W[r, 2] * ray[2]
            for k in range(len(sphere)):
                b, c = 0.0, -(sphere[k, 3] ** 2)
                for r in range(3):
                    e = W[r, 3] - sphere[k, r]
                    b += e * d[r]
                    c += e * e
                root = b * b - length * length * c
                if root > 0:
                    t = (-b - math.sqrt(root)) / (length * length)
                    if MIN_HIT_M < t < best:
                        best, what = t, boxes + k
            hit[v, u] = what
            depth[v, u] = 0.0
            cosine[v, u] = 0.0
            color[v, u] = 0.0
            if what == NOTHING:
                continue
            if what < boxes:
                for r in range(3):
                    p[r] = T[what, r, 3] + best * (
                        T[what, r, 0] * ray[0] + T[what, r, 1] * ray[1] + T[what, r, 2] * ray[2]
                    )
                    n[r] = T_box_world[what, best_axis, r] * (1.0 if best_side else -1.0)
                if within[what]:
                    n *= -1.0
                h = half[what]
                seen = 1.0 if (best_side == 1) != within[what] else -1.0  # text reads from left to right
                if best_axis == 0:
                    x, y = h[1] + seen * p[1], h[2] - p[2]
                elif best_axis == 1:
                    x, y = h[0] - seen * p[0], h[2] - p[2]
                else:
                    x, y = h[0] + p[0], h[1] - seen * p[1]
                number = box_texture[what, 2 * best_axis + best_side]
            else:
                k = what - boxes
                for r in range(3):
                    n[r] = (W[r, 3] + best * d[r] - sphere[k, r]) / sphere[k, 3]
                number = sphere_texture[k]
                x = (math.atan2(n[1], n[0]) + math.pi) * sphere[k, 3]
                y = math.acos(max(min(n[2], 1.0), -1.0)) * sphere[k, 3]
            facing = abs(n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / length
            depth[v, u] = best
            cosine[v, u] = facing
            density = texel_per_m[number]
            footprint = density * pixel_rad * best * length / math.sqrt(max(facing, 0.05))
            level = min(max(math.log2(max(footprint, 1e-6)), 0.0), levels - 1.001)
            low = int(level)
            rgb[:] = 0.0
            _add_texel(atlas, table[number, low], 1.0 / (1 << low), x * density, y * density, 1 - (level - low), rgb)
            _add_texel(atlas, table[number, low + 1], 0.5 / (1 << low), x * density, y * density, level - low, rgb)
            for k in range(len(blank)):
                x, y = W[0, 3] + best * d[0], W[1, 3] + best * d[1]
                if blank[k, 0] < x < blank[k, 2] and blank[k, 1] < y < blank[k, 3]:
                    rgb[:] = BLANK_GREY
            shade = 0.78 + 0.22 * (n[0] * light[0] + n[1] * light[1] + n[2] * light[2])
            for c in range(3):
                color[v, u, c] = shade * rgb[c]


def render(
    rays: Floats, T_world_row: Floats, pixel_rad: float, scene: tuple
) -> tuple[Floats32, Floats32, Floats32, NDArray[np.int16]]:
    """Render an image of rays (h, w, 3) at T_world_row (h, 4, 4), in two threads; see `render_rows`."""
    from concurrent.futures import ThreadPoolExecutor

    h, w = rays.shape[:2]
    images = (
        np.empty((h, w, 3), np.float32),
        np.empty((h, w), np.float32),
        np.empty((h, w), np.float32),
        np.empty((h, w), np.int16),
    )
    bands = [(first, min(first + 32, h)) for first in range(0, h, 32)]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda rows: render_rows(rows, rays, T_world_row, pixel_rad, scene, *images), bands))
    return images
