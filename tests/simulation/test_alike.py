"""Places that look the same twice, turntables and cuts: exact truth, and what their names say."""

import numpy as np
import pytest

from miniloop_cli.cli import simulate as command
from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry import se3
from miniloop_cli.simulation import simulate
from miniloop_cli.simulation.settings import ALIKE, SCENES, SimulationSettings
from miniloop_cli.simulation.simulate import true_trajectory

SMALL = {"width": 80, "height": 60, "noise": False}


def frames_of(seed=0, **changes):
    return list(simulate(SimulationSettings(**(SMALL | changes)), np.random.default_rng(seed)))


def steps_deg(T):
    return se3.rotation_angle_deg((se3.inverse(T[:-1]) @ T[1:])[:, :3, :3])


@pytest.mark.slow
def test_a_turntable_turns_before_a_room_at_rest():
    frames = frames_of(scene="turntable", frames=10)
    wall = np.stack([frame.color[:10, 20:60] for frame in frames]).astype(
        float
    )  # behind; the light turns with the board
    alike = [np.corrcoef(each.ravel(), wall[0].ravel())[0, 1] for each in wall]
    middle = np.stack([frame.color[25:50, 20:60] for frame in frames]).astype(float)
    turned = [np.corrcoef(each.ravel(), middle[0].ravel())[0, 1] for each in middle[1:-1]]
    assert min(alike) > 0.95 and max(turned) < 0.8
    T = np.array([frame.T_world_cam for frame in frames])
    np.testing.assert_allclose(steps_deg(T), 36 * 1.06, rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["turntable", "room"])
def test_half_turned_places_look_the_same(scene):
    """Seen from a camera and from the half-turned one: the depth is equal, the light but for the shading."""
    from miniloop_cli.simulation.building import build_scene
    from miniloop_cli.simulation.path import make_path
    from miniloop_cli.simulation.render import render
    from miniloop_cli.simulation.simulate import camera_rays
    from miniloop_cli.simulation.symmetry import HALF_TURN

    camera = SimulationSettings(**SMALL).camera
    T = make_path("loop", scene, 10.0, np.random.default_rng(3))(np.array([2.0]))
    for alike, equal in (("half-turn", True), ("nothing", False)):
        arrays = build_scene(scene, np.random.default_rng(1), alike=alike).arrays()
        views = [
            render(camera_rays(camera), np.repeat(pose, camera.height, axis=0), 1 / camera.fx, arrays)
            for pose in (T, HALF_TURN @ T)
        ]
        (light, depth, *_), (light_turned, depth_turned, *_) = views
        texture = np.corrcoef(light.ravel(), light_turned.ravel())[0, 1]
        assert (texture > 0.7) == equal
        if equal:
            assert np.mean(np.abs(depth - depth_turned) < 1e-3) > 0.99


@pytest.mark.slow
def test_rooms_may_look_alike():
    from miniloop_cli.simulation.building import build_scene

    same = build_scene("room", np.random.default_rng(1), rooms=2, alike="rooms")
    furniture = [
        np.linalg.inv(T)[:3, 3] for T, half in zip(same.T_box_world, same.half_m, strict=True) if half[2] < 0.6
    ]
    x = np.array(furniture)
    left, right = x[x[:, 1] < 1.9], x[x[:, 1] > 1.9]
    low = [part[(part[:, 2] > 0.1) & (part[:, 2] < 1.2)] for part in (left, right)]
    assert len(low[0]) == len(low[1]) >= 3
    np.testing.assert_allclose(low[1] - low[0], np.tile(low[1][0] - low[0][0], (len(low[0]), 1)), atol=1e-9)


@pytest.mark.slow
def test_rooms_of_other_seeds_may_have_the_same_furniture():
    from miniloop_cli.simulation.building import build_scene

    one, other = (build_scene("room", np.random.default_rng(seed), alike="furniture") for seed in (1, 2))
    np.testing.assert_array_equal(one.T_box_world, other.T_box_world)
    same = [np.array_equal(a[0], b[0]) for a, b in zip(one.pyramids, other.pyramids, strict=True)]
    assert len(one.T_box_world) > 10
    assert not any(same[:6]) and all(same[6:])  # six sides of the room, then all that stands in it


def test_the_command_offers_what_there_is():
    assert command.ALIKE == ALIKE and command.SCENES == SCENES


def test_cuts_leave_parts_of_the_path_out_and_the_truth_knows():
    settings = SimulationSettings(frames=30, cuts=2)
    truth = true_trajectory(settings, np.random.default_rng(0))
    at_frames = np.isin(truth.timestamps_s, np.round(1000 + np.arange(30) / 10, 6))
    turned = steps_deg(truth.T_world_cam[at_frames])
    assert turned[[9, 19]].min() > 3 * np.delete(turned, [9, 19]).max()


@pytest.mark.parametrize(
    "wrong",
    [
        {"alike": "half-turn", "rooms": 2},
        {"alike": "half-turn", "scene": "plane"},
        {"alike": "rooms"},
        {"alike": "furniture", "scene": "turntable"},
        {"alike": "furniture", "rooms": 2},
        {"alike": "everything"},
        {"scene": "turntable", "path": "xyz"},
        {"scene": "turntable", "rooms": 2},
        {"cuts": -1},
    ],
)
def test_what_does_not_go_together_is_refused(wrong):
    with pytest.raises(ConfigError):
        SimulationSettings(**wrong)
