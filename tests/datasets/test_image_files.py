"""Broken, wrong and oversized images: refused with frame, file and reason, before they are decoded."""

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image

from miniloop_cli.datasets import ImageFile, open_sequence, read_color, read_depth, read_scan
from miniloop_cli.datasets.images import MAX_PIXELS
from miniloop_cli.errors import InputError

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def claimed_png(width: int, height: int, bits: int = 8, color_type: int = 2) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, bits, color_type, 0, 0, 0)
    return PNG_MAGIC + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")


def gray(dtype: type, height: int = 48, width: int = 64) -> np.ndarray:
    return np.full((height, width), 200, dtype)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (gray(np.uint8), "depth must have one channel of 16 bits, this is a 8-bit 1-channel PNG of 64 x 48"),
        (np.zeros((48, 64, 3), np.uint16), "this is a 16-bit 3-channel PNG"),
        (np.zeros((48, 64, 4), np.uint8), "this is a 8-bit 4-channel PNG"),
        (gray(np.uint16, 24, 32), "depth is 32 x 24, colour 64 x 48"),
    ],
)
def test_wrong_depth_is_refused(tum, image, words):
    tum.put("depth/10.205000.png", image)
    sequence = open_sequence(tum.root)
    with pytest.raises(InputError, match=rf"frame 2 \(depth/10\.205000\.png\): .*{words}"):
        read_scan(sequence, 2)
    assert read_scan(sequence, 3).depth_m.shape == (48, 64)


def test_float_depth_and_jpeg_depth_are_refused(tum):
    path = tum.root / "depth/10.005000.png"
    path.write_bytes(cv2.imencode(".tiff", np.ones((48, 64), np.float32))[1])
    with pytest.raises(InputError, match="one channel of 16 bits, this is a 32-bit 1-channel TIFF"):
        read_scan(open_sequence(tum.root), 0)
    path.write_bytes(cv2.imencode(".jpg", gray(np.uint8))[1])
    with pytest.raises(InputError, match="this is a 8-bit 1-channel JPEG"):
        read_scan(open_sequence(tum.root), 0)


def test_missing_and_empty_images_are_named(tum):
    (tum.root / "rgb/10.100000.png").unlink()
    (tum.root / "depth/10.305000.png").write_bytes(b"")
    sequence = open_sequence(tum.root)
    with pytest.raises(InputError, match=r"frame 1 \(rgb/10\.100000\.png\): .*does not exist"):
        read_scan(sequence, 1)
    with pytest.raises(InputError, match=r"frame 3 \(depth/10\.305000\.png\): empty file"):
        read_scan(sequence, 3)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_every_truncation_is_noticed(tiny, suffix):
    path = tiny.put(f"a{suffix}", tiny.rng.integers(0, 255, (48, 64, 3), np.uint8))
    whole = path.read_bytes()
    assert read_color(ImageFile(path)).shape == (48, 64, 3)
    for length in (*range(0, 60), *range(60, len(whole), 97), len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError):
            read_color(ImageFile(path))


def test_every_flipped_byte_of_a_png_is_noticed_or_harmless(tiny):
    tiny.depth("a.png")
    path = tiny.root / "a.png"
    whole, expected = path.read_bytes(), read_depth(ImageFile(path))
    for position in range(0, len(whole), 31):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x55]) + whole[position + 1 :])
        try:
            np.testing.assert_array_equal(read_depth(ImageFile(path)), expected)
        except InputError:
            continue


def test_size_is_checked_before_decoding(tiny):
    path = tiny.text("huge.png", "")
    path.write_bytes(claimed_png(60_000, 60_000))
    with pytest.raises(InputError, match=f"more than the {MAX_PIXELS // 10**6} megapixels allowed"):
        read_color(ImageFile(path))
    path.write_bytes(claimed_png(2**31 - 1, 2**31 - 1, 16, 0))
    with pytest.raises(InputError, match="megapixels"):
        read_depth(ImageFile(path))
    path.write_bytes(claimed_png(0, 48))
    with pytest.raises(InputError, match="without pixels"):
        ImageFile(path).header()
    path.write_bytes(claimed_png(64, 48))  # a sound file with too little data
    with pytest.raises(InputError, match="cannot be decoded"):
        read_color(ImageFile(path))


def test_exif_orientation_is_left_alone(tiny):
    image = np.zeros((48, 64, 3), np.uint8)
    data = cv2.imencode(".jpg", image)[1].tobytes()
    tiff = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)  # orientation 6: turned by 90 degrees
    app1 = b"Exif\0\0" + tiff
    path = tiny.text("turned.jpg", "")
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(app1) + 2) + app1 + data[2:])
    assert read_color(ImageFile(path)).shape == (48, 64, 3)
    assert (ImageFile(path).header().width, ImageFile(path).header().height) == (64, 48)


def test_gray_alpha_and_16_bit_colour_are_read_as_rgb(tiny):
    for image in (gray(np.uint8), np.full((48, 64, 4), 200, np.uint8), np.full((48, 64, 3), 200 * 257, np.uint16)):
        path = tiny.put("a.png", image)
        np.testing.assert_array_equal(read_color(ImageFile(path)), np.full((48, 64, 3), 200, np.uint8))


def encoded(image: np.ndarray, mode: str | None = None, form: str = "PNG", **options) -> bytes:
    """The file that Pillow makes of an image."""
    file = io.BytesIO()
    Image.fromarray(image).convert(mode).save(file, form, **options)
    return file.getvalue()


NOISE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
KINDS = {
    "grey": encoded(NOISE[..., 0]),
    "black and white": encoded(NOISE[..., 0], "1"),
    "grey with alpha": encoded(NOISE, "LA"),
    "colour": encoded(NOISE),
    "colour with alpha": encoded(NOISE, "RGBA"),
    "palette": encoded(NOISE, "P"),
    "palette of 4 bits": encoded(NOISE, "P", bits=4),
    "transparent palette": encoded(NOISE, "P", transparency=bytes(range(200))),
    "transparent colour": encoded(NOISE, transparency=(1, 2, 3)),
    "16-bit grey": cv2.imencode(".png", NOISE[..., 0].astype(np.uint16) * 251)[1].tobytes(),
    "16-bit colour": cv2.imencode(".png", NOISE.astype(np.uint16) * 251)[1].tobytes(),
    "16-bit colour with alpha": cv2.imencode(".png", np.dstack([NOISE, NOISE[..., :1]]).astype(np.uint16) * 251)[1],
    "JPEG": encoded(NOISE, form="JPEG"),
    "coarse JPEG": encoded(NOISE, form="JPEG", quality=40, subsampling=2),
    "progressive JPEG": encoded(NOISE, form="JPEG", progressive=True),
    "grey JPEG": encoded(NOISE[..., 0], form="JPEG"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.filterwarnings("error")
def test_every_kind_of_image_is_read_as_opencv_reads_it(tmp_path, kind):
    data = bytes(KINDS[kind])
    (tmp_path / "a.png").write_bytes(data)
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    assert np.array_equal(read_color(ImageFile(tmp_path / "a.png")), bgr[..., ::-1])


def test_depth_is_exact_to_the_last_bit(tmp_path):
    depth = np.arange(256 * 256, dtype=np.uint16).reshape(256, 256)
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", depth)[1])
    assert np.array_equal(read_depth(ImageFile(tmp_path / "a.png")), depth)


@pytest.mark.parametrize(("width", "height"), [(9500, 9500), (14000, 14000)])
@pytest.mark.filterwarnings("error")
def test_an_image_that_grows_without_measure_is_refused_in_one_line(tmp_path, width, height):
    """Sizes that Pillow itself warns of, and that it refuses."""
    (tmp_path / "a.png").write_bytes(claimed_png(width, height))
    for look in (ImageFile.header, ImageFile.read):
        with pytest.raises(InputError, match=f"{width} x {height} pixels are more than the 40 megapixels allowed"):
            look(ImageFile(tmp_path / "a.png"))


def test_camera_for_other_images_is_refused_at_once(tum):
    tum.text("camera.yaml", "fx: 525\nfy: 525\ncx: 319.5\ncy: 239.5\nwidth: 640\nheight: 480\ndepth_scale: 5000\n")
    with pytest.raises(InputError, match=r"colour is 64 x 48, the camera 640 x 480 .*--camera FILE"):
        open_sequence(tum.root)


def test_one_frame_of_another_size_does_not_stop_the_rest(tum):
    tum.color("rgb/10.000000.png", 32, 24)
    sequence = open_sequence(tum.root)
    with pytest.raises(InputError, match=r"frame 0 \(rgb/10\.000000\.png\): colour is 32 x 24, the camera 64 x 48"):
        read_scan(sequence, 0)
    assert read_scan(sequence, 1).color.shape == (48, 64, 3)
