"""Freed memory stays with the process on glibc, and nothing is touched elsewhere."""

import subprocess
import sys

import pytest

from miniloop_cli.runtime.allocator import OF_USERS, keep_freed_memory

FAULTS = """
import resource, numpy as np
from miniloop_cli.runtime.allocator import keep_freed_memory
keep_freed_memory()
def images():
    for _ in range(50):
        [np.ones(1 << 17) for _ in range(8)]  # 8 MB, freed together
images()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
images()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


# Small arrays, every other one of which is freed: their pages lie between live ones.
HOLES = """
import numpy as np
from miniloop_cli.runtime.allocator import give_back_freed_memory, keep_freed_memory
keep_freed_memory()
def resident_mb():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6
kept = [np.ones(1 << 13) for _ in range(4000)][::2]  # of 64 kB
before = resident_mb()
give_back_freed_memory()
print(before - resident_mb(), sum(array.sum() for array in kept) == 2000 * 8192)
"""


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's allocator")
def test_images_reuse_the_pages_of_those_before():
    taken = run("from miniloop_cli.runtime.allocator import keep_freed_memory as keep; print(keep())")
    if taken != "True":
        pytest.skip("the C library is not glibc")
    assert int(run(FAULTS)) < 50  # of 102,400 pages; without it, nearly all


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's allocator")
def test_pages_between_live_arrays_are_given_back():
    if run("from miniloop_cli.runtime.allocator import keep_freed_memory as keep; print(keep())") != "True":
        pytest.skip("the C library is not glibc")
    given_mb, whole = run(HOLES).split()
    assert float(given_mb) > 80 and whole == "True"  # of 131 MB


@pytest.mark.parametrize("name", OF_USERS)
def test_what_users_set_stays(monkeypatch, name):
    monkeypatch.setenv(name, "1")
    assert not keep_freed_memory()


def test_other_systems_are_left_alone(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    assert not keep_freed_memory()
