"""Ground truths that mean something else by their poses: named, converted where that is sure, never a silent table."""

import numpy as np
import pytest

from miniloop_cli.cli.eval import CONVENTIONS as OFFERED
from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.evaluate import Protocol, evaluate
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.conventions import CONVENTIONS, MIRROR_Y, OPENGL_AXES
from miniloop_cli.scene.sequence import Trajectory


def w_first(T):
    """What a reader makes of quaternions w x y z that takes them for x y z w."""
    return se3.pose(se3.rotations(se3.quaternions(T[:, :3, :3], w_first=True)), T[:, :3, 3])


WRITERS = {
    "world-to-camera": se3.inverse,
    "opengl": lambda T: T @ OPENGL_AXES,
    "opengl-world-to-camera": lambda T: se3.inverse(T @ OPENGL_AXES),
    "w-first": w_first,
    "w-first-world-to-camera": lambda T: w_first(se3.inverse(T)),
    "left-handed": lambda T: MIRROR_Y @ T @ MIRROR_Y,
}


@pytest.fixture(params=range(5))
def walk(request):
    """A walk of 25 poses and the result of a run: some noise, a world of its own."""
    rng = np.random.default_rng(request.param)
    n = 25
    T = se3.pose(
        se3.exp_so3(np.cumsum(rng.normal(scale=0.1, size=(n, 3)), axis=0)),
        np.cumsum(rng.normal(scale=0.1, size=(n, 3)), axis=0),
    )
    noise = se3.pose(se3.exp_so3(rng.normal(scale=0.005, size=(n, 3))), rng.normal(scale=0.005, size=(n, 3)))
    world = se3.pose(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    stamps = 100 + np.arange(n) / 10
    return Trajectory(stamps, world @ T @ noise), Trajectory(stamps, T)


def rewritten(truth, write):
    return Trajectory(truth.timestamps_s, write(truth.T_world_cam))


def scaled(factor):
    return lambda T: se3.pose(T[:, :3, :3], factor * T[:, :3, 3])


def test_all_conventions_are_offered_and_tested():
    assert [*CONVENTIONS, "body"] == OFFERED
    assert WRITERS.keys() == CONVENTIONS.keys() - {"camera-to-world"}


@pytest.mark.parametrize("convention", WRITERS)
def test_another_convention_is_named_and_converted_on_request(walk, convention):
    estimate, truth = walk
    right = evaluate(estimate, truth).numbers
    given = rewritten(truth, WRITERS[convention])
    with pytest.raises(MiniloopError, match=f"give --gt-convention {convention}$"):
        evaluate(estimate, given)
    converted = evaluate(estimate, given, protocol=Protocol(convention=convention)).numbers
    assert converted["ate_rmse_m"] == pytest.approx(right["ate_rmse_m"], abs=1e-9)
    assert converted["rpe"]["consecutive"]["rot_deg_mean"] == pytest.approx(
        right["rpe"]["consecutive"]["rot_deg_mean"], abs=1e-6
    )
    assert CONVENTIONS[convention].words in converted["protocol"]["ground_truth"]
    with pytest.raises(MiniloopError, match=r"give --gt-convention camera-to-world$"):
        evaluate(estimate, truth, protocol=Protocol(convention=convention))


@pytest.mark.parametrize("alignment", ["SE3", "Sim3"])
def test_millimetres_are_converted_and_said(walk, alignment):
    estimate, truth = walk
    protocol = Protocol(alignment)
    right = evaluate(estimate, truth, protocol=protocol).numbers
    converted = evaluate(estimate, rewritten(truth, scaled(1000)), protocol=protocol).numbers
    assert converted["ate_rmse_m"] == pytest.approx(right["ate_rmse_m"])
    assert converted["scale"] == pytest.approx(right["scale"])
    assert "positions in millimetres" in converted["protocol"]["ground_truth"]


@pytest.mark.parametrize(("factor", "unit"), [(1050, "millimetres"), (100, "centimetres"), (0.001, "kilometres")])
def test_other_units_are_named(walk, factor, unit):
    estimate, truth = walk
    with pytest.raises(MiniloopError, match=rf"times as long as the result's: positions in {unit}\?"):
        evaluate(estimate, rewritten(truth, scaled(factor)))


@pytest.mark.parametrize("factor", [1.02, 0.9, 1.3])
def test_a_depth_scale_stays_what_it_is(walk, factor):
    estimate, truth = walk
    numbers = evaluate(estimate, rewritten(truth, scaled(factor)), protocol=Protocol("Sim3")).numbers
    assert numbers["scale"] == pytest.approx(factor, rel=0.02)
    assert numbers["protocol"]["ground_truth"] == ""


def test_a_tracked_body_is_named_and_fitted_on_request(walk):
    estimate, truth = walk
    T_cam_imu = se3.pose(se3.exp_so3(np.array([0.1, -1.4, 0.6])), np.array([0.05, -0.1, 0.02]))
    given = rewritten(truth, lambda T: T @ T_cam_imu)
    with pytest.raises(MiniloopError, match=r"a body that sits .* fit the offset with --gt-convention body"):
        evaluate(estimate, given)
    right = evaluate(estimate, truth).numbers
    fitted = evaluate(estimate, given, protocol=Protocol(convention="body")).numbers
    assert fitted["ate_rmse_m"] < 1.2 * right["ate_rmse_m"]
    assert "camera on the tracked body fitted: 1" in fitted["protocol"]["ground_truth"]


def test_a_lever_arm_alone_is_said_beside_the_table(walk):
    estimate, truth = walk
    given = rewritten(truth, lambda T: T @ se3.pose(np.eye(3), np.array([0.2, 0.1, 0.0])))
    numbers = evaluate(estimate, given).numbers
    said = numbers["protocol"]["ground_truth"].removeprefix("looks like poses of a body that sits ").split()
    assert float(said[0]) == pytest.approx(100 * np.hypot(0.2, 0.1), rel=0.05) and said[1] == "cm"


def test_a_body_needs_motion(walk):
    estimate, truth = walk
    still = np.broadcast_to(np.eye(4), truth.T_world_cam.shape)
    with pytest.raises(MiniloopError, match="too few poses, or too little rotation"):
        evaluate(Trajectory(estimate.timestamps_s, still), truth, protocol=Protocol(convention="body"))


def test_a_bad_result_is_measured_and_said(walk):
    estimate, _ = walk
    rng = np.random.default_rng(9)
    n = len(estimate.timestamps_s)
    other = se3.pose(se3.exp_so3(rng.normal(size=(n, 3))), rng.normal(size=(n, 3)))
    numbers = evaluate(estimate, Trajectory(estimate.timestamps_s, other)).numbers
    assert (
        numbers["protocol"]["ground_truth"]
        == "the motions of the result and of the ground truth differ: is the ground truth of this recording?"
    )
