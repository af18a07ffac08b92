"""Several rooms: each is entered, the walk is smooth and hits nothing, rays through doors meet what algebra says."""

from itertools import pairwise

import numpy as np
import pytest

from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry import se3
from miniloop_cli.simulation import tour
from miniloop_cli.simulation.building import build_scene
from miniloop_cli.simulation.layout import ROOM_M, SIDES, Layout
from miniloop_cli.simulation.render import render
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.simulate import camera_rays, true_trajectory

ROOMS = (2, 3, 4, 5, 8)


@pytest.mark.parametrize("rooms", ROOMS)
def test_the_walk_enters_every_room_through_doors_and_comes_back(rooms):
    layout = Layout(rooms)
    walk = layout.walk
    assert walk[0] == walk[-1] == 0 and set(walk) == set(range(rooms))
    for a, b in pairwise(walk):
        step = np.subtract(layout.cell(b), layout.cell(a))
        assert tuple(step) in SIDES and layout.has_door(a, tuple(step)) and layout.has_door(b, tuple(-step))
    doors = sum(layout.has_door(room, side) for room in range(rooms) for side in SIDES)
    assert doors == 2 * (rooms if rooms % 2 == 0 and rooms > 2 else rooms - 1 if rooms < 4 else rooms)


@pytest.mark.parametrize("rooms", ROOMS)
def test_at_a_persons_pace_the_camera_moves_like_a_hand_and_touches_nothing(rooms):
    layout = Layout(rooms)
    frames = round(30 * tour.duration_s(layout))
    settings = SimulationSettings(frames=frames, rate_hz=30.0, rooms=rooms)
    T = true_trajectory(settings, np.random.default_rng(rooms)).T_world_cam[::3]  # about 30 Hz
    travelled = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    turned = se3.rotation_angle_deg(np.swapaxes(T[:-1, :3, :3], 1, 2) @ T[1:, :3, :3])
    assert travelled.mean() > 0.005 and travelled.max() < 0.06
    assert turned.mean() > 0.3 and turned.max() < 3
    scene = build_scene("textureless", np.random.default_rng(rooms).spawn(3)[0], rooms)
    for T_box_world, half in zip(scene.T_box_world, scene.half_m, strict=True):
        outside = np.abs(se3.transform(T_box_world, T[:, :3, 3])) - half
        assert np.linalg.norm(outside.clip(0, None), axis=1).min() > 0.15
    for room in range(rooms):
        inside = (np.abs(T[:, :2, 3] - layout.centre_m(room)[:2]) < ROOM_M[:2] / 2).all(1)
        yaw = np.unwrap(np.arctan2(T[inside, 1, 2], T[inside, 0, 2]))
        assert np.ptp(yaw) > 1.4 * np.pi, room
    first, last = T[0], T[-1]
    assert np.linalg.norm(first[:3, 3] - last[:3, 3]) < 1.5


@pytest.mark.slow
def test_rays_in_rooms_meet_the_box_that_is_nearest_of_all():
    settings = SimulationSettings(frames=60, width=64, height=48, rate_hz=1.0, rooms=5, rolling_shutter_s=0.0)
    scene, rays = build_scene("textureless", np.random.default_rng(1), 5), camera_rays(settings.camera)
    truth = true_trajectory(settings, np.random.default_rng(1))
    for T in truth.T_world_cam[::811]:
        _, depth, _, hit = render(rays, np.broadcast_to(T, (48, 4, 4)).copy(), 0.01, scene.arrays())
        d, o = rays @ T[:3, :3].T, T[:3, 3]
        nearest = np.full(depth.shape, np.inf)
        for T_box_world, half in zip(scene.T_box_world, scene.half_m, strict=True):
            R, p = T_box_world[:3, :3], se3.transform(T_box_world, o[None])[0]
            with np.errstate(divide="ignore"):
                a, b = ((sign * half - p) / (d @ R.T) for sign in (-1, 1))
            enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
            nearest = np.where((enter < leave) & (enter > 0), np.minimum(nearest, enter), nearest)
        for x, y, z, radius in scene.sphere:
            to = o - [x, y, z]
            A, B, C = (d * d).sum(-1), d @ to, to @ to - radius**2
            with np.errstate(invalid="ignore"):
                t = (-B - np.sqrt(B * B - A * C)) / A
            nearest = np.where(t > 0, np.fmin(nearest, t), nearest)
        assert np.isfinite(nearest).all() and (hit >= 0).all()  # a building is closed
        np.testing.assert_allclose(depth, nearest, rtol=1e-5)


def test_rooms_need_a_walk_and_walls():
    for wrong in ({"path": "xyz"}, {"scene": "plane"}, {"scene": "two-rooms"}):
        with pytest.raises(ConfigError, match="several rooms need path 'loop'"):
            SimulationSettings(rooms=2, **wrong)
    with pytest.raises(ConfigError, match="rooms must be from 1 to 100, not 0"):
        SimulationSettings(rooms=0)
