"""Damaged recordings of phone apps and data sets: only the project's own errors come out, in one printable line each.

MINILOOP_FUZZ=N draws N inputs a layout (20 by default).
"""

import json
import os
import resource
import shutil
from pathlib import Path

import numpy as np
import pytest
import recorded_by_apps as apps
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import attempt

from miniloop_cli.datasets import open_sequence, read_ground_truth, read_scan

MAX_MB = 1500  # that a process may grow by, libraries and the frames of a video included
SMALL = apps.made_up(3, size=(64, 48), depth=(64, 48))
VGA = apps.made_up(2, size=(640, 480), depth=(640, 480))
PHONE = apps.made_up(3, size=(128, 96), depth=(256, 192))
SOURCES = {
    "record3d": lambda root: apps.record3d_file(root / "a.r3d", SMALL),
    "stray": lambda root: apps.stray_scanner(root / "a", SMALL),
    "polycam": lambda root: apps.polycam(root / "a", SMALL),
    "polycam zip": lambda root: apps.zipped(apps.polycam(root / "p", SMALL), root / "a.zip"),
    "arkitscenes": lambda root: apps.arkitscenes(root / "a", SMALL),
    "sens": lambda root: apps.scannet_sens(root / "a.sens", SMALL),
    "scannetpp": lambda root: apps.scannetpp(root / "a", PHONE),
    "scannetpp stream": lambda root: apps.scannetpp(root / "a", PHONE, form="stream"),
    "replica": lambda root: apps.replica(root / "a", SMALL),
    "bop": lambda root: apps.bop(root / "a", SMALL),
    "eth3d": lambda root: apps.eth3d(root / "a", SMALL),
    "bonn": lambda root: apps.bonn(root / "a", VGA),
    "openloris": lambda root: apps.openloris(root / "a", SMALL),
    "nerfcapture": lambda root: apps.nerfcapture(root / "a", SMALL),
}
fuzz = settings(
    max_examples=int(os.environ.get("MINILOOP_FUZZ", "20")),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large],
)
odd = st.one_of(
    st.none(),
    st.booleans(),
    st.floats(),
    st.integers(),
    st.sampled_from([1e308, -1, 0, 1 << 70, "", "x", [], {}, [[]], "../../etc/passwd", "/etc/passwd", "a\nb\x1b[31m"]),
    st.lists(st.floats(), max_size=20),
    st.text(max_size=5),
)


def looked_at(path: Path) -> None:
    sequence = attempt(open_sequence, path)
    if sequence is None:
        return
    assert sequence.frames and np.isfinite([frame.timestamp_s for frame in sequence.frames]).all()
    for index in range(min(len(sequence.frames), 3)):
        scan = attempt(read_scan, sequence, index)
        if scan:
            assert scan.color.dtype == np.uint8 and np.isfinite(scan.depth_m).all() and (scan.depth_m >= 0).all()
    truth = attempt(read_ground_truth, sequence)
    if truth:
        assert np.isfinite(truth.T_world_cam).all() and (np.diff(truth.timestamps_s) > 0).all()


def damaged(data, content: bytes) -> bytes:
    """Cut off, or some bytes changed, removed or put in; more often near the start, where headers are."""
    if data.draw(st.integers(0, 2)) == 0:
        return content[: data.draw(st.integers(0, len(content)))]
    changed = bytearray(content)
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.one_of(st.integers(0, len(changed)), st.integers(0, min(len(changed), 400))))
        changed[start : start + data.draw(st.integers(0, 8))] = data.draw(
            st.one_of(st.binary(max_size=8), st.sampled_from([b"\xff" * 4, b"\xff" * 8, b"\0" * 8, b"\x7f" * 4]))
        )
    return bytes(changed)


def altered(data, value):
    """JSON with another value somewhere."""
    if isinstance(value, dict) and value and data.draw(st.integers(0, 3)):
        key = data.draw(st.sampled_from(sorted(value)))
        if data.draw(st.integers(0, 9)) == 0:
            return {k: v for k, v in value.items() if k != key}
        return value | {key: altered(data, value[key])}
    if isinstance(value, list) and value and data.draw(st.integers(0, 3)):
        index = data.draw(st.integers(0, len(value) - 1))
        return [*value[:index], altered(data, value[index]), *value[index + 1 :]]
    return data.draw(odd)


@pytest.fixture(params=SOURCES)
def recording(request, tmp_path):
    path = SOURCES[request.param](tmp_path)
    looked_at(path)  # a sound one, so that what is allocated once is
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield path
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert grown < MAX_MB


@pytest.mark.slow
@fuzz
@given(st.data())
def test_damaged_recordings(recording, data):
    files = [recording] if recording.is_file() else sorted(p for p in recording.parent.rglob("*") if p.is_file())
    file = data.draw(st.sampled_from(files))
    content = file.read_bytes()
    if file.suffix == ".json" and data.draw(st.booleans()):
        file.write_text(json.dumps(altered(data, json.loads(content))))
    else:
        file.write_bytes(damaged(data, content))
    try:
        looked_at(recording)
    finally:
        file.write_bytes(content)


@pytest.mark.slow
@pytest.mark.parametrize("name", SOURCES)
def test_missing_parts(name, tmp_path):
    """Every file and every folder of a recording left out once."""
    path = SOURCES[name](tmp_path / "sound")
    if path.is_file():
        return
    for part in sorted(path.rglob("*")):
        copy = tmp_path / "copy" / path.relative_to(tmp_path / "sound")
        shutil.copytree(tmp_path / "sound", tmp_path / "copy")
        gone = copy / part.relative_to(path)
        shutil.rmtree(gone) if gone.is_dir() else gone.unlink()
        looked_at(copy)
        shutil.rmtree(tmp_path / "copy")
