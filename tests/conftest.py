"""For all tests."""

import signal
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import settings

# A shell lets what it starts in the background ignore interrupts, and what that starts, too: nothing could be tested.
signal.signal(signal.SIGINT, signal.default_int_handler)

# How long something takes is for benchmarks to say: machines are slow at times, and a first call compiles or imports.
settings.register_profile("miniloop", deadline=None)
settings.load_profile("miniloop")


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An empty cache for the tests of a module, which asks for it by pytest.mark.usefixtures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINILOOP_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers in every run."""
    return np.random.default_rng(0)
