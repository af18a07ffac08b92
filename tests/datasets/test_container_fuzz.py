"""Damaged containers: each opens, perhaps with fewer frames, or gives one line that names it; memory stays bounded.

By hand, with more inputs and a seed: python tests/datasets/test_container_fuzz.py COUNT SEED
"""

import resource
import sys
import tempfile
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.errors import MiniloopError
from tests.datasets.bag_writers import write_rgbd
from tests.datasets.container_writers import write_azure, write_klg
from tests.datasets.test_archives import packed
from tests.datasets.test_recorder_files import azure_frames, klg_frames, write_realsense
from tests.datasets.tiny_recordings import Tiny, fill_tum

pytestmark = pytest.mark.slow
KINDS = "plain.bag bz2.bag lz4.bag realsense.bag a.db3 a.mcap zstd.mcap a.mkv a.klg a.zip a.tar a.tgz a.tar.xz".split()


@cache
def whole(kind: str) -> bytes:
    """A sound file of a kind."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / kind
        if kind == "realsense.bag":
            write_realsense(path)
        elif kind.endswith(".bag"):
            write_rgbd(path, "ros1", {"plain.bag": ""}.get(kind, path.stem))
        elif kind == "a.db3":
            path = next(write_rgbd(path.with_suffix(""), "sqlite3").glob("*.db3"))
        elif kind.endswith(".mcap"):
            compression = "storage" if kind == "zstd.mcap" else ""
            path = next(write_rgbd(path.with_suffix(""), "mcap", compression).glob("*.mcap"))
        elif kind == "a.mkv":
            write_azure(path, azure_frames(2, (320, 288)))
        elif kind == "a.klg":
            write_klg(path, klg_frames(2))
        else:
            packed(fill_tum(Tiny(Path(folder) / "scan"), frames=3).root, path)
        return path.read_bytes()


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut off, with bytes or numbers changed, filled, removed or doubled: one way or several."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, max(len(out), 1)))
        # Half of the damage near the ends, where most of the structure is.
        if rng.random() < 0.5:
            at = min(int(rng.exponential(300)), len(out)) if rng.random() < 0.5 else max(len(out) - 1 - at % 3000, 0)
        how = rng.integers(0, 7)
        length = int(rng.integers(1, 64))
        if how == 0:
            out = out[:at]
        elif how == 1:
            for _ in range(length):
                if out:
                    out[int(rng.integers(0, len(out)))] ^= int(rng.integers(1, 256))
        elif how == 2:
            value = [0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 0x10000000, 1 << 24][rng.integers(0, 6)]
            out[at : at + 4] = value.to_bytes(4, "little" if rng.random() < 0.5 else "big")
        elif how == 3:
            out[at : at + 8] = [2**63 - 1, 2**64 - 1, 2**40, 0][rng.integers(0, 4)].to_bytes(8, "little")
        elif how == 4:
            out[at : at + length] = bytes([int(rng.integers(0, 256))]) * length
        elif how == 5:
            del out[at : at + length]
        else:
            out[at:at] = out[at : at + length]
    return bytes(out)


def try_to_read(path: Path) -> str:
    """What became of a damaged file: `frames`, `refused`; raises whatever is no MiniloopError."""
    try:
        sequence = open_sequence(path)
    except MiniloopError as error:
        assert path.name in str(error) or str(path) in str(error), f"does not name the file: {error}"
        assert "\n" not in str(error) and len(str(error)) < 1500
        return "refused"
    for k in range(len(sequence.frames)):
        try:
            scan = read_scan(sequence, k)
            assert np.isfinite(scan.depth_m).all()
        except MiniloopError as error:
            assert f"frame {k} " in str(error)
        sequence.frames[k].color.fingerprint()
    return "frames"


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_container_gives_frames_or_one_line(tmp_path, monkeypatch, kind, seed):
    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path / "cache"))
    path = tmp_path / kind
    path.write_bytes(damaged(whole(kind), np.random.default_rng(seed)))
    try_to_read(path)


@pytest.mark.parametrize("kind", KINDS)
def test_a_container_cut_off_anywhere_gives_frames_or_one_line(tmp_path, monkeypatch, kind):
    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path / "cache"))
    data, path = whole(kind), tmp_path / kind
    for at in (*range(0, 120, 7), *np.linspace(120, len(data) - 1, 12).astype(int).tolist()):
        path.write_bytes(data[:at])
        try_to_read(path)


def main(count: int, seed: int) -> None:
    """Damage `count` files and say what became of them."""
    import os
    import time
    import traceback

    with tempfile.TemporaryDirectory() as folder:
        os.environ["MINILOOP_CACHE"] = f"{folder}/cache"
        found, slowest, before = Counter(), (0.0, ""), None
        for number in range(count):
            kind = KINDS[number % len(KINDS)]
            path = Path(folder) / kind
            path.write_bytes(damaged(whole(kind), np.random.default_rng([seed, number])))
            start = time.monotonic()
            try:
                found[kind, try_to_read(path)] += 1
            except Exception:
                found[kind, "FAULT"] += 1
                sys.stderr.write(f"input {number}: {kind}\n{traceback.format_exc()}\n")
            slowest = max(slowest, (time.monotonic() - start, f"{number} {kind}"))
            for kept in Path(folder).glob("cache/unpacked/*"):
                kept.unlink()
            if number == 200:
                before = peak_mb()
            if number % 500 == 499:
                sys.stderr.write(f"{number + 1} inputs, {sum(found[kind, 'FAULT'] for kind in KINDS)} faults\n")
        for kind in KINDS:
            print(kind, {what: found[kind, what] for what in ("frames", "refused", "FAULT")})
        print(
            f"{count} inputs, slowest {slowest[0]:.2f} s ({slowest[1]}), peak memory {before:.0f} -> {peak_mb():.0f} MB"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
