"""ROS bags and MCAP files, written by rosbags: the same frames, the right topics, cameras, stamps; damage named."""

import pickle
import shutil
import struct

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.datasets.bags import bag as bag_module
from miniloop_cli.datasets.bags.source import open_bag
from miniloop_cli.datasets.bags.topics import parse_topics
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.depth_registration import register_depth
from miniloop_cli.scene.sequence import NoteKind
from tests.datasets.bag_writers import COLOR, DEPTH, OPTICAL, BagWriter, K, noise, write_rgbd
from tests.datasets.container_writers import jpeg, png

KINDS = ["ros1", "sqlite3", "mcap"]
COMPRESSED = [("ros1", "bz2"), ("ros1", "lz4"), ("mcap", "storage"), ("mcap", "message"), ("sqlite3", "message")]
INFO = "/camera/color/camera_info"
STAMP = noise()[0][0]
IMAGE = noise()[0][1]
MM = noise()[0][2]


def opened(path, **options):
    return open_sequence(path, **options)


def notes(sequence) -> str:
    return " | ".join(map(str, sequence.notes))


@pytest.mark.parametrize(("kind", "compression"), [*((kind, "") for kind in KINDS), *COMPRESSED])
def test_frames_are_those_that_were_written(tmp_path, kind, compression):
    path = write_rgbd(tmp_path / "scan.bag", kind, compression)
    for where in {path, path if compression == "message" else _file(path)}:
        sequence = opened(where)
        assert sequence.layout == "ros" and len(sequence.frames) == 5
        assert (sequence.camera.fx, sequence.camera.cx, sequence.camera.width) == (52.5, 31.5, 64)
        for k, (stamp, color, mm) in enumerate(noise()):
            frame, scan = sequence.frames[k], read_scan(sequence, k)
            assert frame.timestamp_s == pytest.approx(stamp, abs=1e-6)
            assert frame.depth_timestamp_s == pytest.approx(stamp + 0.003, abs=1e-6)
            assert np.array_equal(scan.color, color)
            np.testing.assert_allclose(scan.depth_m, mm / 1000, rtol=1e-6)
            header = frame.color.header()
            assert (header.width, header.height, header.bits, header.channels) == (64, 48, 8, 3)
            assert pickle.loads(pickle.dumps(frame)) == frame
        prints = {frame.color.fingerprint() for frame in sequence.frames}
        assert len(prints) == 5


def _file(path):
    return path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))


def test_a_copy_elsewhere_has_the_same_fingerprints(tmp_path):
    path = write_rgbd(tmp_path / "a.bag")
    shutil.copyfile(path, tmp_path / "b.bag")
    one, other = opened(path), opened(tmp_path / "b.bag")
    assert [f.color.fingerprint() for f in one.frames] == [f.color.fingerprint() for f in other.frames]


def test_a_changed_file_is_read_again(tmp_path):
    path = write_rgbd(tmp_path / "a.bag")
    assert len(opened(path).frames) == 5
    path.unlink()
    write_rgbd(path, frames=noise(seed=1, frames=3))
    sequence = opened(path)
    assert len(sequence.frames) == 3
    assert np.array_equal(sequence.frames[0].color.read(), noise(seed=1)[0][1])


GREEN = np.zeros((48, 64, 3), np.uint8)
GREEN[..., 1] = 200
BGR = IMAGE[..., ::-1]
ALPHA = np.full((48, 64, 1), 7, np.uint8)
YUYV = np.stack([np.full((48, 64), 120), np.where(np.arange(64) % 2, 90, 160) * np.ones((48, 1))], -1).astype(np.uint8)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("rgb8", IMAGE, IMAGE),
        ("bgr8", BGR, IMAGE),
        ("rgba8", np.concatenate([IMAGE, ALPHA], 2), IMAGE),
        ("bgra8", np.concatenate([BGR, ALPHA], 2), IMAGE),
        ("mono8", IMAGE[..., 0], np.repeat(IMAGE[..., :1], 3, 2)),
        ("rgb16", IMAGE.astype(np.uint16) * 257, IMAGE),
        ("bgr16", (BGR.astype(np.uint16) * 257).astype(">u2"), IMAGE),
        ("yuv422_yuy2", YUYV, cv2.cvtColor(YUYV, cv2.COLOR_YUV2RGB_YUY2)),
        ("yuv422", YUYV[..., ::-1], cv2.cvtColor(YUYV, cv2.COLOR_YUV2RGB_YUY2)),
        ("YUYV", YUYV, cv2.cvtColor(YUYV, cv2.COLOR_YUV2RGB_YUY2)),
    ],
)
def test_colour_of_every_encoding(tmp_path, kind, encoding, pixels, expected):
    with BagWriter(tmp_path / "a.bag", kind) as bag:
        bag.image(COLOR, pixels, encoding, STAMP, pad=5)
        bag.image(DEPTH, MM, "16UC1", STAMP)
        bag.info(INFO, STAMP)
    assert np.array_equal(read_scan(opened(tmp_path / "a.bag"), 0).color, expected)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_keep_their_colours(tmp_path, pattern):
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[:] = (200, 100, 30)
    mosaic = np.zeros((48, 64), np.uint8)
    for place, letter in enumerate(pattern):
        mosaic[place // 2 :: 2, place % 2 :: 2] = rgb[0, 0, "rgb".index(letter)]
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image(COLOR, mosaic, f"bayer_{pattern}8", STAMP)
        bag.image(DEPTH, MM, "16UC1", STAMP)
        bag.info(INFO, STAMP)
    found = read_scan(opened(tmp_path / "a.bag"), 0).color
    assert np.abs(found[4:-4, 4:-4].astype(int) - (200, 100, 30)).max() <= 1


@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("16UC1", MM, MM / 1000),
        ("mono16", MM, MM / 1000),
        ("16UC1", MM.astype(">u2"), MM / 1000),
        ("32FC1", (MM / 1000).astype(np.float32), MM / 1000),
    ],
)
def test_depth_of_every_encoding(tmp_path, encoding, pixels, expected):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image(COLOR, IMAGE, "rgb8", STAMP)
        bag.image(DEPTH, pixels, encoding, STAMP, pad=2)
        bag.info(INFO, STAMP)
    np.testing.assert_allclose(read_scan(opened(tmp_path / "a.bag"), 0).depth_m, expected, rtol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_compressed_images(tmp_path, kind):
    with BagWriter(tmp_path / "a.bag", kind) as bag:
        bag.compressed(f"{COLOR}/compressed", png(IMAGE), "bgr8; png compressed bgr8", STAMP)
        bag.compressed(f"{DEPTH}/compressed", png(MM), "16UC1; png compressed ", STAMP)
        bag.info(INFO, STAMP)
    sequence = opened(tmp_path / "a.bag")
    scan = read_scan(sequence, 0)
    assert np.array_equal(scan.color, IMAGE)
    np.testing.assert_allclose(scan.depth_m, MM / 1000, rtol=1e-6)
    assert sequence.frames[0].depth.header().bits == 16


def test_jpeg_and_quantised_depth(tmp_path):
    smooth = cv2.GaussianBlur(IMAGE, (0, 0), 5)
    depth_m = np.linspace(0.5, 8.0, 48 * 64).reshape(48, 64)
    depth_m[:4] = 0
    # compressed_depth_image_transport: depth_max 10 m, depth_quantization 100; A = q (q + 1), B = 1 - A / depth_max.
    A = 100.0 * 101.0
    B = 1 - A / 10.0
    stored = np.where(depth_m > 0, np.rint(A / np.maximum(depth_m, 0.1) + B), 0).astype(np.uint16)
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.compressed(f"{COLOR}/compressed", jpeg(smooth), "rgb8; jpeg compressed bgr8", STAMP)
        data = struct.pack("<iff", 0, A, B) + png(stored)
        bag.compressed(f"{DEPTH}/compressedDepth", data, "32FC1; compressedDepth png", STAMP)
        bag.info(INFO, STAMP)
    sequence = opened(tmp_path / "a.bag")
    scan = read_scan(sequence, 0)
    assert np.abs(scan.color.astype(int) - smooth).mean() < 3
    # A step is z^2 / A metres.
    assert (np.abs(scan.depth_m - depth_m)[4:] <= depth_m[4:] ** 2 / A).all()
    assert not scan.depth_m[:4].any()
    assert sequence.frames[0].depth.header().bits == 32


def test_compressed_depth_in_millimetres_and_other_compressions(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image(COLOR, IMAGE, "rgb8", STAMP)
        bag.compressed(f"{DEPTH}/compressedDepth", bytes(12) + png(MM), "16UC1; compressedDepth", STAMP)
        bag.info(INFO, STAMP)
    np.testing.assert_allclose(read_scan(opened(tmp_path / "a.bag"), 0).depth_m, MM / 1000, rtol=1e-6)
    with BagWriter(tmp_path / "b.bag") as bag:
        bag.image(COLOR, IMAGE, "rgb8", STAMP)
        bag.compressed(f"{DEPTH}/compressedDepth", bytes(90), "16UC1; compressedDepth rvl", STAMP)
        bag.info(INFO, STAMP)
    with pytest.raises(InputError, match="no topic of depth images"):
        opened(tmp_path / "b.bag")


@pytest.mark.parametrize("unstamped", [{COLOR, DEPTH}, {DEPTH}])
def test_without_stamps_the_times_of_reception_are_used_and_that_is_said(tmp_path, unstamped):
    with BagWriter(tmp_path / "a.bag") as bag:
        for k, (_, color, mm) in enumerate(noise(frames=3)):
            for topic, pixels, encoding in ((COLOR, color, "rgb8"), (DEPTH, mm, "16UC1")):
                stamp = 0.0 if topic in unstamped else 5.0 + k
                bag.image(topic, pixels, encoding, stamp, received_s=100 + k / 10)
            bag.info(INFO, 5.0)
    sequence = opened(tmp_path / "a.bag")
    assert [frame.timestamp_s for frame in sequence.frames] == pytest.approx([100, 100.1, 100.2])
    note = next(note for note in sequence.notes if "have no stamps: the times of their reception" in str(note))
    assert note.kind == NoteKind.ASSUMED


def test_single_images_without_a_stamp_are_left_out(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        for k, (stamp, color, mm) in enumerate(noise(frames=4)):
            bag.image(COLOR, color, "rgb8", stamp if k != 1 else 0, received_s=stamp)
            bag.image(DEPTH, mm, "16UC1", stamp, received_s=stamp)
            bag.info(INFO, stamp)
    sequence = opened(tmp_path / "a.bag")
    assert len(sequence.frames) == 3
    assert f"1 of 4 images of {COLOR} have no stamp and are not used" in notes(sequence)


def test_several_depth_topics_the_registered_one_is_taken(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image("/camera/depth/image_rect_raw", MM // 2, "16UC1", STAMP, "camera_depth_optical_frame")
        bag.image("/camera/infra1/image_rect_raw", IMAGE[..., 0], "mono8", STAMP)
        bag.compressed(f"{COLOR}/compressed", jpeg(GREEN), "rgb8; jpeg compressed bgr8", STAMP)
        bag.image(COLOR, IMAGE, "rgb8", STAMP)
        bag.image(DEPTH, MM, "16UC1", STAMP)
        bag.info(INFO, STAMP)
        bag.info("/camera/aligned_depth_to_color/camera_info", STAMP)
    sequence = opened(tmp_path / "a.bag")
    scan = read_scan(sequence, 0)
    assert np.array_equal(scan.color, IMAGE)
    np.testing.assert_allclose(scan.depth_m, MM / 1000, rtol=1e-6)
    said = notes(sequence)
    assert f"colour from {COLOR}, depth from {DEPTH}, which is registered to colour by its name" in said
    assert "/camera/depth/image_rect_raw (1)" in said and f"{COLOR}/compressed (1)" in said
    assert "/camera/infra1/image_rect_raw (1)" in said


def test_topics_are_named_where_there_are_several(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        for side, factor in (("left", 1), ("right", 2)):
            bag.image(f"/{side}/color/image_raw", IMAGE // factor, "rgb8", STAMP, side)
            bag.image(f"/{side}/depth_registered/image_raw", MM // factor, "16UC1", STAMP, side)
            bag.info(f"/{side}/color/camera_info", STAMP, frame=side)
    with pytest.raises(InputError, match=r"2 topics of depth images: .*--topics depth=NAME"):
        opened(tmp_path / "a.bag")
    sequence = opened(tmp_path / "a.bag", topics="depth=/right/depth_registered/image_raw")
    assert np.array_equal(read_scan(sequence, 0).color, IMAGE // 2)
    assert sequence.topics == "depth=/right/depth_registered/image_raw"
    both = opened(tmp_path / "a.bag", topics="color=left/color/image_raw, depth=/left/depth_registered/image_raw")
    assert np.array_equal(read_scan(both, 0).color, IMAGE)
    with pytest.raises(InputError, match=r"/nowhere: has no such topic; its topics of images: /left/color"):
        opened(tmp_path / "a.bag", topics="color=/nowhere")
    with pytest.raises(InputError, match="has no CameraInfo; topics that have: /left/color/camera_info"):
        opened(tmp_path / "a.bag", topics="depth=/left/depth_registered/image_raw,info=/left/color/image_raw")


@pytest.mark.parametrize("text", ["color", "colour=", "=/a", "what=/a", "color=/a,color=/b"])
def test_malformed_topics(text):
    with pytest.raises(InputError, match="--topics is a list such as"):
        parse_topics(text)


def test_topics_are_for_bags(tmp_path):
    from tests.datasets.tiny_recordings import Tiny, fill_tum

    fill_tum(Tiny(tmp_path / "scan"))
    with pytest.raises(InputError, match="--topics is for bags"):
        opened(tmp_path / "scan", topics="color=/a")


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
def test_lenses_of_camera_info(tmp_path, kind):
    for model, D, expected in (
        ("plumb_bob", [0.1, -0.2, 0.001, 0.002, 0.05], "radial-tangential"),
        ("rational_polynomial", [0.1, -0.2, 0.001, 0.002, 0.05, 0.01, 0.02, 0.003], "radial-tangential"),
        ("equidistant", [0.01, -0.02, 0.003, 0.001], "fisheye"),
        ("plumb_bob", [0.0] * 5, "pinhole"),
    ):
        path = write_rgbd(tmp_path / f"{model}{D[0]}.bag", kind, D=D, model=model)
        lens = opened(path).camera.lens
        assert lens.model == expected and lens.coefficients == (tuple(D) if expected != "pinhole" else ())
    path = write_rgbd(tmp_path / "odd.bag", kind, D=[0.1] * 5, model="omnidirectional")
    with pytest.raises(MiniloopError, match="distortion_model is 'omnidirectional'"):
        opened(path)


def test_a_camera_that_was_not_calibrated(tmp_path):
    path = write_rgbd(tmp_path / "a.bag", K=(0.0,) * 9)
    with pytest.raises(InputError, match="describes a camera without calibration"):
        opened(path)


def test_without_camera_info(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image(COLOR, IMAGE, "rgb8", STAMP)
        bag.image(DEPTH, MM, "16UC1", STAMP)
    with pytest.raises(InputError, match=rf"has no CameraInfo for {COLOR}.*--camera"):
        opened(tmp_path / "a.bag")
    camera = tmp_path / "camera.yaml"
    camera.write_text("fx: 52.5\nfy: 52.5\ncx: 31.5\ncy: 23.5\nwidth: 64\nheight: 48\ndepth_scale: 1000\n")
    assert opened(tmp_path / "a.bag", camera_path=camera).camera.fx == 52.5


T = se3.pose(cv2.Rodrigues(np.array([0.02, -0.01, 0.03]))[0], np.array([0.015, 0.001, -0.002]))
DEPTH_K = (40.0, 0, 30.0, 0, 41.0, 22.0, 0, 0, 1)
PLANE = np.full((40, 60), 1500, np.uint16)


def write_unregistered(path, kind, links, info=True, topic="/tf_static"):
    with BagWriter(path, kind) as bag:
        bag.image(COLOR, IMAGE, "rgb8", STAMP)
        bag.image("/camera/depth/image_rect_raw", PLANE, "16UC1", STAMP, "depth_frame")
        bag.info(INFO, STAMP)
        if info:
            bag.info("/camera/depth/camera_info", STAMP, (60, 40), DEPTH_K, frame="depth_frame")
        for link in links:
            bag.tf([link], STAMP, topic)
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_depth_of_another_camera_is_registered_over_tf(tmp_path, kind):
    base = se3.pose(cv2.Rodrigues(np.array([1.0, 0.5, 0.2]))[0], np.array([0.3, 0.2, 0.1]))
    links = [("/link", OPTICAL, base), ("link", "depth_frame", base @ T)]
    sequence = opened(write_unregistered(tmp_path / "a.bag", kind, links))
    own = sequence.depth_camera
    np.testing.assert_allclose(own.T_color_depth, T, atol=1e-12)
    assert (own.camera.fx, own.camera.width) == (40.0, 60)
    scan = read_scan(sequence, 0)
    expected = register_depth(PLANE.astype(np.float32) / 1000, own.camera, sequence.camera, T)
    np.testing.assert_allclose(scan.depth_m, expected, atol=1e-6)
    # A plane across the depth camera's axis, in the colour camera: n . p = d with n = R e_z, d = 1.5 + n . t.
    normal = T[:3, 2]
    v, u = np.nonzero(scan.depth_m)
    p = sequence.camera.backproject(np.stack([u, v], 1).astype(float), scan.depth_m[v, u].astype(float))
    np.testing.assert_allclose(p @ normal, 1.5 + normal @ T[:3, 3], atol=1e-6)
    assert len(v) > 1500
    assert "is registered to colour by /camera/depth/camera_info and tf (15.2 mm apart)" in notes(sequence)


def test_what_registration_lacks_is_named(tmp_path):
    with pytest.raises(InputError, match=f"lacks a static transform from depth_frame to {OPTICAL}"):
        opened(write_unregistered(tmp_path / "a.bag", "ros1", [("link", OPTICAL, np.eye(4))]))
    with pytest.raises(InputError, match=r"lacks the CameraInfo of depth .* and a static transform"):
        opened(write_unregistered(tmp_path / "b.bag", "ros1", [], info=False))
    moving = [(OPTICAL, "depth_frame", T), (OPTICAL, "depth_frame", se3.inverse(T))]
    with pytest.raises(InputError, match="lacks a static transform"):
        opened(write_unregistered(tmp_path / "c.bag", "ros1", moving, topic="/tf"))
    still = [(OPTICAL, "depth_frame", T)] * 2
    assert opened(write_unregistered(tmp_path / "d.bag", "ros1", still, topic="/tf")).depth_camera is not None


def test_one_frame_with_other_intrinsics_is_registered_too(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image(COLOR, IMAGE, "rgb8", STAMP)
        bag.image("/camera/depth/image_raw", PLANE, "16UC1", STAMP)
        bag.info(INFO, STAMP)
        bag.info("/camera/depth/camera_info", STAMP, (60, 40), DEPTH_K)
    sequence = opened(tmp_path / "a.bag")
    assert np.array_equal(sequence.depth_camera.T_color_depth, np.eye(4))
    depth_m = read_scan(sequence, 0).depth_m
    assert (np.abs(depth_m[depth_m > 0] - 1.5) < 1e-6).all() and (depth_m > 0).mean() > 0.4


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_bag_that_was_cut_off_opens_as_far_as_it_goes(tmp_path, kind):
    big = [(t, np.repeat(np.repeat(c, 8, 0), 8, 1), np.repeat(np.repeat(d, 8, 0), 8, 1)) for t, c, d in noise(frames=8)]
    K8 = [8 * value for value in K[:8]] + [1.0]
    path = write_rgbd(tmp_path / "a.bag", kind, frames=big, size=(512, 384), K=K8)
    whole = _file(path).read_bytes()
    cut = tmp_path / f"cut{_file(path).suffix}"
    cut.write_bytes(whole[: len(whole) // 2])
    sequence = opened(cut)
    assert 2 <= len(sequence.frames) <= 4
    assert np.array_equal(read_scan(sequence, 1).color, big[1][1])
    note = next(note for note in sequence.notes if "was cut off or is damaged at byte" in str(note))
    assert note.kind == NoteKind.DROPPED


def test_files_that_are_none(tmp_path):
    for name, content, said in (
        ("a.bag", b"", "empty"),
        ("b.bag", b"#ROSBAG V1.2\n" + bytes(90), "format other than 2.0"),
        ("c.mcap", b"\x89MCAP0\r\n", "no topic of depth images"),
        ("d.db3", b"SQLite format 3\0" + bytes(500), "a damaged ROS 2 bag"),
        ("e.bag", bytes(1000), "neither a ROS bag nor an MCAP file"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=said) as error:
            opened(tmp_path / name)
        assert name in str(error.value)


def test_a_bag_without_images_says_what_it_holds(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.tf([("a", "b", np.eye(4))], 1.0)
    with pytest.raises(InputError, match=r"depth images; its topics: /tf_static \(tf2_msgs/msg/TFMessage, 1\)"):
        opened(tmp_path / "a.bag")


def test_a_compressed_bag_names_the_wheel_that_is_missing(tmp_path, monkeypatch):
    path = write_rgbd(tmp_path / "a.bag", "ros1", "lz4")
    monkeypatch.setitem(__import__("sys").modules, "lz4.frame", None)
    monkeypatch.setitem(__import__("sys").modules, "lz4", None)
    with pytest.raises(InputError, match=r"pip install 'miniloop\[bags\]'"):
        opened(path)


def test_files_of_a_folder_that_are_compressed_or_missing(tmp_path):
    path = write_rgbd(tmp_path / "a", "sqlite3", "file")
    with pytest.raises(InputError, match="compressed as a whole"):
        opened(path)
    path = write_rgbd(tmp_path / "b", "mcap")
    _file(path).rename(path / "other.mcap")
    with pytest.raises(InputError, match=r"metadata.yaml names b.mcap, which does not exist"):
        opened(path)
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: [1]")
    with pytest.raises(InputError, match=r"metadata\.yaml does not describe a ROS 2 bag"):
        opened(path)
    (path / "metadata.yaml").unlink()
    assert len(opened(path).frames) == 5


def test_chunks_that_expand_beyond_reason_are_not_decompressed(tmp_path, monkeypatch):
    path = write_rgbd(tmp_path / "a.bag", "ros1", "bz2")
    monkeypatch.setattr(bag_module, "MAX_CHUNK_BYTES", 1000)
    with pytest.raises(InputError, match="more than the 0 MB allowed"):
        opened(path)


def test_the_index_is_that_of_rosbags(tmp_path):
    """Every message of a bag with other types too, byte by byte, as rosbags reads it."""
    from rosbags.rosbag1 import Reader

    path = write_unregistered(tmp_path / "a.bag", "ros1", [("a", "b", T)] * 3)
    with Reader(path) as reader:
        expected = sorted((c.topic, time, bytes(data)) for c, time, data in reader.messages())
    bag = open_bag(path)
    assert expected == sorted((t.name, p.time_ns, bag.read(p)) for t in bag.topics.values() for p in t.places)
