"""Images of ROS messages as arrays: raw by their encoding, JPEG and PNG, and the transport compressedDepth.

Encodings: sensor_msgs/image_encodings; depth by REP 118 (16UC1 in millimetres, 32FC1 in metres).
"""

from __future__ import annotations

import io
import re
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.bags.wire import ImageHead
from miniloop_cli.datasets.images import MAX_PIXELS, decode, read_header
from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageHeader

PNG = b"\x89PNG"
QUANTISED_HEADER = struct.Struct("<iff")  # of compressedDepth: format, quantisation parameters A and B


class Encoding(NamedTuple):
    """An encoding of raw images: type and channels as stored, how OpenCV converts them to RGB, if it must."""

    dtype: str
    channels: int
    convert: str | None = None
    order: tuple[int, ...] | None = None


# OpenCV names a Bayer pattern by its second row and column, ROS by its first.
ENCODINGS = {
    "rgb8": Encoding("u1", 3),
    "bgr8": Encoding("u1", 3, order=(2, 1, 0)),
    "rgba8": Encoding("u1", 4, order=(0, 1, 2)),
    "bgra8": Encoding("u1", 4, order=(2, 1, 0)),
    "rgb16": Encoding("u2", 3),
    "bgr16": Encoding("u2", 3, order=(2, 1, 0)),
    "mono8": Encoding("u1", 1),
    "8UC1": Encoding("u1", 1),
    "mono16": Encoding("u2", 1),
    "16UC1": Encoding("u2", 1),
    "32FC1": Encoding("f4", 1),
    "yuv422": Encoding("u1", 2, "COLOR_YUV2RGB_UYVY"),
    "uyvy": Encoding("u1", 2, "COLOR_YUV2RGB_UYVY"),
    "UYVY": Encoding("u1", 2, "COLOR_YUV2RGB_UYVY"),
    "yuv422_yuy2": Encoding("u1", 2, "COLOR_YUV2RGB_YUY2"),
    "yuyv": Encoding("u1", 2, "COLOR_YUV2RGB_YUY2"),
    "YUYV": Encoding("u1", 2, "COLOR_YUV2RGB_YUY2"),
    "bayer_rggb8": Encoding("u1", 1, "COLOR_BayerBG2RGB"),
    "bayer_bggr8": Encoding("u1", 1, "COLOR_BayerRG2RGB"),
    "bayer_gbrg8": Encoding("u1", 1, "COLOR_BayerGR2RGB"),
    "bayer_grbg8": Encoding("u1", 1, "COLOR_BayerGB2RGB"),
}
DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1")
GREY_ENCODINGS = ("mono8", "8UC1")
_COMPRESSED = re.compile(r"\s*(?:(?P<encoding>\w+)\s*;)?\s*(?P<how>.*?)\s*")


def compressed_format(text: str, topic: str) -> tuple[str, str]:
    """The encoding that a CompressedImage had ("" where it does not say) and how it is compressed.

    The latter is `image` (JPEG or PNG), `depth` (compressedDepth), or the name of an unsupported compression.
    """
    match = _COMPRESSED.fullmatch(text)
    encoding, how = (match["encoding"] or "", match["how"]) if match else ("", text)
    if "compressedDepth" in how or topic.endswith("/compressedDepth"):
        return encoding, "depth" if "rvl" not in how.lower() else "compressedDepth RVL"
    if not how or re.match(r"(jpe?g|png)\b", how, re.IGNORECASE):
        return encoding, "image"
    return encoding, how[:40]


def raw_header(head: ImageHead) -> ImageHeader:
    """Size and type of a raw image. Raises InputError (reason only) for unsupported encodings and sizes."""
    kind = ENCODINGS.get(head.encoding)
    if kind is None:
        raise InputError(f"the encoding '{head.encoding[:40]}' is not supported")
    if not 0 < head.width * head.height <= MAX_PIXELS:
        raise InputError(f"{head.width} x {head.height} pixels are not allowed")
    bits = 8 * np.dtype(kind.dtype).itemsize
    channels = 3 if kind.convert or kind.order else kind.channels
    return ImageHeader(head.width, head.height, bits, channels, f"{head.encoding} image")


def raw_pixels(head: ImageHead, data: bytes) -> NDArray[Any]:
    """(h, w, 3) RGB, or (h, w), as stored. Raises InputError (reason only)."""
    import cv2

    raw_header(head)
    kind = ENCODINGS[head.encoding]
    dtype = np.dtype((">" if head.big_endian else "<") + kind.dtype)
    row = head.width * kind.channels * dtype.itemsize
    if head.step < row or len(data) < head.step * (head.height - 1) + row:
        raise InputError(f"{len(data)} bytes are too few for a {raw_header(head)}")
    rows = np.ndarray((head.height, row), np.uint8, data, strides=(head.step, 1))
    pixels = np.ascontiguousarray(rows).view(dtype).reshape(head.height, head.width, kind.channels)
    pixels = pixels.astype(dtype.newbyteorder("="), copy=False)
    if kind.convert:
        if min(head.width, head.height) < 2 or (kind.channels == 2 and head.width % 2):
            raise InputError(f"{head.width} x {head.height} is not a possible size of {head.encoding}")
        return np.asarray(cv2.cvtColor(pixels, getattr(cv2, kind.convert)))
    if kind.order:
        return np.ascontiguousarray(pixels[..., kind.order])
    return pixels[..., 0] if kind.channels == 1 else pixels


def compressed_header(head: ImageHead, topic: str, data: bytes) -> ImageHeader:
    """Size and type of a compressed image. Raises InputError (reason only)."""
    encoding, how = compressed_format(head.encoding, topic)
    if how == "depth":
        found = read_header(io.BytesIO(_png_of_depth(data)))
        return ImageHeader(found.width, found.height, 32 if encoding == "32FC1" else found.bits, 1, "compressedDepth")
    if how != "image":
        raise InputError(f"compressed as '{how}', which is not known here")
    return read_header(io.BytesIO(data))


def compressed_pixels(head: ImageHead, topic: str, data: bytes) -> NDArray[Any]:
    """The pixels (h, w) or (h, w, 3) of a CompressedImage; quantised depth as float32 metres, 0 = no reading.

    Raises InputError (reason only).
    """
    encoding, how = compressed_format(head.encoding, topic)
    if how == "image":
        return decode(data)
    if how != "depth":
        raise InputError(f"compressed as '{how}', which is not known here")
    stored = decode(_png_of_depth(data))
    if stored.ndim != 2:
        raise InputError("compressedDepth has several channels, expected one")
    if encoding == "16UC1" and stored.dtype == np.uint16:
        return stored
    if encoding != "32FC1" or stored.dtype != np.uint16:
        raise InputError(f"compressedDepth of '{encoding[:20]}' in {8 * stored.dtype.itemsize} bits is not supported")
    _, A, B = QUANTISED_HEADER.unpack_from(data)
    if not (np.isfinite([A, B]).all() and A > 0):
        raise InputError(f"compressedDepth has an impossible quantisation: {A:g}, {B:g}")
    with np.errstate(divide="ignore"):
        depth_m = np.float32(A) / (stored.astype(np.float32) - np.float32(B))
    return np.where((stored > 0) & np.isfinite(depth_m) & (depth_m > 0), depth_m, np.float32(0))


def _png_of_depth(data: bytes) -> bytes:
    if data[QUANTISED_HEADER.size :][: len(PNG)] != PNG:
        raise InputError("no PNG after the header of compressedDepth")
    return data[QUANTISED_HEADER.size :]
