"""Depth in OpenEXR: which channel it is, and damaged files, with the library itself as the writer."""

import io

import numpy as np
import pytest
from tiny_recordings import write_exr

from miniloop_cli.datasets.images import decode, read_header
from miniloop_cli.errors import InputError

DEPTH = np.random.default_rng(0).uniform(0.5, 4, (6, 8)).astype(np.float32)
COLOUR = np.random.default_rng(1).uniform(0, 1, (6, 8)).astype(np.float32)


@pytest.mark.parametrize(
    "channels",
    [
        {"R": DEPTH},
        {"Z": DEPTH},
        {"layer.Z": DEPTH},
        {"R": COLOUR, "G": COLOUR + 1, "B": COLOUR, "depth": DEPTH},
        {"R": DEPTH, "G": DEPTH, "B": DEPTH},
    ],
)
def test_the_channel_that_is_depth(tmp_path, channels):
    data = write_exr(tmp_path / "a.exr", **channels).read_bytes()
    header = read_header(io.BytesIO(data))
    assert (header.width, header.height, header.bits, header.channels, header.kind) == (8, 6, 32, 1, "EXR")
    np.testing.assert_array_equal(decode(data), DEPTH)


def test_a_window_of_too_many_pixels_is_refused_before_it_is_read(tmp_path):
    data = write_exr(tmp_path / "a.exr", Z=DEPTH).read_bytes()
    at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    wide = data[:at] + np.array([0, 0, 10**5 - 1, 10**5 - 1], "<i4").tobytes() + data[at + 16 :]
    for read in (decode, lambda data: read_header(io.BytesIO(data))):
        with pytest.raises(InputError, match=r"100000 x 100000 pixels are more than the 40 megapixels allowed"):
            read(wide)


def test_half_precision_and_whole_numbers(tmp_path):
    for stored in (DEPTH.astype(np.float16), np.round(1000 * DEPTH).astype(np.uint32)):
        found = decode(write_exr(tmp_path / "a.exr", Z=stored).read_bytes())
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, stored.astype(np.float32))


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ({"R": COLOUR, "G": COLOUR + 1, "B": COLOUR}, "an EXR of colours, not of depth"),
        ({"a": DEPTH, "b": DEPTH}, "the channels a, b: it is not clear which is depth"),
        ({"Z": DEPTH, "V": COLOUR}, "it is not clear which is depth"),
    ],
)
def test_what_is_not_plainly_depth_is_refused(tmp_path, channels, words):
    data = write_exr(tmp_path / "a.exr", **channels).read_bytes()
    with pytest.raises(InputError, match=words):
        decode(data)


def test_damage_is_refused_or_does_not_reach_the_shape(tmp_path, capfd):
    data = write_exr(tmp_path / "a.exr", Z=DEPTH).read_bytes()
    rng = np.random.default_rng(2)
    refused = 0
    for k in range(300):
        damaged = bytearray(data[: rng.integers(4, len(data))] if k % 2 else data)
        for _ in range(3):
            damaged[rng.integers(len(damaged))] = rng.integers(256)
        damaged[:4] = data[:4]
        try:
            assert decode(bytes(damaged)).dtype == np.float32
        except InputError:
            refused += 1
    assert refused > 150
    for size in range(4, len(data), 7):
        with pytest.raises(InputError):
            decode(data[:size])
