"""What lies beside the images is used or named, and what no layout reads is told how to convert."""

import json
import struct
import zipfile

import cv2
import numpy as np
import pytest
from tiny_recordings import CAMERA

from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.datasets.foreign import FILES, FOLDERS
from miniloop_cli.datasets.read import check_headers
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import NoteKind

WIDTH, HEIGHT = 96, 72


def said(sequence, *kinds):
    return [str(note) for note in sequence.notes if note.kind in kinds]


@pytest.mark.parametrize("name", sorted(FILES))
def test_files_of_other_tools_are_known(tmp_path, name):
    (tmp_path / f"scan{name.upper()}").write_bytes(b"\0" * 100)
    with pytest.raises(InputError, match=r"is an? ") as error:
        open_sequence(tmp_path / f"scan{name.upper()}")
    assert FILES[name] in str(error.value)


@pytest.mark.parametrize(("names", "words"), FOLDERS)
def test_folders_of_other_tools_are_known(tmp_path, names, words):
    for name in names:
        (tmp_path / name).mkdir() if "." not in name else (tmp_path / name).touch()
    with pytest.raises(InputError) as error:
        open_sequence(tmp_path)
    assert words in str(error.value)


def test_a_folder_with_a_bag_in_it_is_known(tmp_path):
    (tmp_path / "2024-05-01.bag").touch()
    with pytest.raises(InputError, match=r"holds 2024-05-01\.bag: give that file itself"):
        open_sequence(tmp_path)
    with zipfile.ZipFile(tmp_path / "scan.zip", "w") as archive:
        archive.writestr("scan/2024-05-01.bag", b"")
    with pytest.raises(InputError, match=r"holds 2024-05-01\.bag: unpack it, then give that file itself"):
        open_sequence(tmp_path / "scan.zip")


def test_data_sets_without_their_cameras_take_a_given_one(tiny):
    for k in range(4):
        tiny.color(f"lowres_wide/41069021_{6102.175 + k / 10:.3f}.png")
        tiny.depth(f"lowres_depth/41069021_{6102.178 + k / 10:.3f}.png")
    with pytest.raises(InputError, match="lowres_wide_intrinsics"):
        open_sequence(tiny.root)
    tiny.text("camera.yaml", CAMERA)
    assert [f.timestamp_s for f in open_sequence(tiny.root).frames] == pytest.approx(
        [6102.175 + k / 10 for k in range(4)]
    )


@pytest.mark.parametrize(
    "name", ["calibration.txt", "transforms.json", "calib/kinect.yaml", "camera_info.yaml", "K.txt"]
)
@pytest.mark.parametrize("folder", ["rgb", "color"])
def test_a_camera_file_beside_a_guessed_camera_is_named(tiny, name, folder):
    for k in range(2):
        tiny.color(f"{folder}/{10 + k / 10:.6f}.png", 640, 480)
        tiny.depth(f"depth/{10 + k / 10:.6f}.png", 640, 480)
    tiny.text(name, "517.3 516.5 318.6 255.3 0.0\n")
    words = f"{name.split('/')[0]}{'/' * ('/' in name)} seems to describe the camera and is not read"
    assert [words in note for note in said(open_sequence(tiny.root), NoteKind.ASSUMED)].count(True) == 1
    tiny.text("camera.yaml", CAMERA.replace("64", "640").replace("48", "480"))
    assert any(words in note for note in said(open_sequence(tiny.root), NoteKind.UNUSED))
    given = open_sequence(tiny.root, camera_path=tiny.root / "camera.yaml")
    assert not any("describe the camera" in str(note) for note in given.notes)


def test_confidence_and_associations_are_named(tum):
    tum.depth("confidence/10.000000.png")
    tum.text("associations.txt", "10.0 rgb/10.000000.png 10.005 depth/10.005000.png\n")
    assert said(open_sequence(tum.root), NoteKind.UNUSED) == [
        "associations.txt is not used: rgb.txt and depth.txt name all images",
        "confidence/ is not used: depth of low confidence is kept",
    ]


def pattern(k, camera):
    """What a camera (fx fy cx cy) at rest sees of a smooth picture on a slanted wall: (h, w, 3) and depth in mm."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    X, Y = (x - camera[2]) / camera[0], (y - camera[3]) / camera[1]
    color = 128 + 60 * np.stack([np.sin(14 * X + k), np.cos(11 * Y), np.sin(9 * (X + Y))], axis=2)
    return np.round(color).astype(np.uint8), np.round(2000 / (1 - 0.3 * X)).astype(np.uint16)


def record3d(tiny, zoom, **metadata):
    cameras = [[90 * z, 91 * z, 47.5 + 3 * (z - 1), 35.5 - 4 * (z - 1)] for z in zoom]
    for k, camera in enumerate(cameras):
        color, depth = pattern(k, camera)
        tiny.put(f"rgb/{k}.png", color[..., ::-1])
        tiny.put(f"depth/{k}.png", depth)
    K = [cameras[0][0], 0, 0, 0, cameras[0][1], 0, cameras[0][2], cameras[0][3], 1]
    data = {"w": WIDTH, "h": HEIGHT, "fps": 15, "K": K, "perFrameIntrinsicCoeffs": cameras} | metadata
    tiny.text("metadata.json", json.dumps(data))
    return cameras


def test_every_frame_is_read_as_one_camera_sees_it(tiny):
    cameras = record3d(tiny, [1.0, 1.02, 1.04, 1.06, 1.08])
    sequence = open_sequence(tiny.root)
    camera = sequence.camera
    assert [camera.fx, camera.fy, camera.cx, camera.cy] == pytest.approx(cameras[2])
    assert sequence.frames[2].camera is None and sequence.frames[0].camera.fx == pytest.approx(90)
    for k in range(5):
        scan = read_scan(sequence, k)
        check_headers(sequence, k)
        color, depth = pattern(k, cameras[2])
        seen = np.ones((HEIGHT, WIDTH), bool) if scan.mask is None else ~scan.mask
        assert seen.mean() > 0.9 and (scan.depth_m[~seen] == 0).all()
        assert np.abs(scan.color.astype(int) - color)[seen].max() <= 4
        assert np.abs(scan.depth_m[seen] * 1000 - depth[seen]).max() <= 8  # nearest pixel of a slanted wall
    assert any("varies by up to 3.8 % from its median: 4 of 5" in note for note in said(sequence, NoteKind.CONVERTED))


def test_times_of_the_metadata_are_used(tiny):
    times = [100.0, 100.1, 100.25, 100.4]
    record3d(tiny, [1, 1, 1, 1], frameTimestamps=times)
    sequence = open_sequence(tiny.root)
    assert [f.timestamp_s for f in sequence.frames] == times and all(f.camera is None for f in sequence.frames)
    record3d(tiny, [1, 1, 1, 1], frameTimestamps=times[:3])
    sequence = open_sequence(tiny.root)
    assert [f.timestamp_s for f in sequence.frames] == pytest.approx([k / 15 for k in range(4)])
    assert any("frameTimestamps has 3 times, too few" in note for note in said(sequence, NoteKind.DROPPED))


def test_intrinsics_of_other_images_are_refused(tiny):
    record3d(tiny, [1, 1], perFrameIntrinsicCoeffs=[[900, 900, 400, 300]] * 2)
    with pytest.raises(InputError, match=r"metadata\.json: perFrameIntrinsicCoeffs .* do not fit K"):
        open_sequence(tiny.root)


def turned_jpeg(tiny, name, image, orientation):
    """A JPEG file with an EXIF orientation."""
    data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    app1 = b"Exif\0\0MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    path = tiny.text(name, "")
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(app1) + 2) + app1 + data[2:])


STORED = {3: lambda a: a[::-1, ::-1], 6: lambda a: np.rot90(a, 1), 8: lambda a: np.rot90(a, -1)}


@pytest.mark.parametrize("orientation", [6, 8])
def test_colour_is_turned_where_depth_is_upright(tiny, orientation):
    color, _ = pattern(0, [60, 60, 47.5, 35.5])
    for k in range(2):
        turned_jpeg(tiny, f"rgb/{k}.jpg", STORED[orientation](color), orientation)
        tiny.depth(f"depth/{k}.png", WIDTH, HEIGHT)
    tiny.text("camera.yaml", CAMERA.replace("64", str(WIDTH)).replace("48", str(HEIGHT)))
    sequence = open_sequence(tiny.root)
    check_headers(sequence, 0)
    assert np.abs(read_scan(sequence, 0).color.astype(int) - color).mean() < 2
    assert any("colour is rotated by its EXIF orientation" in note for note in said(sequence, NoteKind.CONVERTED))


@pytest.mark.parametrize(("orientation", "size"), [(6, (WIDTH, HEIGHT)), (3, (WIDTH, HEIGHT))])
def test_an_orientation_that_depth_does_not_share_is_left_and_said(tiny, orientation, size):
    color, _ = pattern(0, [60, 60, 47.5, 35.5])
    for k in range(2):
        turned_jpeg(tiny, f"rgb/{k}.jpg", color, orientation)
        tiny.depth(f"depth/{k}.png", *size)
    tiny.text("camera.yaml", CAMERA.replace("64", str(WIDTH)).replace("48", str(HEIGHT)))
    sequence = open_sequence(tiny.root)
    assert np.abs(read_scan(sequence, 0).color.astype(int) - color).mean() < 2
    assert any(f"EXIF orientation ({orientation}) is not applied" in note for note in said(sequence, NoteKind.ASSUMED))
