"""What depth values mean: other marks of "no reading" than 0, floating-point depth, an assumed scale."""

import re

import numpy as np
import pytest
from tiny_recordings import CAMERA, Tiny, write_exr

from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.datasets.depth_values import no_readings
from miniloop_cli.datasets.read import check_headers
from miniloop_cli.datasets.sensor_steps import KINECT_STEP_PER_M
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import NoteKind

FRAMES = 6


def scene(rng, k):
    """(48, 64) depth of a wall and a box in units of 1 / 5000 m, of a moving camera; 12 % without reading."""
    z = 9000 + 40 * k + np.arange(64) * 20 + rng.normal(0, 15, (48, 64))
    z[10:30, 20:40] = 5000 - 30 * k + rng.normal(0, 8, (20, 20))
    z[:, :8] = 0
    return np.round(z).astype(np.uint16)


def recording(tiny: Tiny, change, suffix=".png"):
    rng = np.random.default_rng(1)
    for k in range(FRAMES):
        tiny.color(f"rgb/{10 + k / 10:.6f}.png")
        depth = change(scene(rng, k))
        path = tiny.root / f"depth/{10 + k / 10:.6f}{suffix}"
        path.parent.mkdir(exist_ok=True)
        if suffix == ".npy":
            np.save(path, depth)
        elif suffix == ".exr":
            write_exr(path, Z=depth)
        elif suffix == ".npz":
            np.savez_compressed(path, depth=depth)
        else:
            tiny.put(str(path.relative_to(tiny.root)), depth)
    tiny.text("camera.yaml", CAMERA)
    return open_sequence(tiny.root)


def doubts(sequence):
    return [str(note) for note in sequence.notes if note.doubtful]


def marked(value):
    return lambda z: np.where(z == 0, value, z).astype(np.uint16)


@pytest.mark.parametrize("value", [65535, 39990, 20000, 32767, 50000, 1, 100])
def test_a_value_for_no_reading_is_found_and_kept_out(tiny, value):
    plain = recording(Tiny(tiny.root / "plain"), lambda z: z)
    sequence = recording(Tiny(tiny.root / "marked"), marked(value))
    assert sequence.depth_format.no_reading == (value,) and sequence.depth_format.no_reading_found
    assert [f"depth {value} ({value / 5000:.2f} m) is read as missing depth: 12 %" in n for n in doubts(sequence)] == [
        True
    ]
    for k in range(FRAMES):
        np.testing.assert_array_equal(read_scan(sequence, k).depth_m, read_scan(plain, k).depth_m)
    assert plain.depth_format.no_reading == () and doubts(plain) == []


def test_two_values_for_no_reading(tiny):
    def both(z):
        z = marked(65535)(z)
        z[:6] = 30000
        return z

    assert sorted(recording(tiny, both).depth_format.no_reading) == [30000, 65535]


def test_surfaces_are_no_missing_readings():
    rng = np.random.default_rng(0)
    wall = [np.full((48, 64), 9000, np.uint16) for _ in range(5)]  # a plain wall, seen square on
    assert no_readings(wall) == []
    steps = 2880 / np.round(2880 / (9000 + rng.normal(0, 900, (5, 48, 64))) * 60) * 60  # a Kinect's
    assert no_readings(list(np.round(steps).astype(np.uint16))) == []
    assert no_readings([scene(rng, k) for k in range(5)]) == []
    moving = [np.where(scene(rng, k) > 9500, 20000 + 700 * k, scene(rng, k)).astype(np.uint16) for k in range(5)]
    assert no_readings(moving) == []  # a far wall comes nearer
    assert no_readings([np.zeros((48, 64), np.uint16)]) == [] and no_readings([]) == []


@pytest.mark.parametrize("suffix", [".tiff", ".npy", ".npz", ".exr"])
@pytest.mark.parametrize(("unit", "name"), [(1.0, "metres"), (1000.0, "millimetres")])
@pytest.mark.parametrize("missing", [0.0, np.nan, -1.0, np.inf, 10_000.0])
def test_floating_point_depth(tiny, suffix, unit, name, missing):
    plain = recording(Tiny(tiny.root / "plain"), lambda z: z)
    sequence = recording(
        Tiny(tiny.root / "float"),
        lambda z: np.where(z == 0, missing * unit if missing == 10_000 else missing, z / 5000 * unit).astype(
            np.float32
        ),
        suffix,
    )
    assert f"read as {name}; the camera's depth_scale 5000 is for whole numbers" in doubts(sequence)[0]
    for k in range(FRAMES):
        check_headers(sequence, k)
        np.testing.assert_allclose(read_scan(sequence, k).depth_m, read_scan(plain, k).depth_m, rtol=1e-5)


@pytest.mark.parametrize("suffix", [".tiff", ".pgm", ".npy"])
def test_whole_numbers_in_other_formats(tiny, suffix):
    plain = recording(Tiny(tiny.root / "plain"), lambda z: z)
    sequence = recording(Tiny(tiny.root / "other"), lambda z: z, suffix)
    assert doubts(sequence) == []
    for k in range(FRAMES):
        check_headers(sequence, k)
        np.testing.assert_array_equal(read_scan(sequence, k).depth_m, read_scan(plain, k).depth_m)


def test_floating_point_depth_in_no_unit_is_refused(tiny):
    with pytest.raises(InputError, match=r"a median of 1.*e-07, neither metres nor millimetres"):
        recording(tiny, lambda z: (z / 5e10).astype(np.float32), ".npy")


def test_one_frame_of_another_type_is_named(tiny):
    recording(tiny, lambda z: z)
    tiny.put("depth/10.200000.tiff", np.ones((48, 64), np.float32))
    (tiny.root / "depth/10.200000.png").unlink()
    sequence = open_sequence(tiny.root)
    for look in (read_scan, check_headers):
        with pytest.raises(InputError, match="one channel of 16 bits, this is a 32-bit 1-channel TIFF"):
            look(sequence, 2)


@pytest.mark.parametrize(
    ("folder", "change", "words"),
    [
        (
            "rgb",
            lambda z: z,
            "depth_scale 5000 units a metre is assumed, as no file states it: the median depth is 1.9",
        ),
        (
            "rgb",
            lambda z: (z // 10).astype(np.uint16),
            "unusual for such sensors, at 1000 units a metre it would be 0.97 m",
        ),
        ("color", lambda z: (z // 10).astype(np.uint16), "depth_scale 1000 units a metre is assumed"),
        ("color", lambda z: (z // 5 * 5).astype(np.uint16), "all values are multiples of 5, as in depth of TUM's 5000"),
    ],
)
def test_an_assumed_scale_is_called_so_and_checked(tiny, folder, change, words):
    rng = np.random.default_rng(1)
    for k in range(3):
        tiny.color(f"{folder}/{10 + k / 10:.6f}.png", 640, 480)
        depth = change(np.kron(scene(rng, k), np.ones((10, 10), np.uint16)))
        tiny.put(f"depth/{10 + k / 10:.6f}.png", depth)
    sequence = open_sequence(tiny.root)
    assert [words in note for note in doubts(sequence)] == [True]
    tiny.text("camera.yaml", "fx: 525\nfy: 525\ncx: 319\ncy: 239\nwidth: 640\nheight: 480\ndepth_scale: 5000\n")
    assert doubts(open_sequence(tiny.root)) == []


def test_a_size_that_only_one_sensor_has_contradicts_an_assumed_scale(tiny):
    rng = np.random.default_rng(1)
    for k in range(3):
        tiny.color(f"rgb/{10 + k / 10:.6f}.png", 512, 424)
        tiny.put(f"depth/{10 + k / 10:.6f}.png", rng.integers(2000, 8000, (424, 512)).astype(np.uint16))
    size = "image_width: 512\nimage_height: 424\n"
    matrix = "camera_matrix: {rows: 3, cols: 3, data: [365, 0, 255, 0, 365, 211, 0, 0, 1]}\n"
    lens = "distortion_model: plumb_bob\ndistortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    tiny.text("camera.yaml", size + matrix + lens)
    notes = [note for note in open_sequence(tiny.root).notes if note.kind == NoteKind.CONTRADICTED]
    told = "512 x 424 is the size of depth images of a Kinect v2, which stores millimetres"
    assert [told in note.text for note in notes] == [True]


@pytest.mark.parametrize(
    ("fx", "step", "told"),
    [
        (615, 1, "fx = 615 at 640 x 480 is the focal length of a RealSense D415 or D435, which stores millimetres"),
        (385, 1, "fx = 385 at 640 x 480 is the focal length of a RealSense D455, which stores millimetres"),
        (615, 5, None),  # millimetres that were converted to TUM's unit
        (525, 1, None),
        (577, 1, None),
    ],
)
def test_the_focal_length_of_a_known_sensor_contradicts_an_assumed_scale(tiny, fx, step, told):
    rng = np.random.default_rng(1)
    for k in range(3):
        tiny.color(f"rgb/{10 + k / 10:.6f}.png", 640, 480)
        tiny.put(f"depth/{10 + k / 10:.6f}.png", (step * rng.integers(1600, 3000, (480, 640))).astype(np.uint16))
    lens = "distortion_model: plumb_bob\ndistortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    matrix = f"camera_matrix: {{rows: 3, cols: 3, data: [{fx}, 0, 320, 0, {fx}, 240, 0, 0, 1]}}\n"
    tiny.text("camera.yaml", "image_width: 640\nimage_height: 480\n" + matrix + lens)
    notes = [note for note in open_sequence(tiny.root).notes if "depth_scale 5000" in note.text]
    assert [note.kind for note in notes] == [NoteKind.CONTRADICTED if told else NoteKind.ASSUMED]
    assert told is None or told in notes[0].text


@pytest.mark.parametrize(
    ("folder", "stored", "right"), [("color", 5000, 5000), ("rgb", 1000, 1000), ("rgb", 5000, None)]
)
def test_the_steps_of_a_structured_light_sensor_contradict_an_assumed_scale(tiny, folder, stored, right):
    rng = np.random.default_rng(1)
    for k in range(4):
        tiny.color(f"{folder}/{10 + k / 10:.6f}.png", 640, 480)
        z_m = 1 / (KINECT_STEP_PER_M * np.round(1 / (KINECT_STEP_PER_M * rng.uniform(0.8, 3, (480, 640)))))
        tiny.put(f"depth/{10 + k / 10:.6f}.png", np.round(stored * z_m).astype(np.uint16))
    (note,) = doubts(open_sequence(tiny.root))
    said = re.search(r"its steps are those of a Kinect or Xtion at about (\d+) units a metre", note)
    assert (float(said[1]) == pytest.approx(right, rel=0.02)) if right else said is None
