"""For all tests."""

import signal

import numpy as np
import pytest
from hypothesis import settings

# A shell lets what it starts in the background ignore interrupts, and what that starts, too: nothing could be tested.
signal.signal(signal.SIGINT, signal.default_int_handler)

# How long something takes is for benchmarks to say: machines are slow at times, and a first call compiles or imports.
settings.register_profile("miniloop", deadline=None)
settings.load_profile("miniloop")


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers in every run."""
    return np.random.default_rng(0)
