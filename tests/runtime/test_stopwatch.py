"""Seconds of stages."""

import pytest

from miniloop_cli.runtime.stopwatch import Stopwatch


def test_a_stage_is_timed_by_the_clock_and_by_the_processor(monkeypatch):
    clock, processor = iter([10.0, 15.0, 15.0, 16.0]), iter([1.0, 1.25, 1.25, 3.25])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    monkeypatch.setattr("time.process_time", lambda: next(processor))  # other threads may be at work meanwhile
    watch = Stopwatch()
    for stage in ("asleep", "at work"):
        with watch.stage(stage):
            pass
    assert watch.seconds == {"asleep": 5.0, "at work": 1.0}
    assert watch.cpu_seconds == {"asleep": 0.25, "at work": 2.0}


def test_a_stage_that_comes_again_adds_up(monkeypatch):
    clock = iter([0.0, 1.0, 5.0, 7.5])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    watch = Stopwatch()
    for _ in range(2):
        with watch.stage("edges"):
            pass
    assert watch.seconds == {"edges": pytest.approx(3.5)}
