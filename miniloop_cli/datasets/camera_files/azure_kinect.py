"""Azure Kinect: the calibration.json of its recordings (raw), and its colour intrinsics by the SDK's names.

Raw intrinsics are shares of the sensor's size: [cx, cy, fx, fy, k1 .. k6, codx, cody, p2, p1]. Images of 4:3 are the
whole sensor, those of 16:9 its middle rows. The lens is OpenCV's with 8 coefficients.
"""

from __future__ import annotations

import re

from miniloop_cli.datasets.camera_files.fields import Fields, Reading, Values, depth_scale

USED = tuple(
    """
    fx fy cx cy k1 k2 k3 k4 k5 k6 p1 p2 codx cody width height resolution_width resolution_height type
    model ModelType
    """.split()
)
IGNORED = ("metric_radius", "max_radius_for_projection", "metricRadius", "maxRadiusForProjection", "extrinsics")
RAW = ("cx", "cy", "fx", "fy", "k1", "k2", "k3", "k4", "k5", "k6", "codx", "cody", "p2", "p1")
SIZES = (("width", "height"), ("resolution_width", "resolution_height"))


def matches(data: dict) -> bool:
    """By the lens' centre, which only its SDK names, at the top or a level below."""
    return "codx" in data or any(isinstance(value, dict) and "codx" in value for value in data.values())


def matches_raw(data: dict) -> bool:
    """By its outermost key."""
    return "CalibrationInformation" in data


def read(fields: Fields) -> Reading:
    """The colour camera by the SDK's names. Raises ConfigError."""
    if "codx" in fields:
        return Reading(_lens(fields) | _intrinsics(fields, fields) | depth_scale(fields, "depth_scale"))
    sections = [str(key) for key, value in fields.data.items() if isinstance(value, dict) and "codx" in value]
    fields.known((*sections, "depth_scale", "width", "height"), (*IGNORED, "color_resolution", "depth_mode"))
    color = [key for key in sections if re.search("colou?r|rgb", key, re.IGNORECASE)]
    if len(color) != 1:
        raise fields.fault(f"no single colour camera among {', '.join(sections)}; leave only that one")
    inner = fields.section(color[0])
    values = _intrinsics(inner, fields if "width" in fields else inner)
    return Reading(_lens(inner) | values | depth_scale(fields, "depth_scale"), f"its {color[0]}")


def read_raw(fields: Fields) -> Reading:
    """The colour camera of calibration.json, for images of `image_size`. Raises ConfigError."""
    fields.known(("CalibrationInformation", "width", "height", "depth_scale"))
    information = fields.section("CalibrationInformation")
    cameras = information.data.get("Cameras")
    entries = [entry for entry in cameras if isinstance(entry, dict)] if isinstance(cameras, list) else []
    color = [entry for entry in entries if str(entry.get("Location", "")).endswith("PV0")]
    if len(color) != 1:
        raise information.fault("Cameras must hold one whose Location ends in PV0, the colour camera")
    camera = Fields(color[0], fields.where, name="Cameras.PV0")
    intrinsics = camera.section("Intrinsics")
    raw = dict(zip(RAW, intrinsics.numbers("ModelParameters", (14,)), strict=True))
    kind = Fields(raw | {"ModelType": intrinsics.data.get("ModelType", "")}, fields.where, name=intrinsics.name)
    width, height = _image_size(fields)
    whole = width * camera.number("SensorHeight") / max(camera.number("SensorWidth"), 1)
    if width * 3 not in (height * 4, height * 16 / 3):
        raise fields.fault(f"{width:g} x {height:g} is no size of Azure Kinect's colour images, which are 4:3 or 16:9")
    values = {"fx": raw["fx"] * width, "cx": raw["cx"] * width - 0.5, "fy": raw["fy"] * whole}
    values |= {"cy": raw["cy"] * whole - 0.5 - (whole - height) / 2, "width": width, "height": height}
    return Reading(_lens(kind) | values | depth_scale(fields, "depth_scale"), f"colour at {width:g} x {height:g}")


def _image_size(fields: Fields) -> tuple[float, float]:
    if "width" in fields or fields.image_size is None:
        size = fields.size(("width", "height"))
        return size["width"], size["height"]
    return float(fields.image_size[0]), float(fields.image_size[1])


def _intrinsics(fields: Fields, sized: Fields) -> Values:
    fields.known((*USED, "depth_scale"), IGNORED)
    return {key: fields.number(key) for key in ("fx", "fy", "cx", "cy")} | sized.size(*SIZES)


def _lens(fields: Fields) -> Values:
    values = {key: fields.number(key) if key in fields else 0.0 for key in (*RAW[4:10], "p1", "p2")}
    if any(key in fields and fields.number(key) for key in ("codx", "cody")):
        raise fields.fault("a centre of the lens (codx, cody) other than 0 is not known here")
    kind = " ".join(str(fields.data.get(key, "")) for key in ("type", "model", "ModelType")).lower()
    # The older model has half the weight on the mixed tangential term.
    if "6kt" in kind and (values["p1"] or values["p2"]):
        raise fields.fault(
            "the lens model Rational6KT with p1, p2 other than 0 is not known here; only Brown-Conrady is"
        )
    return {"lens": "radial-tangential"} | values
