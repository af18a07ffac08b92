"""Motions by depth where brightness misleads: light that changes at once, what stands still on the sensor, cuts."""

from dataclasses import replace

import numpy as np
import pytest

from miniloop_cli.config import Depth, Tracking
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.tracked import TrackStatus
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.simulate import simulate
from miniloop_cli.tracking.depth_alone import seen_motion
from miniloop_cli.tracking.front_end import track_part
from miniloop_cli.tracking.surface import make_surface, surface_motion
from tests.tracking.walls import frame, path, recording, seen

WALL_CAMERA = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)


SETTINGS = SimulationSettings(frames=8, width=320, height=240, path="random-walk", rate_hz=30, path_share=0.02)


def surface_of(scan, gray):
    return make_surface(scan, np.asarray(gray, np.uint8), SETTINGS.camera, Depth())


@pytest.fixture(scope="module")
def room():
    """Scans of a simulated room, their surfaces and their exact poses."""
    return shown(seed=3)


def shown(seed):
    frames = list(simulate(SETTINGS, np.random.default_rng(seed)))
    scans = [one.scan(SETTINGS.camera) for one in frames]
    surfaces = [surface_of(scan, scan.color.mean(axis=2)) for scan in scans]
    return scans, surfaces, np.array([one.T_world_cam for one in frames])


def test_a_light_that_goes_out_does_not_hide_the_motion(room):
    scans, surfaces, T_world_cam = room
    other = np.kron(np.random.default_rng(0).integers(0, 255, (24, 32)), np.ones((10, 10)))
    for k in range(7):
        dark = surface_of(scans[k + 1], other)
        assert surface_motion(surfaces[k], dark, np.eye(4)) is None
        found = seen_motion(surfaces[k], dark, np.eye(4), still=False).motion
        off = se3.inverse(T_world_cam[k + 1]) @ T_world_cam[k] @ se3.inverse(found.T_cam_key)
        assert se3.rotation_angle_deg(off[:3, :3]) < 0.2
        assert np.linalg.norm(off[:3, 3]) < 0.006


def test_a_cut_to_another_place_is_no_motion(room):
    surfaces, elsewhere = room[1], shown(seed=8)[1]
    for k in range(8):
        assert seen_motion(surfaces[k], elsewhere[k], np.eye(4), still=False).motion is None


@pytest.mark.parametrize("dots", [8, 100])
def test_what_stands_still_on_the_sensor_is_not_the_scene(dots):
    """Dirt or a text in the image, before a bare wall: the camera moves, which depth shows, and nothing tells where."""
    import cv2

    rng, T_world_cam, frames = np.random.default_rng(7), path(14), []
    places = rng.uniform((20, 20), (620, 460), (dots, 2))
    colours = rng.choice([30, 220], dots)
    for k, T in enumerate(T_world_cam):
        image, depth = seen(T, np.full((900, 900), 120, np.uint8), WALL_CAMERA)
        z_m = depth / 5000 * (1 + 0.003 * rng.standard_normal(depth.shape))
        for place, colour in zip(places, colours.tolist(), strict=True):
            cv2.circle(image, (place * 16).astype(int).tolist(), 48, (colour,) * 3, -1, cv2.LINE_AA, 4)
        noisy = np.clip(image + 1.5 * rng.standard_normal((*image.shape[:2], 1)), 0, 255).astype(np.uint8)
        frames.append(frame(k, noisy, np.round(z_m * 5000).astype(np.uint16)))
    part = track_part(replace(recording(frames), camera=WALL_CAMERA), Depth(), Tracking(), 0, len(frames) - 1)
    linked = np.flatnonzero((part.key >= 0) & part.determined)
    for k in linked:  # a frame may be linked where the camera really stood still
        off = se3.inverse(T_world_cam[k]) @ T_world_cam[part.key[k]] @ se3.inverse(part.T_cam_key[k])
        assert np.linalg.norm(off[:3, 3]) < 0.02
    assert (part.status != TrackStatus.FOLLOWED).sum() > 7
