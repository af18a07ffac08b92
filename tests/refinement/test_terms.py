"""Terms of the refinement: derivatives against finite differences, and what one more term does to an adjustment."""

import re
import sys
import types
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from refinement_scenes import CAMERA, errors, graph, perturbed, scene

from miniloop_cli.geometry import se3
from miniloop_cli.refinement.bundle import BundleSettings, bundle_adjust
from miniloop_cli.refinement.depth_term import DepthTerm
from miniloop_cli.refinement.gravity import GravityTerm
from miniloop_cli.refinement.pixel_term import PixelTerm
from miniloop_cli.refinement.posegraph import refine_pose_graph
from miniloop_cli.refinement.robust import KERNELS, Robust, robust
from miniloop_cli.refinement.terms import Gauge

TIGHT = BundleSettings(fixed_frame=0, relative_tolerance=1e-14, max_iterations=100, covariance=False)


def point_derivatives(term, p_cam, h=1e-6):
    """(d, 3, k) by central differences."""
    steps = h * np.eye(3)[:, :, None]
    return np.stack([(term.linearise(p_cam + s)[0] - term.linearise(p_cam - s)[0]) / (2 * h) for s in steps], axis=1)


def pose_derivatives(residual, frames, T_world_cam, h=1e-6):
    """(m, p, d, 6) by central differences of residual(T_world_cam) (m, d), whose rows depend on the frames (m, p)."""
    found = np.zeros((*frames.shape, residual(T_world_cam).shape[1], 6))
    for f in np.unique(frames):
        for c, step in enumerate(h * np.eye(6)):
            sides = []
            for xi in (step, -step):
                moved = T_world_cam.copy()
                moved[f] = moved[f] @ se3.pose(se3.exp_so3(xi[:3]), xi[3:])
                sides.append(residual(moved))
            rows, places = np.nonzero(frames == f)
            found[rows, places, :, c] = ((sides[0] - sides[1]) / (2 * h))[rows]
    return found


@dataclass(frozen=True)
class RelativePoses:
    """Relative poses T_j_i (m, 4, 4) of pairs of frames (m, 2) (i, j), with sigmas of 1 rad and 1 m."""

    frames: np.ndarray
    T_j_i: np.ndarray
    robust: Robust = field(default_factory=Robust)
    gauge: Gauge = Gauge.POSE

    def residual(self, T_world_cam):
        i, j = self.frames.T
        E = se3.inverse(T_world_cam[j]) @ T_world_cam[i] @ se3.inverse(self.T_j_i)
        return np.concatenate([se3.log_so3(E[:, :3, :3]), E[:, :3, 3]], axis=1)

    def linearise(self, T_world_cam):
        return self.residual(T_world_cam), pose_derivatives(self.residual, self.frames, T_world_cam)


@pytest.fixture
def p_cam(rng):
    return rng.uniform((-1, -1, 0.5), (1, 1, 4), (30, 3)).T.copy()


def test_derivatives_of_pixels_and_depths(rng, p_cam):
    z_m = rng.uniform(0.5, 4, 30)
    z_m[3] = np.nan
    pixels = PixelTerm(rng.uniform(0, 480, (2, 30)), CAMERA, 0.7, Robust())
    depths = DepthTerm(z_m, CAMERA.noise.sigma_m(np.nan_to_num(z_m, nan=1.0)), Robust())
    np.testing.assert_allclose(pixels.linearise(p_cam)[1], point_derivatives(pixels, p_cam), rtol=1e-6, atol=1e-5)
    known = np.arange(30) != 3
    residual, jacobian = depths.linearise(p_cam)
    np.testing.assert_allclose(jacobian[..., known], point_derivatives(depths, p_cam)[..., known], rtol=1e-6, atol=1e-5)
    assert np.isnan(residual[0, 3])
    rows = np.array([7, 2, 2])
    for term in (pixels, depths):
        np.testing.assert_array_equal(term.of(rows).linearise(p_cam[:, rows])[0], term.linearise(p_cam)[0][:, rows])


def test_derivatives_of_gravity(rng):
    T = se3.pose(se3.exp_so3(rng.normal(size=(5, 3))), rng.normal(size=(5, 3)))
    up = rng.normal(size=(3, 3))
    term = GravityTerm(np.array([[4], [0], [2]]), up / np.linalg.norm(up, axis=1)[:, None], 0.02, Robust())
    by_steps = pose_derivatives(lambda T: term.linearise(T)[0], term.frames, T)
    np.testing.assert_allclose(term.linearise(T)[1], by_steps, atol=1e-6)


@pytest.mark.parametrize("kernel", KERNELS)
def test_kernels_in_arrays_and_in_compiled_code_agree(kernel):
    s = np.array([0.0, 0.3, 4.0, 1e4])
    expected = np.array([robust(KERNELS[kernel], x, 2.25) for x in s])
    np.testing.assert_allclose(Robust(kernel, 1.5).cost(s), expected[:, 0])
    np.testing.assert_allclose(Robust(kernel, 1.5).weight(s), expected[:, 1])


def test_a_point_term_given_twice_is_one_with_more_weight(rng):
    S = scene(rng, sigma_px=1, depth_sigmas=1)
    start = perturbed(S.T, rng, 0.3, 0.01)
    plain = replace(TIGHT, kernel="none")
    pixels = PixelTerm(S.px.T, CAMERA, 1.0, Robust())
    twice = bundle_adjust(start, *S.observations, CAMERA, plain, point_terms=[pixels])
    depth = 4 / np.sqrt(2)
    heavier = bundle_adjust(
        start, *S.observations, CAMERA, replace(plain, sigma_px=np.sqrt(0.5), depth_sigma_factor=np.sqrt(2) * depth)
    )
    np.testing.assert_allclose(twice.T_world_cam, heavier.T_world_cam, atol=1e-8)
    assert twice.descent.cost_after == pytest.approx(heavier.descent.cost_after)


def test_a_relative_pose_ties_what_no_track_ties(rng):
    S = scene(rng, n=8)
    keep = (S.frame < 4) == (S.track % 2 == 0)
    observations = [a[keep] for a in S.observations]
    tie = RelativePoses(np.array([[6, 1]]), (se3.inverse(S.T[1]) @ S.T[6])[None])
    start = perturbed(S.T, rng, 0.3, 0.01)
    alone = bundle_adjust(start, *observations, CAMERA, TIGHT)
    tied = bundle_adjust(start, *observations, CAMERA, TIGHT, pose_terms=[tie])
    assert np.abs(errors(S.T, tied.T_world_cam, 0)).max() < 1e-5
    assert np.abs(errors(S.T, alone.T_world_cam, 0)[4:]).max() > 1e-3


def test_gravity_lays_a_tilted_world_level_and_leaves_heading_and_place(rng):
    S = scene(rng)
    tilt = se3.pose(se3.exp_so3(np.array([0.2, -0.1, 0.0])), np.zeros(3))
    term = GravityTerm(np.arange(8)[:, None], S.T[:, 2, :3], 0.01, Robust("cauchy", 2.0))
    found = bundle_adjust(tilt @ S.T, *S.observations, CAMERA, TIGHT, pose_terms=[term])
    assert np.abs(errors(S.T, found.T_world_cam, 0)).max() < 1e-6
    np.testing.assert_allclose(found.T_world_cam[:, 2, :3], S.T[:, 2, :3], atol=1e-6)  # rows: z in each camera
    np.testing.assert_allclose(found.T_world_cam[0, :3, 3], (tilt @ S.T[0])[:3, 3], atol=1e-9)
    heading = se3.log_so3(found.T_world_cam[0, :3, :3] @ (tilt @ S.T[0])[:3, :3].T)[2]
    assert abs(heading) < 1e-6


@pytest.mark.slow
def test_gravity_holds_a_chain_upright_that_edges_let_sag(rng):
    """A chain of noisy edges drifts in tilt; verticals, an outlier among them, hold it."""
    T, pairs, *_ = graph(rng, n=40, edges=0, noise=False)
    step = se3.pose(se3.exp_so3(rng.normal(0, 0.01, (39, 3))), np.zeros((39, 3)))
    measured = se3.inverse(T[pairs[:, 1]]) @ T[pairs[:, 0]] @ step
    start = T.copy()
    for k, (i, j) in enumerate(pairs):
        start[j] = start[i] @ se3.inverse(measured[k])
    information = np.tile(np.diag([1e4] * 3 + [1e6] * 3), (39, 1, 1))
    up = T[:, 2, :3].copy()
    up[20] = [1, 0, 0]
    term = GravityTerm(np.arange(40)[:, None], up, 0.01, Robust("cauchy", 2.0))

    def tilt_deg(poses):
        return np.degrees(np.arccos(np.clip((poses[:, 2, :3] * T[:, 2, :3]).sum(axis=1), -1, 1)))

    sagging = refine_pose_graph(start, pairs, measured, information)
    upright = refine_pose_graph(start, pairs, measured, information, pose_terms=[term])
    assert tilt_deg(upright.T_world_cam).max() < 1.0
    assert tilt_deg(sagging.T_world_cam).max() > 2.0


def term_of_the_docs():
    """The Python block of docs/developers.md that is marked so, as a module."""
    text = (Path(__file__).parents[2] / "docs" / "developers.md").read_text(encoding="utf-8")
    code = re.search(r"<!-- test: term -->\n```python\n(.*?)```", text, re.DOTALL)[1]
    module = types.ModuleType("extending_term")
    sys.modules[module.__name__] = module  # where dataclasses look
    exec(compile(code, "developers.md (term)", "exec"), module.__dict__)
    return module.PosePriorTerm


@pytest.mark.parametrize("with_tracks", [False, True])
def test_the_term_of_the_docs(rng, with_tracks):
    S = scene(rng)
    term = term_of_the_docs()(np.arange(8)[:, None], S.T, 0.02, 0.05)
    off = perturbed(S.T, rng, 5, 0.1)
    by_steps = pose_derivatives(lambda T: term.linearise(T)[0], term.frames, off)
    np.testing.assert_allclose(term.linearise(off)[1], by_steps, atol=1e-6)
    observations = [a if with_tracks else a[:0] for a in S.observations]
    found = bundle_adjust(off, *observations, CAMERA, TIGHT, pose_terms=[term])
    np.testing.assert_allclose(found.T_world_cam, S.T, atol=1e-5)
