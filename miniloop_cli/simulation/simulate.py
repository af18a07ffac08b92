"""Simulated frames one after the other, with their exact poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera, DepthNoise
from miniloop_cli.scene.sequence import DepthCamera, Scan, Trajectory
from miniloop_cli.simulation import sensor
from miniloop_cli.simulation.building import ROOM, T_WORLD_ROOM, build_scene
from miniloop_cli.simulation.furniture import add_figure
from miniloop_cli.simulation.layout import Layout
from miniloop_cli.simulation.path import Path, make_path, with_cuts
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.stretches import Tick, shaken, ticks
from miniloop_cli.simulation.tour import tour
from miniloop_cli.typing import Bools, Bytes, Floats, Floats32

START_S = 1000.0  # stamps begin here
BLUR_SAMPLES, SHAKEN_SAMPLES = 6, 16  # of the exposure; more while the hand shakes
BLANK_SHARE = 0.9  # of the view without texture, in a stretch "blank"
TRUTH_RATE_HZ = 100.0
GRAVITY_M_S2 = 9.81
ACCELEROMETER_NOISE_M_S2, ACCELEROMETER_BIAS_M_S2 = 0.2, 0.1  # of each axis; a degree is 0.17 m/s^2
ACCELEROMETER_RANGE_M_S2 = 2 * GRAVITY_M_S2  # as a Kinect's


@dataclass(frozen=True)
class SimulatedFrame:
    """A frame as in a recording, with its exact pose."""

    timestamp_s: float
    T_world_cam: Floats  # of the middle row, when the image was taken
    color: Bytes
    depth: NDArray[np.uint16]  # units of 1 / depth_scale m
    moving: Bools | None  # pixels of the moving object
    taken_s: float  # time of the image, which differs from its stamp in stretches "doubled", "frozen" and "swapped"
    stretches: tuple[str, ...] = ()  # the hard stretches that it belongs to

    def scan(self, camera: Camera) -> Scan:
        """The result of `read_scan` for this frame with registered depth, without its mask."""
        return Scan(self.color, self.depth.astype(np.float32) / np.float32(camera.depth_scale))


def simulate(settings: SimulationSettings, rng: Generator) -> Iterator[SimulatedFrame]:
    """The frames of a recording. The scene and the path depend on the seed, not on the sensor's settings."""
    scene_rng, path_rng, noise_rng = rng.spawn(3)
    scene = build_scene(settings.scene, scene_rng, settings.rooms, "blank" in settings.hard, settings.alike)
    path = _path(settings, path_rng)
    figure = add_figure(scene, np.random.default_rng(7)) if settings.moving_object else None
    arrays, rays, t = scene.arrays(), camera_rays(settings.camera), frame_times_s(settings)
    del scene  # the arrays hold all of it
    last: tuple[Tick, SimulatedFrame] | None = None
    for tick in ticks(settings):
        if last is None or last[0].source != tick.source:
            noise = _spawned(noise_rng, tick.source)
            last = tick, _frame(settings, arrays, path, rays, figure, t[tick.source], tick, noise)
        stretches = tick.stretches + tuple(name for name in last[1].stretches if name == "blank")
        yield replace(last[1], timestamp_s=round(START_S + t[tick.number], 6), stretches=stretches)


def _spawned(rng: Generator, number: int) -> Generator:
    """The generator with this number in a first call of `rng.spawn`."""
    seed = rng.bit_generator.seed_seq
    assert isinstance(seed, np.random.SeedSequence)
    child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, number), pool_size=seed.pool_size)
    return Generator(type(rng.bit_generator)(child))


def true_trajectory(settings: SimulationSettings, rng: Generator) -> Trajectory:
    """Exact poses at the stamps of the frames and at 100 Hz between them, as motion capture would give.

    `rng` must be in the state that `simulate` was given.
    """
    path = _path(settings, rng.spawn(3)[1])
    frames = frame_times_s(settings)
    t = np.union1d(frames, np.round(np.arange(0, frames[-1], 1 / TRUTH_RATE_HZ), 6))
    return Trajectory(np.round(START_S + t, 6), path(t))


def accelerations(settings: SimulationSettings, rng: Generator) -> tuple[Floats, Floats]:
    """Stamps (n,) seconds and accelerometer readings (n, 3) m/s^2 in the camera's axes, upwards at rest.

    `rng` must be in the state that `simulate` was given.
    """
    _, path_rng, _, own = rng.spawn(4)
    path, step = _path(settings, path_rng), 1 / TRUTH_RATE_HZ
    t = np.asarray(np.round(np.arange(0, frame_times_s(settings)[-1] + step, step), 6), float)
    T = path(t)
    velocity_change = path(t + step)[:, :3, 3] - 2 * T[:, :3, 3] + path(t - step)[:, :3, 3]
    force_world = velocity_change / step**2 + [0, 0, GRAVITY_M_S2]
    force_cam = np.einsum("nji,nj->ni", T[:, :3, :3], force_world)
    force_cam += own.normal(0, ACCELEROMETER_BIAS_M_S2, 3) + own.normal(0, ACCELEROMETER_NOISE_M_S2, force_cam.shape)
    return np.round(START_S + t, 6), force_cam.clip(-ACCELEROMETER_RANGE_M_S2, ACCELEROMETER_RANGE_M_S2)


def frame_times_s(settings: SimulationSettings) -> Floats:
    """(frames,) times from the start, whole microseconds."""
    return np.round(np.arange(settings.frames) / settings.rate_hz, 6)


def _path(settings: SimulationSettings, rng: Generator) -> Path:
    duration_s = settings.frames / settings.rate_hz
    if settings.rooms > 1:
        path = tour(Layout(settings.rooms), duration_s / settings.path_share, rng)
    else:
        path = make_path(settings.path, settings.scene, duration_s, rng, settings.path_share)
    path = with_cuts(path, settings.cuts, duration_s) if settings.cuts else path
    return shaken(path, settings)


def camera_rays(camera: Camera) -> Floats:
    """(h, w, 3) directions with z = 1 of all pixels, through the distortion of the lens."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    px = camera.undistort(np.stack([u.ravel(), v.ravel()], 1))
    return camera.backproject(px, np.ones(len(px))).reshape(camera.height, camera.width, 3)


def _frame(
    settings: SimulationSettings,
    scene: tuple[NDArray, ...],
    path: Path,
    rays: Floats,
    figure: int | None,
    t: float,
    tick: Tick,
    rng: Generator,
) -> SimulatedFrame:
    from miniloop_cli.simulation.render import render

    camera = settings.camera
    row_s = settings.rolling_shutter_s * (np.arange(camera.height) / camera.height - 0.5)
    T_world_cam = path(np.array([t]))[0]

    def image(time_s: float, rays: Floats = rays, own: DepthCamera | None = None) -> tuple[NDArray, ...]:
        if figure is not None:
            scene[0][figure] = _figure_pose(path(np.array([time_s]))[0], time_s)
        if settings.scene == "turntable":  # the room moves with the camera
            before, now = path(np.array([0.0, time_s]))
            scene[0][ROOM] = se3.inverse(now @ se3.inverse(before) @ T_WORLD_ROOM)
        if own:
            return render(rays, path(time_s + row_s) @ own.T_color_depth, 1 / own.camera.fx, scene)
        return render(rays, path(time_s + row_s), 1 / camera.fx, scene)

    light, depth_m, cosine, hit = image(t)
    stretches = ("blank",) if _share_blank(scene[-1], rays, T_world_cam, depth_m) > BLANK_SHARE else ()
    if own := settings.depth_camera:
        _, depth_m, cosine, _ = image(t, camera_rays(own.camera), own)
    if tick.blur_s > 0:
        samples = SHAKEN_SAMPLES if tick.blur_s > settings.blur_s else BLUR_SAMPLES
        exposure = tick.blur_s * (np.arange(samples) / (samples - 1) - 0.5)
        light = np.mean([image(t + s)[0] for s in exposure], axis=0)
    if tick.covered:
        light, depth_m, stretches = 0 * light, 0 * depth_m, ()
    if settings.noise:
        noise = DepthNoise(settings.noise_level * camera.noise.a_m, settings.noise_level * camera.noise.b_per_m)
        depth_m = sensor.measure_depth(depth_m, cosine, noise, rng)
    depth = sensor.store_depth(depth_m, camera.depth_scale, settings.depth_limit_m)
    grain = settings.noise_level * tick.noise
    color = sensor.store_color(light, settings.exposure * tick.gain, rng if settings.noise else None, grain)
    moving = hit == figure if figure is not None else None
    stamp_s = round(START_S + t, 6)
    return SimulatedFrame(stamp_s, T_world_cam, color, depth, moving, stamp_s, stretches)


def _share_blank(blank_m: Floats, rays: Floats, T_world_cam: Floats, depth_m: Floats32) -> float:
    """Share of the view, sampled at every eighth pixel, without texture."""
    if not len(blank_m):
        return 0.0
    z = depth_m[::8, ::8, None].astype(float)
    x, y = np.moveaxis(se3.transform(T_world_cam, (z * rays[::8, ::8]).reshape(-1, 3))[:, :2], 1, 0)
    inside = [(x > low_x) & (x < high_x) & (y > low_y) & (y < high_y) for low_x, low_y, high_x, high_y in blank_m]
    return float(np.any(inside, axis=0).mean())


def _figure_pose(T_world_cam: Floats, t: float) -> Floats:
    """T_box_world of the figure: upright, 1.2 m in front of the camera, swinging sideways."""
    forward, right = T_world_cam[:3, 2], T_world_cam[:3, 0]
    heading = np.arctan2(forward[1], forward[0])
    centre = T_world_cam[:3, 3] + 1.2 * np.array([np.cos(heading), np.sin(heading), 0]) + 0.3 * np.sin(2.1 * t) * right
    centre[2] = 0.9
    return se3.inverse(se3.pose(se3.exp_so3(np.array([0, 0, heading + 1.2 * np.sin(1.3 * t)])), centre))
