"""Recordings of one textured wall with exact poses, made in no time: colour by a homography, depth by geometry."""

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.artifact_store import content_fingerprint
from miniloop_cli.scene.image_source import ImageHeader
from miniloop_cli.scene.sequence import Frame, Sequence

CAMERA = Camera(130.0, 130.0, 79.5, 59.5, 160, 120)
TEXEL_PER_M, SIDE_M = 150.0, 6.0
RATE_HZ = 30.0


@dataclass(frozen=True)
class Picture:
    """An image in memory as a source of a recording; one without pixels cannot be read."""

    name: str
    pixels: np.ndarray | None = field(repr=False)

    def header(self):
        height, width = self.read().shape[:2]
        return ImageHeader(width, height, 8 * self.pixels.itemsize, self.pixels.ndim, "array")

    def read(self):
        if self.pixels is None:
            raise InputError("is cut off in the middle")
        return self.pixels

    def fingerprint(self):
        return "unreadable" if self.pixels is None else content_fingerprint([self.pixels])


def texture(seed=0, side=int(TEXEL_PER_M * SIDE_M)):
    """(side, side) uint8, of structure from some to many texels, all of it smooth."""
    rng, image = np.random.default_rng(seed), np.zeros((side, side), np.float32)
    for sigma in (2.3, 5, 12):
        wave = cv2.GaussianBlur(rng.standard_normal((side, side), np.float32), (0, 0), sigma)
        image += wave / wave.std()
    return np.clip(128 + 32 * image, 0, 255).astype(np.uint8)


def path(n, speed=1.0):
    """T_world_cam (n, 4, 4) before the wall z = 2 m: up to 1 cm and 0.8 deg a frame, in all six directions."""
    s = 2 * speed * np.arange(n) / RATE_HZ
    w = 0.15 * np.stack([np.sin(0.9 * s), np.sin(0.7 * s + 1), np.sin(1.3 * s)], axis=1)
    p = 0.1 * np.stack([np.sin(1.1 * s), np.sin(0.8 * s + 2), np.sin(0.6 * s)], axis=1)
    return se3.pose(se3.exp_so3(w), p)


def seen(T_world_cam, image, camera=CAMERA, wall_m=2.0):
    """Colour (h, w, 3) and depth (h, w) uint16 of the wall from a pose."""
    T_cam_world = se3.inverse(T_world_cam)
    half_m = SIDE_M / 2
    on_wall = np.array([[1 / TEXEL_PER_M, 0, -half_m], [0, 1 / TEXEL_PER_M, -half_m], [0, 0, 1]])  # texel to metres
    to_cam = np.stack([T_cam_world[:3, 0], T_cam_world[:3, 1], wall_m * T_cam_world[:3, 2] + T_cam_world[:3, 3]], 1)
    size = (camera.width, camera.height)
    gray = cv2.warpPerspective(image, camera.K @ to_cam @ on_wall, size, flags=cv2.INTER_LINEAR)
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    rays = camera.backproject(np.stack([u.ravel(), v.ravel()], 1), np.ones(u.size)) @ T_world_cam[:3, :3].T
    depth_m = (wall_m - T_world_cam[2, 3]) / rays[:, 2].reshape(u.shape)
    return np.repeat(gray[..., None], 3, axis=2), np.round(depth_m * camera.depth_scale).astype(np.uint16)


def wall_frames(T_world_cam, seed=0):
    """Frames of a recording along a path (n, 4, 4)."""
    image = texture(seed)
    return [frame(k, *seen(T, image)) for k, T in enumerate(T_world_cam)]


def spotted_frames(T_world_cam, spots_per_m2, seed=0, camera=CAMERA):
    """Frames, with noise, of a bare wall with so many dark or bright spots of 2 cm."""
    rng, side = np.random.default_rng(seed), int(TEXEL_PER_M * SIDE_M)
    image = np.full((side, side), 120, np.uint8)
    for x, y in rng.uniform(0, side, (int(spots_per_m2 * SIDE_M**2), 2)):
        gray = int(rng.choice([30, 220]))
        cv2.circle(image, (int(16 * x), int(16 * y)), 48, gray, -1, cv2.LINE_AA, 4)
    frames = []
    for k, T in enumerate(T_world_cam):
        color, depth = seen(T, image, camera)
        z_m = depth / camera.depth_scale
        z_m += camera.noise.sigma_m(z_m) * rng.standard_normal(z_m.shape)
        color = np.clip(color + 4 * rng.standard_normal(color.shape[:2])[..., None], 0, 255).astype(np.uint8)
        frames.append(frame(k, color, np.round(z_m * camera.depth_scale).astype(np.uint16)))
    return frames


def frame(k, color, depth):
    """Frame k, at its time; None for what cannot be read."""
    return Frame(1000 + k / RATE_HZ, Picture(f"{k}.color", color), Picture(f"{k}.depth", depth))


def renumbered(frames, rate_hz=RATE_HZ):
    """These frames one after the other."""
    return tuple(Frame(1000 + k / rate_hz, f.color, f.depth) for k, f in enumerate(frames))


def recording(frames, rate_hz=RATE_HZ, camera=CAMERA):
    """A recording of these frames."""
    return Sequence("wall", Path(), camera, renumbered(frames, rate_hz))
