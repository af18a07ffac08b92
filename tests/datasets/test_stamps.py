"""Units of time, lost digits and clocks that start again, told from the stamps alone."""

import numpy as np
import pytest

from miniloop_cli.datasets.stamps import (
    FRAME_NUMBERS,
    SECONDS,
    UNITS,
    clock_starts,
    in_seconds,
    lost_digits,
    unit_of,
    units_beside,
)

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("start_s", [0.0, 3217.4, 1305031102.175304])
@pytest.mark.parametrize("interval_s", [1 / 60, 1 / 30, 0.3, 1.5])
def test_every_unit_is_told_from_interval_and_magnitude(unit, start_s, interval_s):
    times_s = start_s + interval_s * np.arange(50) + RNG.normal(0, 0.001, 50)
    stamps = times_s * unit.per_s
    if unit.per_s > 1:
        stamps = np.round(stamps)
    assert unit_of(RNG.permutation(stamps)) == unit
    np.testing.assert_allclose(in_seconds(stamps, unit), times_s, atol=0.0006)


def test_whole_numbers_one_apart_count_frames():
    assert unit_of(range(40)) == unit_of(range(1, 9)) == FRAME_NUMBERS
    assert unit_of([1.5, 2.5, 3.5]) == SECONDS  # one a second


@pytest.mark.parametrize(
    "stamps",
    [
        np.arange(0, 60, 5),
        np.arange(0, 110, 11),
        2e9 + 33 * np.arange(9),
        10.25 * np.arange(9),  # scans by a timer, or a very fast camera
        np.array([0.4, 31.2, 92.9, 110.3, 171.8, 180.1]),  # scans by hand
    ],
)
def test_what_may_be_two_units_is_none(stamps):
    assert unit_of(stamps) is None


def test_few_stamps():
    assert unit_of([]) == unit_of([12.0]) == SECONDS
    assert unit_of([1403636579763555584]).name == "nanoseconds"


@pytest.mark.parametrize("unit", UNITS)
def test_the_unit_of_a_file_beside_the_images(unit):
    times_s, frames_s = np.linspace(95, 140, 400), np.arange(100, 130, 0.1)

    def near(at_s):
        return int((np.abs(frames_s[:, None] - at_s).min(axis=1) < 0.1).sum())

    assert units_beside(times_s * unit.per_s, frames_s, near) == [unit]
    assert units_beside(times_s + 1000, frames_s, near) == []
    # Five whole numbers apart, and frames at the start alone: no unit serves more of them.
    assert len(units_beside(np.arange(0.0, 300, 5), np.array([0.0]), lambda at_s: 1)) == 2


def test_lost_digits_are_told_from_a_repeated_row():
    assert lost_digits([1, 2, 3, 3, 4, 5]) is None
    assert lost_digits(np.floor(np.arange(30) / 3.3)) == 1
    assert lost_digits(np.arange(40)) is None
    assert lost_digits([1.30503e9] * 5) == 1


def test_a_clock_that_starts_again():
    one, two = np.arange(0, 4, 0.1), np.arange(0.03, 2, 0.1)
    assert clock_starts(np.concatenate([one, two])).tolist() == [0, 40]
    assert clock_starts(np.concatenate([one + 7, two + 8, one + 7.5])).tolist() == [0, 40, 60]


@pytest.mark.parametrize(
    "stamps",
    [
        np.arange(20)[::-1],
        np.array([0, 1, 3, 2, 4, 5, 7, 6, 8, 9]),
        np.concatenate([np.arange(50, 60), np.arange(0, 10)]),  # files joined in another order
        np.array([0.2, 0.4, 0.0, 0.1, 0.3]),
        *(np.random.default_rng(k).permutation(30) for k in range(20)),
    ],
)
def test_rows_in_another_order_are_no_new_start(stamps):
    assert clock_starts(stamps).tolist() == [0]
