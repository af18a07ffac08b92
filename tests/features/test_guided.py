"""Guided matching with a known pose, on points that are seen in two scans."""

import numpy as np

from miniloop_cli.features.guided import agreed, guided_match, searchable
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.features import ScanFeatures

NEAR2 = 32 * 40.0**2  # unrelated bytes are about 100 apart
CAMERA = Camera(525, 525, 319.5, 239.5, 640, 480)


def two_scans(rng, count=200, no_depth=0):
    """Features of the same points in two cameras; the truth is that feature k is feature k."""
    T_b_a = se3.pose(se3.exp_so3(np.array([0.05, -0.1, 0.02])), np.array([0.1, -0.05, 0.08]))
    p_a = CAMERA.backproject(rng.uniform((60, 60), (580, 420), (count, 2)), rng.uniform(1, 3, count))
    p_b = se3.transform(T_b_a, p_a)
    descriptors = rng.integers(0, 256, (count, 32), dtype=np.uint8)
    scans = []
    for p in (p_a, p_b):
        px, z = CAMERA.project(p), p[:, 2].copy()
        if no_depth and p is p_b:
            z[-no_depth:] = np.nan
        scans.append(ScanFeatures(px, px, z, np.zeros((count, 2)), np.zeros(count, bool), descriptors))
    return scans, descriptors, T_b_a


def test_every_point_is_found_where_it_must_be_also_without_depth_in_one_scan():
    (a, b), descriptors, T_b_a = two_scans(np.random.default_rng(0), no_depth=50)
    found = guided_match(*(searchable(k, descriptors, CAMERA) for k in (a, b)), T_b_a, CAMERA, 4.0, NEAR2)
    assert np.array_equal(found, np.stack([np.arange(200)] * 2, axis=1))


def test_a_wrong_pose_finds_nothing_and_a_descriptor_too_far_neither():
    (a, b), descriptors, T_b_a = two_scans(np.random.default_rng(1))
    wrong = T_b_a.copy()
    wrong[0, 3] += 0.5
    ready, other = searchable(a, descriptors, CAMERA), searchable(b, ~descriptors, CAMERA)
    assert len(guided_match(ready, searchable(b, descriptors, CAMERA), wrong, CAMERA, 4.0, NEAR2)) < 5
    assert len(guided_match(ready, other, T_b_a, CAMERA, 4.0, NEAR2)) < 5


def test_directions_that_contradict_each_other_are_dropped():
    forward, backward = np.array([0, 1, -1, 2]), np.array([0, 2, 3, -1])
    assert agreed(forward, backward).tolist() == [[0, 0], [3, 2]]
    assert agreed(np.array([0, -1]), np.array([0, 9, -1])).tolist() == [[0, 0], [9, 1]]
