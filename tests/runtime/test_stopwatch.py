"""Seconds of stages."""

import time

import pytest

from miniloop_cli.runtime.stopwatch import Stopwatch


def test_a_stage_is_timed_by_the_clock_and_by_the_processor():
    watch = Stopwatch()
    with watch.stage("asleep"):
        time.sleep(0.2)
    with watch.stage("at work"):
        end = time.process_time() + 0.05
        while time.process_time() < end:
            pass
    assert list(watch.seconds) == list(watch.cpu_seconds) == ["asleep", "at work"]
    assert watch.seconds["asleep"] >= 0.199 and watch.cpu_seconds["asleep"] < 0.1
    assert watch.cpu_seconds["at work"] >= 0.05


def test_a_stage_that_comes_again_adds_up(monkeypatch):
    clock = iter([0.0, 1.0, 5.0, 7.5])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    watch = Stopwatch()
    for _ in range(2):
        with watch.stage("edges"):
            pass
    assert watch.seconds == {"edges": pytest.approx(3.5)}
