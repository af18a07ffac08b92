"""`miniloop inspect`: faults put into a simulated recording are named, sound recordings raise no alarm."""

import functools
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.cli.inspect import inspect as command
from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.datasets.sensor_steps import KINECT_STEP_PER_M, disparity_step
from miniloop_cli.inspection.findings import all_findings
from miniloop_cli.inspection.inspect import inspect
from miniloop_cli.inspection.timing import timing
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence

REAL = os.environ.get("MINILOOP_TUM")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    settings = SimulationSettings(frames=20, width=320, height=240)
    return write_sequence(tmp_path_factory.mktemp("inspect") / "room", settings, seed=0)


@pytest.fixture(scope="module")
def sequence(folder):
    return open_sequence(folder)


def warp(depth, M):
    return cv2.warpAffine(depth, np.float32(M), depth.shape[::-1], flags=cv2.INTER_NEAREST)


@functools.cache
def scan_of(sequence, index):
    return read_scan(sequence, index)


def inspect_with(sequence, depth_of=lambda k: k, change=lambda depth: depth):
    """Inspect with the depth of another frame, or a changed one, behind every colour image."""

    def read(sequence, index):
        other = min(max(depth_of(index), 0), len(sequence.frames) - 1)
        depth = scan_of(sequence, other).depth_m
        return replace(scan_of(sequence, index), depth_m=np.ascontiguousarray(change(depth), np.float32))

    return inspect(sequence, np.random.default_rng(0), read)


def codes(result):
    return {finding.code: finding for finding in result.findings if finding.level != "note"}


@pytest.mark.slow
def test_a_sound_recording_raises_no_alarm(sequence):
    result = inspect_with(sequence)
    assert codes(result) == {}
    numbers = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert numbers["registration"]["kind"] == "registered"
    assert numbers["focal"]["px"] == pytest.approx(262.5, rel=0.01)
    assert numbers["truth"]["factor"] == pytest.approx(1, abs=0.02)
    assert numbers["disparity"]["factor"] == pytest.approx(1, abs=0.02)
    assert numbers["explained"]["median"] > 0.9 and numbers["pairs"]["neighbours"] == 1


@pytest.mark.slow
def test_depth_scale_is_judged_by_the_ground_truth(sequence):
    finding = codes(inspect_with(sequence, change=lambda d: 1.2 * d))["depth-scale"]
    assert finding.level == "problem" and "times those of the ground truth" in finding.message
    assert float(finding.message.split("distances are ")[1].split()[0]) == pytest.approx(1.2, rel=0.01)
    assert int(finding.advice.split("about ")[1].split()[0]) == pytest.approx(6000, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "units"), [(1.2, 6034), (1 / 1.2, 4190)])
def test_depth_scale_is_judged_by_the_steps_of_the_sensor(sequence, factor, units):
    blind = replace(sequence, ground_truth_path=None)
    found = codes(inspect_with(blind, change=lambda d: factor * d))
    assert set(found) == {"depth-scale"}
    assert int(found["depth-scale"].advice.split("about ")[1].split()[0]) == pytest.approx(units, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [525 / 450, 450 / 525])
def test_wrong_camera_is_named_with_the_right_focal_length(sequence, factor):
    camera = replace(sequence.camera, fx=sequence.camera.fx * factor, fy=sequence.camera.fy * factor)
    result = inspect_with(replace(sequence, camera=camera))
    assert set(codes(result)) == {"wrong-camera"}
    assert result.numbers["focal"]["px"] == pytest.approx(262.5, rel=0.015)


@pytest.mark.slow
def test_a_focal_length_far_off_is_told_as_a_bound(sequence):
    camera = replace(sequence.camera, fx=sequence.camera.fx * 1.7, fy=sequence.camera.fy * 1.7)
    found = codes(inspect_with(replace(sequence, camera=camera)))
    assert "a focal length of 314 px or less, not 446 px" in found["wrong-camera"].message


@pytest.mark.slow
def test_swapped_depth(sequence):
    order = np.random.default_rng(1).permutation(20)
    assert set(codes(inspect_with(sequence, lambda k: order[k]))) == {"swapped-depth"}


@pytest.mark.slow
def test_late_depth_is_named_with_its_delay(sequence):
    found = codes(inspect_with(sequence, lambda k: k - 2))
    assert set(found) == {"swapped-depth"} and "2 frame(s) earlier" in found["swapped-depth"].message


@pytest.mark.slow
def test_single_swapped_frames_are_named(sequence):
    result = inspect_with(sequence, lambda k: 19 - k if k % 7 == 3 else k)
    assert set(codes(result)) == {"swapped-depth"}
    assert result.numbers["explained"]["odd_frames"] == [3, 10, 17]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: warp(d, [[1, 0, 10], [0, 1, -4]]), "moved by (-10, "),
        (lambda d: warp(d, [[0.9, 0, 16], [0, 0.9, 12]]), "scaled by 1.11"),
    ],
)
def test_unregistered_depth(sequence, change, words):
    found = codes(inspect_with(sequence, change=change))
    assert set(found) == {"unregistered-depth"} and words in found["unregistered-depth"].message


@pytest.mark.slow
def test_mirrored_depth(sequence):
    assert "mirrored-depth" in codes(inspect_with(sequence, change=np.fliplr))


@pytest.mark.slow
def test_what_was_dropped_is_no_nothing(folder, tmp_path):
    """An image without a partner is no finding of its own, but the last line may not say that nothing is wrong."""
    cut = tmp_path / "cut"
    shutil.copytree(folder, cut)
    rows = (cut / "depth.txt").read_text().splitlines()
    (cut / "depth.txt").write_text("\n".join(rows[:-1]) + "\n")
    sound, told = (CliRunner().invoke(command, [str(path)]).stdout for path in (folder, cut))
    assert sound.endswith("Nothing looks wrong.\n") and "DROPPED" not in sound
    assert "Nothing looks wrong." not in told
    assert "DROPPED: 19 pairs from 20 colour and 19 depth images" in told


@pytest.mark.slow
def test_command_prints_and_writes_json(folder, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    names = sorted(path.name for path in (broken / "depth").iterdir())
    (broken / "depth" / names[3]).write_bytes(b"")
    (broken / "rgb" / names[5]).unlink()
    result = CliRunner().invoke(command, [str(broken), "--json", str(tmp_path / "out.json")])
    assert result.exit_code == 0, result.exception
    assert "WARNING (broken-frames): 2 of 20 frames cannot be used, the first: frame 3" in result.stdout
    assert "empty file" in result.stdout
    assert "the sequence's own camera.yaml" in result.stdout
    data = json.loads((tmp_path / "out.json").read_text())
    assert [entry["frame"] for entry in data["broken"]] == [3, 5]
    assert data["findings"][0]["code"] == "broken-frames" and data["findings"][0]["advice"]
    quiet = CliRunner().invoke(command, [str(broken), "-q"]).stdout
    assert quiet.startswith("WARNING (broken-frames)")
    assert "camera.yaml" not in quiet


@pytest.mark.slow
@pytest.mark.parametrize("value", [65535, 39990])
def test_a_value_for_no_reading_is_found(folder, tmp_path, value):
    marked = tmp_path / "marked"
    shutil.copytree(folder, marked)
    for path in (marked / "depth").iterdir():
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        depth[:60, :80] = 0
        cv2.imwrite(str(path), np.where(depth == 0, value, depth).astype(np.uint16))
    sequence = open_sequence(marked)
    result = inspect(sequence, np.random.default_rng(0))
    assert set(codes(result)) == {"no-reading"}
    finding, numbers = codes(result)["no-reading"], result.numbers
    assert f"hold the depth {value} ({value / 5000:.2f} m)" in finding.message
    assert numbers["no_reading"][0]["share"] == pytest.approx(numbers["images"]["holes"], abs=0.02)
    assert numbers["images"]["depth_m"][2] < 6
    assert str(sequence.notes[-1]) in numbers["notes"]


@pytest.mark.slow
def test_json_on_stdout_is_alone(tmp_path):
    tiny = write_sequence(tmp_path / "tiny", SimulationSettings(frames=1, width=64, height=48))
    result = CliRunner().invoke(command, [str(tiny), "--json", "-"])
    assert result.exit_code == 0, result.exception
    assert json.loads(result.stdout)["frames"] == 1


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["textureless", "plane"])
def test_hard_scenes_give_advice_not_alarms_about_depth(tmp_path, scene):
    path = write_sequence(
        tmp_path / "hard", SimulationSettings(frames=8, width=320, height=240, scene=scene, path="xyz")
    )
    found = codes(inspect_with(open_sequence(path)))
    assert found.keys() <= {"few-features", "little-overlap"}
    assert ("few-features" in found) == (scene == "textureless")


def test_disparity_step_of_made_up_readings():
    rng = np.random.default_rng(0)
    z = rng.uniform(0.8, 4.0, 200_000)
    for factor in (0.2, 0.8, 1.0, 1.2, 5.0):
        steps = (factor / KINECT_STEP_PER_M) / np.round(1 / (z * KINECT_STEP_PER_M))
        step, clarity = disparity_step([steps.astype(np.float32)])
        assert step * factor == pytest.approx(KINECT_STEP_PER_M, rel=0.005) and clarity > 0.9
    assert disparity_step([z.astype(np.float32)])[1] < 0.3
    assert disparity_step([]) == (0.0, 0.0)
    assert disparity_step([np.ones((60, 80), np.float32)] * 3) == (0.0, 0.0)


def test_timing_counts_pairs_and_gaps(sequence):
    frames = tuple(
        replace(f, timestamp_s=f.timestamp_s + (3.0 if k > 10 else 0)) for k, f in enumerate(sequence.frames)
    )
    numbers = timing(replace(sequence, frames=frames, available=(40, 60)))
    assert numbers["paired"] == pytest.approx(20 / 40)
    assert numbers["gaps"] == [{"after_frame": 10, "at_s": pytest.approx(1001.0), "length_s": pytest.approx(3.1)}]


def test_frames_left_out_on_purpose_are_not_missing(folder):
    assert timing(open_sequence(folder, max_frames=5))["paired"] == 1


def test_findings_from_numbers_alone():
    numbers = {
        "frames": 10,
        "broken": [{"frame": k, "reason": "empty file"} for k in range(5)],
        "timing": {"paired": 0.5, "color_images": 20, "depth_images": 20, "gaps": []},
        "camera": {"source": "TUM's ROS default", "trust": "guess", "fx": 525, "depth_scale": 5000},
        "images": {
            "holes": 0.95, "saturated": 0.5, "brightness": 240, "dark": 0.0, "blurred": 0.5, "depth_m": [0.1, 0.2, 0.3]
        },
        "features": {"median": 300, "with_depth": 200},
    }  # fmt: skip
    found = all_findings(numbers)
    assert [finding.code for finding in found if finding.level == "problem"] == [
        "broken-frames",
        "holes",
    ]
    expected = {"association", "over-exposed", "blur", "depth-range", "camera-unknown"}
    assert {finding.code for finding in found if finding.level == "warning"} == expected
    assert all(finding.message and finding.advice for finding in found)


@pytest.mark.slow
@pytest.mark.real
@pytest.mark.skipif(not REAL, reason="MINILOOP_TUM is not set")
@pytest.mark.parametrize(
    ("name", "every"), [("freiburg1_xyz_100", 1), ("freiburg1_xyz_100", 3), ("freiburg1_desk_100", 1)]
)
def test_no_false_alarm_on_real_sequences(name, every):
    sequence = open_sequence(Path(REAL) / name)
    result = inspect(replace(sequence, frames=sequence.frames[::every], available=(0, 0)), np.random.default_rng(0))
    assert result.findings == ()
    assert result.numbers["disparity"]["factor"] == pytest.approx(1, abs=0.02)
    assert result.numbers["registration"]["kind"] == "registered"
