"""Accelerometer tables and the vertical of each frame."""

import numpy as np
import pytest

from miniloop_cli.datasets.accelerometer import read_accelerometer, verticals
from miniloop_cli.datasets.stamps import SECONDS, UNITS
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.simulate import accelerations, true_trajectory


def test_a_table(tmp_path):
    path = tmp_path / "accelerometer.txt"
    path.write_text("# timestamp ax ay az\n2.0 0 9.81 0\r\n\n1.0, 0, 9.8, 0.1\n2.0 7 7 7\n3 1 2 3 extra\n")
    read, notes = read_accelerometer(path, np.array([1.0, 2.0, 3.0]))
    assert read.stamps_s.tolist() == [1, 2, 3]
    assert read.readings.tolist() == [[0, 9.8, 0.1], [0, 9.81, 0], [1, 2, 3]]
    assert read.source == str(path)
    text = f"1 of 4 rows of accelerometer.txt repeat a stamp and are not used, the first: {path}:5"
    assert notes == (Note(NoteKind.DROPPED, text),)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.symbol)
@pytest.mark.parametrize(("start_s", "kind"), [(3.5, NoteKind.ASSUMED), (1305031102.25, NoteKind.CONVERTED)])
def test_stamps_in_other_units_are_converted_and_said(tmp_path, unit, start_s, kind):
    path, at_s = tmp_path / "accelerometer.txt", start_s + np.arange(300) / 100
    stamps = [f"{t:.6f}" if unit == SECONDS else f"{t * unit.per_s:.0f}" for t in at_s]
    path.write_text("".join(f"{stamp} 0 -9.81 {k}\n" for k, stamp in enumerate(stamps)))
    read, notes = read_accelerometer(path, start_s + np.arange(3.0))
    np.testing.assert_allclose(read.stamps_s, at_s, atol=0.0006)
    assert read.readings[:, 2].tolist() == list(range(300)) and np.isfinite(read.up).all()
    said = f"read as {unit.name} and converted to seconds"
    assert [(note.kind, said in note.text) for note in notes] == ([] if unit == SECONDS else [(kind, True)])


def test_stamps_that_may_be_two_units_are_refused(tmp_path):
    path = tmp_path / "accelerometer.txt"
    path.write_text("".join(f"{t} 0 0 9.8\n" for t in range(0, 300, 5)))
    with pytest.raises(InputError, match="may be in seconds or in milliseconds; write them in seconds"):
        read_accelerometer(path, np.array([0.05]))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2 3\n", ":1: expected 'timestamp"),
        ("# no\n", "no readings"),
        ("1 2 x 3\n", ":1: not a number"),
        ("1 2 3 4\n2 nan 0 0\n", ":2: NaN"),
        ("x 1 2 3\n", ":1: expected a timestamp"),
    ],
)
def test_what_is_refused(tmp_path, text, said):
    path = tmp_path / "accelerometer.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_accelerometer(path, np.arange(3.0))


def test_shaking_averages_out():
    rng = np.random.default_rng(0)
    stamps = np.arange(0, 4, 0.01)
    up = np.array([0.1, -0.9, 0.3])
    shaking = 4 * np.sin(2 * np.pi * 6 * stamps)[:, None] * [1, 0, 0]
    found = verticals(stamps, 9.81 * up + shaking + rng.normal(0, 0.2, (400, 3)), np.array([1.0, 2.0, 3.0, 7.0]))
    angle = np.degrees(np.arccos(found[:3] @ up / np.linalg.norm(up)))
    assert angle.max() < 1
    assert np.isnan(found[3]).all()


@pytest.mark.parametrize("path", ["still", "loop", "two-rooms"])
def test_simulated_readings_point_up(path):
    scene = {"scene": path, "path": "loop"} if path == "two-rooms" else {"path": path}
    settings = SimulationSettings(frames=20, rate_hz=0.5, **scene)
    stamps, readings = accelerations(settings, np.random.default_rng(3))
    truth = true_trajectory(settings, np.random.default_rng(3))
    at = truth.timestamps_s[10:-10:50]
    T = truth.T_world_cam[10:-10:50]
    angle = np.degrees(np.arccos((verticals(stamps, readings, at) * T[:, 2, :3]).sum(axis=1)))
    assert np.median(angle) < 2
    assert np.median(np.linalg.norm(readings, axis=1)) == pytest.approx(9.81, abs=0.3)
