"""Motions by depth and brightness: known answers, open directions, what does not fit."""

import cv2
import numpy as np
import pytest

from miniloop_cli.config import Depth
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.partial_motion import openness
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.simulate import simulate
from miniloop_cli.tracking.surface import make_surface, surface_motion

CAMERA = Camera(260.0, 260.0, 159.5, 119.5, 320, 240)


def surface_of(depth_m, gray):
    color = np.repeat(gray[..., None], 3, axis=2)
    return make_surface(Scan(color, depth_m.astype(np.float32)), gray, CAMERA, Depth())


def wall(distance_m, rng, textured=False):
    """A wall across the view, with the noise of a sensor."""
    depth = distance_m + rng.normal(0, 0.004, (240, 320))
    v, u = np.mgrid[0:240, 0:320]
    pattern = 60 * np.sin(u / 9) * np.sin(v / 11) if textured else 0
    return surface_of(depth, np.clip(120 + pattern + rng.normal(0, 2, (240, 320)), 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def untextured():
    """Frames of a room that has shapes only, and their exact poses."""
    settings = SimulationSettings(
        frames=8, width=320, height=240, scene="textureless", path="random-walk", rate_hz=30, path_share=0.02
    )
    frames = list(simulate(settings, np.random.default_rng(3)))
    scans = [frame.scan(settings.camera) for frame in frames]
    grays = [cv2.cvtColor(scan.color, cv2.COLOR_RGB2GRAY) for scan in scans]
    surfaces = [make_surface(s, g, settings.camera, Depth()) for s, g in zip(scans, grays, strict=True)]
    return surfaces, np.array([frame.T_world_cam for frame in frames])


@pytest.mark.parametrize("gap", [1, 3, 5])
def test_shape_alone_tells_the_motion(untextured, gap):
    surfaces, T_world_cam = untextured
    for k in range(len(surfaces) - gap):
        found = surface_motion(surfaces[k], surfaces[k + gap], np.eye(4))
        off = se3.inverse(T_world_cam[k + gap]) @ T_world_cam[k] @ se3.inverse(found.T_cam_key)
        assert se3.rotation_angle_deg(off[:3, :3]) < 0.1
        assert np.linalg.norm(off[:3, 3]) < 0.003
        assert openness(found.information) < 1


def test_errors_are_within_what_the_information_promises(untextured):
    surfaces, T_world_cam = untextured
    chi2 = []
    for k in range(len(surfaces) - 1):
        found = surface_motion(surfaces[k], surfaces[k + 1], np.eye(4))
        off = se3.inverse(T_world_cam[k + 1]) @ T_world_cam[k] @ se3.inverse(found.T_cam_key)
        xi = np.concatenate([se3.log_so3(off[:3, :3]), off[:3, 3]])
        chi2.append(xi @ found.information @ xi)
    assert np.median(chi2) < 12  # twice the degrees of freedom


def test_a_blank_wall_leaves_directions_open(rng):
    found = surface_motion(wall(1.5, rng), wall(1.48, rng), np.eye(4))
    assert abs(found.T_cam_key[2, 3] + 0.02) < 0.001  # towards the wall it is known
    assert openness(found.information) == np.inf


def test_brightness_closes_what_a_wall_leaves_open(rng):
    found = surface_motion(wall(1.5, rng, textured=True), wall(1.5, rng, textured=True), np.eye(4))
    assert openness(found.information) < 1
    assert np.linalg.norm(found.T_cam_key[:3, 3]) < 0.003


def test_what_does_not_fit_has_no_motion(rng):
    far, steps = wall(4.0, rng), 1.0 + 0.5 * (np.mgrid[0:240, 0:320][1] // 40 % 2)
    assert surface_motion(wall(1.0, rng), far, np.eye(4)) is None
    assert surface_motion(surface_of(steps, np.full((240, 320), 90, np.uint8)), far, np.eye(4)) is None


def test_without_depth_there_is_no_motion(rng):
    nothing = surface_of(np.zeros((240, 320)), np.full((240, 320), 90, np.uint8))
    assert surface_motion(wall(1.5, rng), nothing, np.eye(4)) is None
    assert surface_motion(nothing, wall(1.5, rng), np.eye(4)) is None


def cluttered(rng):
    """Boards of 40 pixels before a wall: most of the grid lies at their edges, where there are no normals."""
    board = np.arange(320) // 40 % 2 == 0
    depth = np.where(board, 1.2, 1.6) + rng.normal(0, 0.003, (240, 320))
    v, u = np.mgrid[0:240, 0:320]
    gray = 120 + 60 * np.sin(u / 9) * np.sin(v / 11) + rng.normal(0, 2, (240, 320))
    return surface_of(depth, np.clip(gray, 0, 255).astype(np.uint8))


def test_clutter_is_judged_where_it_has_normals(rng):
    """On a desk, half of all cells have none; counted as misfits, they once tore nearly every motion by depth."""
    key, now = cluttered(rng), cluttered(rng)
    assert np.isfinite(key.normals[..., 0]).mean() < 0.5
    found = surface_motion(key, now, np.eye(4))
    assert np.abs(found.T_cam_key - np.eye(4)).max() < 0.002


def test_a_motion_under_which_a_fifth_does_not_fit_is_none(rng):
    """On real frames, motions by which less than nine tenths fit were degrees off."""
    key = wall(1.5, rng, textured=True)
    depth = 1.5 + rng.normal(0, 0.004, (240, 320))
    depth[:, :100] += 0.06  # a part that has moved since
    v, u = np.mgrid[0:240, 0:320]
    gray = np.clip(120 + 60 * np.sin(u / 9) * np.sin(v / 11), 0, 255).astype(np.uint8)
    assert surface_motion(key, surface_of(depth, gray), np.eye(4)) is None
