"""Stamps of trajectories: their unit, their clock, their order."""

import numpy as np
import pytest

from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError

PER_S = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
RATE_HZ = 30.0
FRAMES_S = 0.04 + np.arange(90) / RATE_HZ
NUMBERED_S = np.arange(90) / RATE_HZ
EPOCH_S = 1305031102.25


def write(path, stamps, header=""):
    """Stamps as they are, or as text; the position tells the row."""
    path.write_text(header + "".join(f"{t} {k} 0 0 0 0 0 1\n" for k, t in enumerate(stamps)))
    return path


def in_unit(stamps_s, unit):
    return [f"{t:.6f}" if unit == "s" else round(round(t * 10**6) * PER_S[unit] / 10**6) for t in stamps_s]


@pytest.mark.parametrize("unit", PER_S)
@pytest.mark.parametrize("start_s", [0.0, 5.0, EPOCH_S])
@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 100.0, 200.0])
def test_the_unit_is_the_one_that_fits_the_frames(tmp_path, unit, start_s, rate_hz):
    at_s = start_s + np.arange(int(4 * rate_hz)) / rate_hz
    path = write(tmp_path / "t.txt", in_unit(at_s, unit))
    read = read_trajectory(path, start_s + FRAMES_S)
    np.testing.assert_allclose(read.timestamps_s, at_s, atol=0.001)
    assert f"stamps in {unit}" in read.source


@pytest.mark.parametrize("unit", PER_S)
def test_the_unit_of_times_since_1970_is_known_alone(tmp_path, unit):
    at_s = EPOCH_S + np.arange(5) / 10
    np.testing.assert_allclose(read_trajectory(write(tmp_path / "t.txt", in_unit(at_s, unit))).timestamps_s, at_s)


def test_a_header_overrules_and_must_fit(tmp_path):
    path = write(tmp_path / "t.txt", in_unit(FRAMES_S, "ms"), "# time[ms] tx ty tz qx qy qz qw\n")
    np.testing.assert_allclose(read_trajectory(path).timestamps_s, FRAMES_S, atol=0.001)
    path = write(tmp_path / "t.txt", in_unit(EPOCH_S + FRAMES_S, "ms"), "# time[ns] tx ty tz qx qy qz qw\n")
    with pytest.raises(InputError, match=r"the header says ns, but .* if they are in ms"):
        read_trajectory(path, EPOCH_S + FRAMES_S)


def test_another_clock_is_refused_with_advice(tmp_path):
    dense_s = np.arange(1000) / 100
    with pytest.raises(InputError, match=r"Its clock starts at 0: add .* \(near 1305031102\.29"):
        read_trajectory(write(tmp_path / "t.txt", in_unit(dense_s, "s")), EPOCH_S + FRAMES_S)
    with pytest.raises(InputError, match="The frames' clock starts at 0"):
        read_trajectory(write(tmp_path / "t.txt", in_unit(EPOCH_S + dense_s, "s")), FRAMES_S)
    with pytest.raises(InputError, match="is it of this recording"):
        read_trajectory(write(tmp_path / "t.txt", in_unit(EPOCH_S + 1e6 + dense_s, "s")), EPOCH_S + FRAMES_S)


def test_one_pose_a_frame_in_the_same_rhythm_is_shifted_and_said(tmp_path):
    rng = np.random.default_rng(0)
    frames_s = EPOCH_S + np.cumsum(rng.uniform(0.03, 0.05, 50))
    path = write(tmp_path / "t.txt", in_unit(frames_s - frames_s[0], "s"))
    read = read_trajectory(path, frames_s, lambda: {"frames of the recording": frames_s})
    np.testing.assert_array_equal(read.timestamps_s, frames_s)
    assert f"shifted by {frames_s[0]:.6f} s onto the frames (50: frames of the recording)" in read.source
    other_s = EPOCH_S + np.cumsum(rng.uniform(0.03, 0.05, 50))
    with pytest.raises(InputError, match="Its clock starts at 0"):
        read_trajectory(path, other_s, lambda: {"frames of the recording": other_s})


@pytest.mark.parametrize("first", [0, 1])
def test_row_numbers_are_no_times(tmp_path, first):
    path = write(tmp_path / "t.txt", range(first, 90 + first))
    read = read_trajectory(path, NUMBERED_S, lambda: {"frames of the recording": NUMBERED_S})
    np.testing.assert_array_equal(read.timestamps_s, NUMBERED_S)
    assert "by frame number (90: frames of the recording)" in read.source
    with pytest.raises(InputError, match=r"counts 90 rows .* instead of giving times"):
        read_trajectory(path, NUMBERED_S[:50], lambda: {"frames of the recording": NUMBERED_S[:50]})


def test_whole_seconds_are_times_where_the_frames_have_them(tmp_path):
    path = write(tmp_path / "t.txt", range(20))
    assert read_trajectory(path, np.arange(15.0), lambda: {"frames": np.arange(15.0)}).timestamps_s.tolist() == list(
        range(20)
    )


def test_lost_digits_are_refused_with_the_line(tmp_path):
    stamps = [f"{t:.0f}" for t in EPOCH_S + FRAMES_S]
    with pytest.raises(InputError, match=r"t\.txt:2: the stamp .* digits are lost"):
        read_trajectory(write(tmp_path / "t.txt", stamps))


def test_a_clock_that_starts_again_is_refused_with_the_line(tmp_path):
    stamps = [*FRAMES_S[:40], *(FRAMES_S[:40] + 0.01)]
    with pytest.raises(InputError, match=r"t\.txt:41: the stamps start again here"):
        read_trajectory(write(tmp_path / "t.txt", stamps))


def test_a_column_in_no_order_is_no_time(tmp_path):
    stamps = np.random.default_rng(0).uniform(0, 1, 50)
    with pytest.raises(InputError, match=r"start again here|is it the time"):
        read_trajectory(write(tmp_path / "t.txt", stamps))


def test_rows_from_last_to_first_are_sorted_and_said(tmp_path):
    read = read_trajectory(write(tmp_path / "t.txt", FRAMES_S[::-1]))
    np.testing.assert_allclose(read.timestamps_s, FRAMES_S)
    assert read.T_world_cam[0, 0, 3] == 89
    assert "sorted by time" in read.source


def test_a_unit_that_cannot_be_told_is_refused(tmp_path):
    """Whole numbers 5 apart are seconds or milliseconds where no frame lies near any of them."""
    path = write(tmp_path / "t.txt", range(0, 300, 5))
    with pytest.raises(InputError, match=r"may be in .* say so in a header"):
        read_trajectory(path, np.array([0.1, 5.0]))
