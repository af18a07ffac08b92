"""RealSense: intrinsics by the SDK's names (ppx, ppy, coeffs), and what `rs-enumerate-devices -c` prints."""

from __future__ import annotations

import re
from typing import Any

from miniloop_cli.datasets.camera_files.fields import (
    Fields,
    Reading,
    Values,
    choose_by_size,
    fisheye_lens,
    opencv_lens,
)

USED = ("width", "height", "fx", "fy", "ppx", "ppy", "coeffs", "model", "distortion", "distortion_model", "fov_deg")
IGNORED = tuple(
    """
    fov fov_deg hfov vfov format fps stream serial serial_number device_serial device name index
    extrinsics firmware
    """.split()
)
DEPTH = ("depth_scale", "depth_units")
MODELS = ("none", "modifiedbrownconrady", "inversebrownconrady", "ftheta", "brownconrady", "kannalabrandt4")
_HEADER = re.compile(r'\s*Intrinsic of "([^"]{1,40})"')
_SIZE_WORDS = {"ppx": "ppx", "ppy": "ppy", "fx": "fx", "fy": "fy", "width": "width", "height": "height"}


def matches(data: dict) -> bool:
    """By the principal point's name, at the top or a level below."""
    return "ppx" in data or any(isinstance(value, dict) and "ppx" in value for value in data.values())


def read(fields: Fields) -> Reading:
    """The colour camera. Raises ConfigError."""
    if "ppx" in fields:
        return Reading(_intrinsics(fields) | _depth(fields))
    sections = [str(key) for key, value in fields.data.items() if isinstance(value, dict) and "ppx" in value]
    fields.known((*sections, *DEPTH), (*IGNORED, *(k for k in fields.data if isinstance(k, str) and "extrinsic" in k)))
    color = [key for key in sections if re.search("colou?r|rgb", key, re.IGNORECASE)] or sections
    chosen = color[0]
    if len(color) > 1:
        inner = {key: fields.section(key) for key in color}
        sizes = {key: (part.number("width"), part.number("height")) for key, part in inner.items()}
        chosen = choose_by_size(fields, sizes, "cameras")
    return Reading(_intrinsics(fields.section(chosen)) | _depth(fields), f"its {chosen}")


def matches_listing(text: str) -> bool:
    """By the heading of a stream."""
    return any(_HEADER.match(line) for line in text.splitlines())


def read_listing(text: str, where: str, image_size: tuple[int, int] | None) -> Reading:
    """The colour stream of the images' size in a listing of rs-enumerate-devices -c. Raises ConfigError."""
    streams: dict[str, dict[str, Any]] = {}
    current: dict[str, Any] | None = None
    for line in text.splitlines():
        key, colon, value = line.partition(":")
        if header := _HEADER.match(line):
            title = " ".join(line.split("{")[0].split()[2:]).rstrip("/ ")
            # There is one heading for each format, so a size may be repeated.
            current = streams.setdefault(title, {}) if header[1].lower() in ("color", "colour", "rgb") else None
        elif not line.strip():
            current = None
        elif current is not None and colon:
            name = {"Distortion": "model", "FOV (deg)": "fov_deg"}.get(key.strip(), key.strip().lower())
            current[name] = value.strip() if name in ("model", "fov_deg") else _numbers(value)
    if not streams:
        raise Fields({}, where).fault('no intrinsics of "Color" are listed')
    parts = {title: Fields(data, where, image_size, title) for title, data in streams.items()}
    sizes = {title: (part.number("width"), part.number("height")) for title, part in parts.items()}
    title = choose_by_size(Fields({}, where, image_size), sizes, "streams")
    return Reading(_intrinsics(parts[title]), title)


def _numbers(text: str) -> list[float] | float | str:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return text
    return values[0] if len(values) == 1 else values


def _intrinsics(fields: Fields) -> Values:
    fields.known((*USED, *DEPTH), IGNORED)
    values = {"fx": fields.number("fx"), "fy": fields.number("fy")}
    values |= {"cx": fields.number("ppx"), "cy": fields.number("ppy")} | fields.size(("width", "height"))
    k = fields.numbers("coeffs", range(15)) if "coeffs" in fields else []
    model = _model(fields)
    if not any(k) and model != "kannalabrandt4":
        return values | {"lens": "pinhole"}
    if model == "brownconrady" or (model == "modifiedbrownconrady" and not any(k[2:4])):
        return values | opencv_lens(fields, k)
    if model == "kannalabrandt4":
        return values | fisheye_lens(fields, k[:4] if not any(k[4:]) else k)
    # Tools and versions of the SDK disagree on the meaning of the inverse model.
    raise fields.fault(
        f"the lens model '{model or 'that no key names'}' with coefficients other than 0 is not supported; "
        "calibrate the colour camera with OpenCV, ROS or Kalibr"
    )


def _model(fields: Fields) -> str:
    """The name of the lens model in lower case; '' if no key names it."""
    for key in ("model", "distortion_model", "distortion"):
        value = fields.data.get(key)
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < len(MODELS):
            return MODELS[value]
        if isinstance(value, str):
            return re.sub(r"^((pyrealsense2\.|rs\.|rs2_)?distortion[._])?|[ _-]", "", value.strip().lower())
    return ""


def _depth(fields: Fields) -> Values:
    """Units a metre. The SDK's depth scale is metres a unit, which is below 1."""
    for key in DEPTH:
        if key in fields:
            value = fields.number(key)
            return {"depth_scale": 1 / value if 0 < value < 1 else value}
    return {}
