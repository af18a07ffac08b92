"""Files of recorders: RealSense bags, Azure Kinect videos, logs of ElasticFusion; made here by independent writers."""

import json
import pickle

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.depth_registration import register_depth
from tests.datasets.bag_writers import BagWriter, noise
from tests.datasets.container_writers import (
    COLOR_MODEL,
    DEPTH_MODEL,
    TRANSLATION_M,
    calibration,
    write_azure,
    write_klg,
)

# --- RealSense: what librealsense 2.55 writes, message by message.

DEVICE = "/device_0/sensor_0/Depth_0", "/device_0/sensor_1/Color_0"
T_COLOR_DEPTH = se3.pose(cv2.Rodrigues(np.array([0.0, 0.0, 0.05]))[0], np.array([0.015, 0.002, -0.003]))
T_OF_REFERENCE = se3.pose(cv2.Rodrigues(np.array([0.3, -0.2, 0.1]))[0], np.array([0.01, 0.02, 0.03]))
PLANE_M = 1.5
INTRINSICS = ((40.0, 0, 30.0, 0, 41.0, 22.0, 0, 0, 1), (52.5, 0, 31.5, 0, 52.5, 23.5, 0, 0, 1))
OPTION = "/device_0/sensor_0/option/Depth_Units/value"


def write_realsense(
    path, unit_m=0.0005, left_out=(), reference=("1", "1"), frames=3, D=(0.1, -0.2, 0.001, 0.002, 0.05)
):
    mm = np.full((40, 60), PLANE_M / (unit_m or 0.001), np.uint16)
    with BagWriter(path) as bag:
        float32, string = bag.type("std_msgs/msg/Float32"), bag.type("std_msgs/msg/String")
        bag.write("/device_0/sensor_0/option/Depth_Units/description", string(data="metres a unit"), 0.1)
        if unit_m:
            bag.write(OPTION, float32(data=unit_m), 0.1)
        # A transform takes points of the reference stream to its own stream.
        poses = se3.inverse(T_COLOR_DEPTH) @ T_OF_REFERENCE, T_OF_REFERENCE
        for stream, T, number in zip(DEVICE, poses, reference, strict=True):
            if f"{stream}/tf" not in left_out:
                bag.write(f"{stream}/tf/{number}", bag.transform_of(T), 0.1)
        for stream, size, K, model, k in (
            (DEVICE[0], (60, 40), INTRINSICS[0], "None", ()),
            (DEVICE[1], (64, 48), INTRINSICS[1], "Brown Conrady", D),
        ):
            if f"{stream}/info" not in left_out:
                bag.info(f"{stream}/info/camera_info", 0.1, size, K, k or [0.0] * 5, model, "0")
        for k, (_, color, _) in enumerate(noise(frames=frames)):
            bag.image(f"{DEVICE[0]}/image/data", mm, "mono16", 100 + k / 30, "0")
            bag.image(f"{DEVICE[1]}/image/data", color, "rgb8", 100.004 + k / 30, "0")
    return path


def test_a_realsense_bag_is_registered_by_its_own_calibration(tmp_path):
    sequence = open_sequence(write_realsense(tmp_path / "a.bag"))
    assert (sequence.layout, sequence.name, len(sequence.frames)) == ("realsense", "a", 3)
    assert sequence.camera.depth_scale == 2000.0
    np.testing.assert_allclose(sequence.camera.lens.coefficients, (0.1, -0.2, 0.001, 0.002, 0.05))
    own = sequence.depth_camera
    np.testing.assert_allclose(own.T_color_depth, T_COLOR_DEPTH, atol=1e-12)
    assert (own.camera.fx, own.camera.fy, own.camera.width) == (40.0, 41.0, 60)
    scan = read_scan(sequence, 1)
    assert np.array_equal(scan.color, noise(frames=3)[1][1])
    expected = register_depth(np.full((40, 60), PLANE_M, np.float32), own.camera, sequence.camera, T_COLOR_DEPTH)
    np.testing.assert_allclose(scan.depth_m, expected, atol=1e-6)
    # The depth camera's plane z = 1.5 lies at 1.497 m in the colour camera, which is turned about its axis only.
    assert np.abs(scan.depth_m[scan.depth_m > 0] - 1.497).max() < 1e-6
    assert [frame.timestamp_s for frame in sequence.frames] == pytest.approx([100.004, 100.0373, 100.0707], abs=1e-4)
    assert any("depth of 0.5 mm a unit is registered" in str(note) for note in sequence.notes)
    assert pickle.loads(pickle.dumps(sequence)) == sequence


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"unit_m": None}, f"lacks {OPTION}, the unit of depth"),
        ({"unit_m": 5.0}, "is 5 m, which cannot be a unit of depth"),
        ({"left_out": [f"{DEVICE[0]}/tf"]}, f"lacks {DEVICE[0]}/tf/0, the pose of"),
        ({"left_out": [f"{DEVICE[1]}/info"]}, f"lacks {DEVICE[1]}/info/camera_info"),
        ({"reference": ("0", "1")}, "no reference in common"),
    ],
)
def test_what_a_realsense_bag_lacks_is_named(tmp_path, options, said):
    with pytest.raises(InputError, match=said):
        open_sequence(write_realsense(tmp_path / "a.bag", **options))


def test_a_camera_file_states_the_unit_that_a_realsense_bag_lacks(tmp_path):
    camera = tmp_path / "camera.yaml"
    camera.write_text("fx: 52\nfy: 52\ncx: 31\ncy: 23\nwidth: 64\nheight: 48\ndepth_scale: 1000\n")
    sequence = open_sequence(write_realsense(tmp_path / "a.bag", unit_m=None), camera_path=camera)
    assert sequence.camera.fx == 52 and sequence.depth_camera.camera.depth_scale == 1000


# --- Azure Kinect.


def azure_frames(count: int = 3, size=(640, 576)):
    rng = np.random.default_rng(0)
    color = [cv2.resize(rng.integers(0, 255, (9, 16, 3), np.uint8), (1280, 720)) for _ in range(count)]
    depth = [np.full(size[::-1], 1500 + 100 * k, np.uint16) for k in range(count)]
    return [(10 + k / 30, c, d) for k, (c, d) in enumerate(zip(color, depth, strict=True))]


def test_an_azure_kinect_recording_is_registered_by_its_calibration(tmp_path):
    frames = azure_frames()
    sequence = open_sequence(write_azure(tmp_path / "a.mkv", frames))
    assert (sequence.layout, sequence.name, len(sequence.frames)) == ("azure-kinect", "a", 3)
    camera, own = sequence.camera, sequence.depth_camera
    # 16:9 is the middle of the sensor's 4:3, the narrow field of view a part of its 1024 x 1024.
    assert (camera.fx, camera.cx) == pytest.approx((1280 * COLOR_MODEL[2], 1280 * COLOR_MODEL[0] - 0.5))
    assert (camera.fy, camera.cy) == pytest.approx((960 * COLOR_MODEL[3], 960 * COLOR_MODEL[1] - 0.5 - 120))
    assert (own.camera.fx, own.camera.cx) == pytest.approx((1024 * DEPTH_MODEL[2], 1024 * DEPTH_MODEL[0] - 192.5))
    assert own.camera.cy == pytest.approx(1024 * DEPTH_MODEL[1] - 180.5)
    np.testing.assert_allclose(own.T_color_depth[:3, 3], TRANSLATION_M)
    for k, (stamp, color, mm) in enumerate(frames):
        frame, scan = sequence.frames[k], read_scan(sequence, k)
        assert frame.timestamp_s == pytest.approx(stamp, abs=6e-4)  # ffmpeg writes milliseconds
        assert np.array_equal(frame.depth.read(), mm)
        assert np.abs(scan.color.astype(int) - color).mean() < 2
        assert np.abs(scan.depth_m[scan.depth_m > 0] - (mm[0, 0] / 1000 + 0.004)).max() < 1e-6
        assert (scan.depth_m > 0).mean() > 0.4
        assert (frame.depth.header().width, frame.depth.header().bits) == (640, 16)
    assert len({frame.depth.fingerprint() for frame in sequence.frames}) == 3


@pytest.mark.parametrize(("size", "whole", "crop"), [((320, 288), 512, (96, 90)), ((512, 512), 512, (0, 0))])
def test_modes_of_the_depth_camera(tmp_path, size, whole, crop):
    camera = open_sequence(write_azure(tmp_path / "a.mkv", azure_frames(1, size))).depth_camera.camera
    assert camera.fx == pytest.approx(whole * DEPTH_MODEL[2])
    assert (camera.cx, camera.cy) == pytest.approx([whole * DEPTH_MODEL[i] - crop[i] - 0.5 for i in (0, 1)])


def _without_place() -> dict:
    data = calibration()
    del data["CalibrationInformation"]["Cameras"][1]["Rt"]
    return data


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"attached": b""}, "has no calibration.json attached"),
        ({"attached": b"no json"}, "calibration.json is not JSON"),
        ({"attached": b"{}"}, "has no CalibrationInformation"),
        ({"attached": _without_place()}, "Rt missing"),
        ({"attached": calibration(CalibrationInformation={"Cameras": []})}, "Location ends in PV0"),
        ({"names": ("COLOR", "IR")}, r"has no track DEPTH.*its tracks: COLOR \(MJPG\), IR \(B16G\)"),
    ],
)
def test_what_an_azure_kinect_recording_lacks_is_named(tmp_path, options, said):
    with pytest.raises(InputError, match=said):
        open_sequence(write_azure(tmp_path / "a.mkv", azure_frames(1), **options))


def test_other_videos_are_refused(tmp_path):
    (tmp_path / "a.mkv").write_bytes(b"no video")
    with pytest.raises(InputError, match="of another kind than its name says"):
        open_sequence(tmp_path / "a.mkv")


def test_a_video_that_was_cut_off_or_has_no_index_opens(tmp_path):
    whole = write_azure(tmp_path / "a.mkv", azure_frames(4)).read_bytes()
    (tmp_path / "cut.mkv").write_bytes(whole[: int(0.6 * len(whole))])
    sequence = open_sequence(tmp_path / "cut.mkv")
    assert len(sequence.frames) == 2 and "cut.mkv was cut off or is damaged at byte" in str(sequence.notes[0])
    # As a stream: clusters of unknown size and no index at the end.
    live = open_sequence(write_azure(tmp_path / "live.mkv", azure_frames(4), options={"live": "1"}))
    assert len(live.frames) == 4 and np.array_equal(live.frames[3].depth.read(), azure_frames(4)[3][2])


# --- ElasticFusion.


def klg_frames(count: int = 3):
    rng = np.random.default_rng(0)
    color = [cv2.resize(rng.integers(0, 255, (12, 16, 3), np.uint8), (640, 480)) for _ in range(count)]
    return [(k * 33_333 + 5, c, rng.integers(500, 4000, (480, 640)).astype(np.uint16)) for k, c in enumerate(color)]


@pytest.mark.parametrize("zipped", [True, False])
@pytest.mark.parametrize("as_jpeg", [True, False])
def test_a_log_of_elastic_fusion(tmp_path, zipped, as_jpeg):
    frames = klg_frames()
    sequence = open_sequence(write_klg(tmp_path / "a.klg", frames, zipped, as_jpeg))
    assert (sequence.layout, sequence.name, sequence.camera.fx) == ("elastic-fusion", "a", 528.0)
    for k, (stamp, color, mm) in enumerate(frames):
        frame, scan = sequence.frames[k], read_scan(sequence, k)
        assert frame.timestamp_s == pytest.approx(stamp / 1e6)
        assert np.array_equal(scan.color, color) or (as_jpeg and np.abs(scan.color.astype(int) - color).mean() < 2)
        np.testing.assert_allclose(scan.depth_m, mm / 1000, rtol=1e-6)
        assert frame.depth.header().bits == 16 and frame.color.header().width == 640
    assert any("colour is read as RGB" in str(note) for note in sequence.notes)


def test_a_log_that_was_cut_off_opens_as_far_as_it_goes(tmp_path):
    whole = write_klg(tmp_path / "a.klg", klg_frames(4)).read_bytes()
    (tmp_path / "cut.klg").write_bytes(whole[:-1000])
    sequence = open_sequence(tmp_path / "cut.klg")
    assert len(sequence.frames) == 3
    assert "cut.klg claims 4 frames and holds 3 whole ones, then it is cut off" in str(sequence.notes[0])
    (tmp_path / "none.klg").write_bytes(b"\1\0\0\0" + bytes(3))
    with pytest.raises(InputError, match="no whole frame"):
        open_sequence(tmp_path / "none.klg")


def test_a_frame_of_a_log_that_expands_beyond_its_size_is_refused(tmp_path):
    frames = klg_frames(1)
    big = np.zeros((4800, 640), np.uint16)
    sequence = open_sequence(write_klg(tmp_path / "a.klg", [(5, frames[0][1], big), (40_000, frames[0][1], big)]))
    with pytest.raises(InputError, match=r"614401 bytes, expected 614400"):
        sequence.frames[0].depth.read()


def test_calibration_is_that_of_the_camera_file_reader(tmp_path):
    """The same colour camera as from the attachment given by --camera."""
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(calibration()))
    video = write_azure(tmp_path / "a.mkv", azure_frames(1))
    own, given = open_sequence(video).camera, open_sequence(video, camera_path=path).camera
    assert (own.fx, own.fy, own.cx, own.cy, own.lens) == (given.fx, given.fy, given.cx, given.cy, given.lens)
