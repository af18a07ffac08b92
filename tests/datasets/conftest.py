"""Fixtures of tiny recordings."""

from collections.abc import Callable
from pathlib import Path

import pytest
from tiny_recordings import Tiny, fill_tum


@pytest.fixture
def tiny(tmp_path: Path) -> Tiny:
    return Tiny(tmp_path / "recording")


@pytest.fixture
def make_tum() -> Callable[[Path], Tiny]:
    return lambda root: fill_tum(Tiny(root))


@pytest.fixture
def tum(tiny: Tiny) -> Tiny:
    return fill_tum(tiny)
