"""Hard stretches: each does what its name says, at the frames that stretches.csv names, with exact truth."""

import csv
from itertools import pairwise

import cv2
import numpy as np
import pytest

from miniloop_cli.cli import simulate as command
from miniloop_cli.datasets import open_sequence, read_ground_truth, read_scan
from miniloop_cli.errors import ConfigError, MiniloopError
from miniloop_cli.simulation import simulate
from miniloop_cli.simulation.settings import HARD, SimulationSettings
from miniloop_cli.simulation.simulate import START_S, true_trajectory
from miniloop_cli.simulation.stretches import LENGTH_S, missing, plan, ticks
from miniloop_cli.simulation.write import write_sequence

SMALL = {"width": 80, "height": 60, "rate_hz": 15.0}


def frames_of(*hard, seed=0, frames=60, **changes):
    settings = SimulationSettings(**(SMALL | {"frames": frames, "hard": hard} | changes))
    return settings, list(simulate(settings, np.random.default_rng(seed)))


def within(frames, name):
    return [k for k, frame in enumerate(frames) if name in frame.stretches]


def test_stretches_have_their_length_and_order_and_do_not_meet():
    settings = SimulationSettings(frames=2400, rate_hz=30.0, hard=HARD)
    found = plan(settings)
    assert [s.kind for s in found] == [kind for kind in HARD if kind != "blank"]
    assert all(a.last < b.first for a, b in pairwise(found))
    assert all(s.last - s.first == round(30 * LENGTH_S[s.kind]) for s in found)
    assert found[0].first > 0 and found[-1].last < 2400
    short = plan(SimulationSettings(frames=100, hard=HARD))
    assert all(a.last < b.first for a, b in pairwise(short))
    assert [s.kind for s in plan(SimulationSettings(hard=("dark", "dark")))] == ["dark", "dark"]


def test_ticks_say_which_image_a_stamp_holds():
    def sources(kind):
        settings = SimulationSettings(frames=40, hard=(kind,))
        (stretch,) = plan(settings)
        found = {tick.number: tick.source - tick.number for tick in ticks(settings)}
        assert all(found[k] == 0 for k in found if not stretch.first <= k < stretch.last)
        return [found.get(k) for k in range(stretch.first, stretch.last)], settings

    assert sources("doubled")[0] == [0, -1] * 5
    assert sources("frozen")[0] == [0, -1, -2, -3, -4, -5, -6]
    assert sources("swapped")[0] == [1, -1, 1, -1, 1, -1, 0]
    gone, settings = sources("missing")
    assert gone == [None] * 10 and len(ticks(settings)) == 30 and missing(settings) == list(range(15, 25))


@pytest.mark.slow
def test_light_goes_and_comes_back_while_depth_stays():
    _, frames = frames_of("dark")
    dark, black = within(frames, "dark"), within(frames, "black")
    mean = np.array([frame.color.mean() for frame in frames])
    assert dark[0] < black[0] and black[-1] < dark[-1] and len(black) >= 3
    assert mean[black].max() < 12 and mean[[dark[0] - 1, dark[-1] + 1]].min() > 60
    assert (np.diff(mean[dark[0] : black[0]]) < 0).all() and (np.diff(mean[black[-1] + 1 : dark[-1]]) > 0).all()
    assert all((frames[k].depth > 0).mean() > 0.7 for k in dark + black)


@pytest.mark.slow
def test_a_covered_lens_sees_neither_light_nor_depth():
    _, frames = frames_of("covered")
    covered = within(frames, "covered")
    assert len(covered) == 15
    assert all(frames[k].color.mean() < 4 and not frames[k].depth.any() for k in covered)
    others = set(range(60)) - set(covered)
    assert all(frames[k].color.mean() > 30 and frames[k].depth.any() for k in others)


@pytest.mark.slow
def test_a_shaking_hand_blurs_colour_along_the_true_path():
    _, hard = frames_of("blur", noise=False, width=320, height=240)
    _, plain = frames_of(noise=False, width=320, height=240)
    shaken = within(hard, "blur")
    assert len(shaken) == 22

    def sharpness(frame):
        return cv2.Laplacian(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), cv2.CV_64F).var()

    ratio = [sharpness(hard[k]) / sharpness(plain[k]) for k in shaken[3:-3]]
    assert np.median(ratio) < 0.3
    moved = [np.abs(a.T_world_cam - b.T_world_cam).max() > 1e-9 for a, b in zip(hard, plain, strict=True)]
    assert 18 <= sum(moved) <= 22 and set(np.flatnonzero(moved)) <= set(shaken)
    before = shaken[0] - 1
    np.testing.assert_array_equal(hard[before].color, plain[before].color)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["doubled", "frozen", "swapped"])
def test_images_of_other_times_are_those_of_the_clean_recording(name):
    _, hard = frames_of(name)
    settings, clean = frames_of()
    truth = true_trajectory(settings, np.random.default_rng(0))
    at = {frame.timestamp_s: frame for frame in clean}
    assert [frame.timestamp_s for frame in hard] == list(at)
    elsewhere = [frame for frame in hard if frame.taken_s != frame.timestamp_s]
    assert elsewhere and all(name in frame.stretches for frame in elsewhere)
    for frame in hard:
        np.testing.assert_array_equal(frame.color, at[frame.taken_s].color)
        np.testing.assert_array_equal(frame.depth, at[frame.taken_s].depth)
        k = np.flatnonzero(truth.timestamps_s == frame.taken_s)
        np.testing.assert_allclose(frame.T_world_cam, truth.T_world_cam[k[0]], atol=1e-14)


@pytest.mark.slow
def test_a_blank_end_of_the_room_has_shape_and_no_features():
    _, frames = frames_of("blank", frames=40, width=320, height=240)
    _, plain = frames_of(frames=40, width=320, height=240)
    blank, sift = within(frames, "blank"), cv2.SIFT_create(2000)
    assert 3 <= len(blank) < 15
    for k, (frame, other) in enumerate(zip(frames, plain, strict=True)):
        np.testing.assert_array_equal(frame.depth, other.depth)
        if k in blank:
            found, usual = (len(sift.detect(cv2.cvtColor(f.color, cv2.COLOR_RGB2GRAY))) for f in (frame, other))
            assert found < 0.3 * usual


@pytest.mark.slow
def test_a_written_recording_names_its_stretches(tmp_path):
    settings = SimulationSettings(**(SMALL | {"frames": 120, "hard": HARD}))
    folder = write_sequence(tmp_path / "hard", settings, seed=2)
    with (folder / "stretches.csv").open() as file:
        rows = list(csv.DictReader(file))
    named = {}
    for row in rows:
        named.setdefault(row["stretch"], []).append(row["timestamp"])
    assert set(named) == {*HARD, "black"}
    recorded = [line.split()[0] for line in (folder / "rgb.txt").read_text().splitlines() if line[0] != "#"]
    assert set(recorded) == {path.stem for path in (folder / "rgb").iterdir()}
    assert len(recorded) == 120 - len(named["missing"]) and not set(recorded) & set(named["missing"])
    assert [float(stamp) for stamp in named["missing"]] == [
        pytest.approx(START_S + k / 15, abs=1e-6) for k in missing(settings)
    ]
    backwards = [k for k in range(len(recorded) - 1) if recorded[k] > recorded[k + 1]]
    first = recorded.index(named["unsorted"][-1])
    assert backwards == list(range(first, first + len(named["unsorted"]) - 1))
    assert all(row["taken"] == row["timestamp"] for row in rows if row["stretch"] in ("dark", "blur", "covered"))
    sequence = open_sequence(folder)
    truth = read_ground_truth(sequence)
    for k, frame in enumerate(sequence.frames):
        name = f"{frame.timestamp_s:.6f}"
        assert frame.timestamp_s in truth.timestamps_s
        if name in named["broken"]:
            with pytest.raises(MiniloopError):
                read_scan(sequence, k)
        else:
            assert (read_scan(sequence, k).depth_m.any()) == (name not in named["covered"])


def test_unknown_and_too_many_stretches_are_refused():
    assert command.HARD == HARD
    with pytest.raises(ConfigError, match="unknown hard stretch 'drak'; did you mean 'dark'"):
        SimulationSettings(hard=("drak",))
    with pytest.raises(ConfigError, match="10 hard stretches need at least 100 frames, not 30"):
        SimulationSettings(hard=HARD)
    with pytest.raises(ConfigError, match="'blank' needs a room"):
        SimulationSettings(scene="plane", hard=("blank",))
