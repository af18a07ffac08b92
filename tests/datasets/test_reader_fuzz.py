"""Whatever lies in a recording, only the project's own errors come out, and they fit one printable line.

MINILOOP_FUZZ=N draws N inputs a test (100 by default).
"""

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import attempt

from miniloop_cli.datasets import ImageFile, open_sequence, read_color, read_depth, read_ground_truth, read_scan
from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import MiniloopError

PNG_MAGIC, JPEG_MAGIC = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"

fuzz = settings(
    max_examples=int(os.environ.get("MINILOOP_FUZZ", "100")),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def bytes_of(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


number = st.one_of(
    st.floats().map(str),
    st.floats(-2, 2000).map(str),
    st.integers().map(str),
    st.sampled_from(["nan", "-inf", "1e400", "1_0", "0x10", "١", "", "-", "1.0.0", "10.0", "10.1"]),
)
name = st.one_of(
    st.sampled_from(["rgb/10.000000.png", "rgb/none.png", "../x.png", "/etc/passwd", "rgb", ".", "~", "a" * 5000]),
    st.text(max_size=20),
)
line_end = st.sampled_from(["\n", "\r\n", "\r", "\n\n", "\0\n", ""])
comment = st.sampled_from(["", "#", "# file: 'rgbd_dataset_freiburg1_xyz.bag'", "\ufeff"])
row = st.one_of(st.tuples(number, name).map(" ".join), comment, st.text(max_size=30))
table = st.one_of(
    st.lists(st.tuples(row, line_end).map("".join), max_size=8).map("".join).map(bytes_of),
    st.binary(max_size=200),
)
pose_row = st.lists(number, min_size=6, max_size=9).map(" ".join)
trajectory = st.one_of(st.lists(pose_row, max_size=5).map("\n".join).map(bytes_of), st.binary(max_size=200))
scalar = st.one_of(
    st.none(), st.booleans(), number, st.text(max_size=8), st.sampled_from(["525.0", "64", "48", "5000"])
)
key = st.sampled_from(
    ["fx", "fy", "cx", "cy", "width", "height", "depth_scale", "k1", "k3", "fxx", "<<", "? [a]", "&a", "*a", "!!set"]
)
yaml_text = st.one_of(
    st.lists(st.tuples(key, scalar).map(lambda pair: f"{pair[0]}: {pair[1]}"), max_size=10)
    .map("\n".join)
    .map(bytes_of),
    st.binary(max_size=100),
    st.text("[]{}&*!|>-?:,#%@`'\" \n\tab019", max_size=60).map(bytes_of),
)


@pytest.mark.slow
@fuzz
@given(table, st.sampled_from(["rgb.txt", "depth.txt", "groundtruth.txt"]))
def test_tables(tum, data, which):
    (tum.root / which).write_bytes(data)
    sequence = attempt(open_sequence, tum.root)
    if sequence:
        assert len(sequence.frames) and np.isfinite([f.timestamp_s for f in sequence.frames]).all()
        assert all(Path(os.path.realpath(f.color.path)).is_relative_to(tum.root) for f in sequence.frames)
        for index in range(len(sequence.frames)):
            attempt(read_scan, sequence, index)
        attempt(read_ground_truth, sequence)


@fuzz
@given(trajectory)
def test_trajectories(tmp_path, data):
    (tmp_path / "t.txt").write_bytes(data)
    read = attempt(read_trajectory, tmp_path / "t.txt")
    if read:
        assert np.isfinite(read.T_world_cam).all() and (np.diff(read.timestamps_s) > 0).all()
        R = read.T_world_cam[:, :3, :3]
        np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)


@fuzz
@given(yaml_text)
def test_cameras(tmp_path, data):
    (tmp_path / "c.yaml").write_bytes(data)
    camera = attempt(read_camera_file, tmp_path / "c.yaml")
    if camera:
        assert np.isfinite(camera.K).all() and camera.fx > 0 and camera.width > 0 and camera.depth_scale >= 1


png = st.builds(
    lambda size, bits, kind, rest: PNG_MAGIC + b"\0\0\0\rIHDR" + struct.pack(">IIBB", *size, bits, kind) + rest,
    st.tuples(*[st.sampled_from([0, 1, 48, 64, 65536, 2**31, 2**32 - 1])] * 2),
    st.sampled_from([0, 1, 8, 16, 32, 255]),
    st.integers(0, 7),
    st.binary(max_size=80),
)
image = st.one_of(png, st.binary(max_size=100), st.binary(max_size=100).map(lambda b: JPEG_MAGIC + b))


@fuzz
@given(image)
def test_images(tmp_path, data):
    path = tmp_path / "i.png"
    path.write_bytes(data)
    for read in (ImageFile.header, read_color, read_depth):
        attempt(read, ImageFile(path))


@fuzz
@given(st.data())
def test_damaged_images(tiny, data):
    """Bytes of a sound file changed, removed or doubled."""
    if not (tiny.root / "sound.png").exists():
        tiny.color("sound.png")
        tiny.color("sound.jpg")
        tiny.depth("sound_depth.png")
    source = data.draw(st.sampled_from(["sound.png", "sound.jpg", "sound_depth.png"]))
    content = bytearray((tiny.root / source).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.one_of(st.integers(0, len(content)), st.integers(0, min(len(content), 700))))
        content[start : start + data.draw(st.integers(0, 6))] = data.draw(st.binary(max_size=6))
    path = tiny.root / "damaged.bin"
    path.write_bytes(content)
    for read in (ImageFile.header, read_color, read_depth):
        attempt(read, ImageFile(path))


json_value = st.recursive(
    st.one_of(st.none(), st.booleans(), st.floats(), st.integers(), st.text(max_size=5)),
    lambda inner: st.one_of(st.lists(inner, max_size=9), st.dictionaries(st.text(max_size=3), inner, max_size=3)),
    max_leaves=12,
)
phone_keys = st.sampled_from(
    ["K", "w", "h", "poses", "fx", "fy", "cx", "cy", "width", "height", "t_00", "intrinsic_matrix"]
)


@pytest.mark.slow
@fuzz
@given(st.dictionaries(phone_keys, json_value), st.sampled_from(["record3d", "open3d"]))
def test_json_of_phones_and_recorders(tiny, data, layout):
    import json

    color, file = {"record3d": ("rgb", "metadata.json"), "open3d": ("color", "intrinsic.json")}[layout]
    if not (tiny.root / "depth").exists():
        tiny.color(f"{color}/0.png")
        tiny.depth("depth/0.png")
    tiny.text(file, json.dumps(data))
    sequence = attempt(open_sequence, tiny.root, layout)
    if sequence:
        attempt(read_ground_truth, sequence)


@pytest.mark.slow
@fuzz
@given(table, st.sampled_from(["7-scenes", "scannet", "open3d"]))
def test_pose_files(tiny, data, layout):
    poses = {"7-scenes": "frame-0.pose.txt", "scannet": "pose/0.txt", "open3d": "trajectory.log"}[layout]
    tiny.text(poses, "").write_bytes(data)
    if layout == "7-scenes":
        tiny.color("frame-0.color.png", 640, 480)
        tiny.depth("frame-0.depth.png", 640, 480)
    else:
        tiny.color("color/0.png")
        tiny.depth("depth/0.png")
    tiny.text(
        "camera.yaml",
        f"fx: 60\nfy: 60\ncx: 32\ncy: 24\nwidth: {640 if layout == '7-scenes' else 64}\n"
        f"height: {480 if layout == '7-scenes' else 48}\ndepth_scale: 1000\n",
    )
    sequence = open_sequence(tiny.root, layout)
    attempt(read_ground_truth, sequence)


def test_oversized_files_are_not_read(tmp_path):
    with (tmp_path / "t.txt").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(MiniloopError, match="more than the 64 MB allowed"):
        read_trajectory(tmp_path / "t.txt")
    with pytest.raises(MiniloopError, match="allowed"):
        read_camera_file(tmp_path / "t.txt")
