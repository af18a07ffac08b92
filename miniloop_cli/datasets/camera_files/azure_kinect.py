"""Azure Kinect: the calibration.json of its recordings (raw), and its colour intrinsics by the SDK's names.

Raw intrinsics are shares of the sensor's size: [cx, cy, fx, fy, k1 .. k6, codx, cody, p2, p1]. Images of 4:3 are the
whole sensor, those of 16:9 its middle rows. The lens is OpenCV's with 8 coefficients.
"""

from __future__ import annotations

import re

import numpy as np

from miniloop_cli.datasets.camera_files.fields import Fields, Reading, Values, depth_scale
from miniloop_cli.geometry import se3
from miniloop_cli.typing import Floats

USED = tuple(
    """
    fx fy cx cy k1 k2 k3 k4 k5 k6 p1 p2 codx cody width height resolution_width resolution_height type
    model ModelType
    """.split()
)
IGNORED = ("metric_radius", "max_radius_for_projection", "metricRadius", "maxRadiusForProjection", "extrinsics")
RAW = ("cx", "cy", "fx", "fy", "k1", "k2", "k3", "k4", "k5", "k6", "codx", "cody", "p2", "p1")
DEPTH_MODES = {
    (640, 576): (1024, 192, 180),
    (320, 288): (512, 96, 90),
    (1024, 1024): (1024, 0, 0),
    (512, 512): (512, 0, 0),
}
SIZES = (("width", "height"), ("resolution_width", "resolution_height"))


def matches(data: dict) -> bool:
    """By the name of the lens centre, which only this SDK uses, at the top or a level below."""
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
    camera = _camera(information, "PV0", "the colour camera")
    intrinsics = camera.section("Intrinsics")
    raw = dict(zip(RAW, intrinsics.numbers("ModelParameters", (14,)), strict=True))
    kind = Fields(raw | {"ModelType": intrinsics.data.get("ModelType", "")}, fields.where, name=intrinsics.name)
    width, height = _image_size(fields)
    whole = width * camera.number("SensorHeight") / max(camera.number("SensorWidth"), 1)
    if width * 3 not in (height * 4, height * 16 / 3):
        raise fields.fault(
            f"{width:g} x {height:g} is not a size of Azure Kinect's colour images, which are 4:3 or 16:9"
        )
    values = {"fx": raw["fx"] * width, "cx": raw["cx"] * width - 0.5, "fy": raw["fy"] * whole}
    values |= {"cy": raw["cy"] * whole - 0.5 - (whole - height) / 2, "width": width, "height": height}
    return Reading(_lens(kind) | values | depth_scale(fields, "depth_scale"), f"colour at {width:g} x {height:g}")


def read_raw_depth(fields: Fields) -> tuple[Values, Floats]:
    """The depth camera of calibration.json for depth images of `image_size`, and (4, 4) T_color_depth (m).

    Each mode reads a part of the sensor, binned or not; poses of cameras are relative to the depth camera. Raises
    ConfigError.
    """
    information = fields.section("CalibrationInformation")
    depth, color = _camera(information, "D0", "the depth camera"), _camera(information, "PV0", "the colour camera")
    if fields.image_size not in DEPTH_MODES:
        raise fields.fault(f"{fields.image_size} is not a size of Azure Kinect's depth images")
    width, height = fields.image_size or (0, 0)
    whole, left, top = DEPTH_MODES[width, height]
    intrinsics = depth.section("Intrinsics")
    raw = dict(zip(RAW, intrinsics.numbers("ModelParameters", (14,)), strict=True))
    kind = Fields(raw | {"ModelType": intrinsics.data.get("ModelType", "")}, fields.where, name=intrinsics.name)
    values: Values = _lens(kind) | {"fx": raw["fx"] * whole, "cx": raw["cx"] * whole - left - 0.5}
    values |= {"fy": raw["fy"] * whole, "cy": raw["cy"] * whole - top - 0.5, "width": width, "height": height}
    return values, _place(color) @ se3.inverse(_place(depth))


def _camera(information: Fields, location: str, what: str) -> Fields:
    cameras = information.data.get("Cameras")
    entries = [entry for entry in cameras if isinstance(entry, dict)] if isinstance(cameras, list) else []
    found = [entry for entry in entries if str(entry.get("Location", "")).endswith(location)]
    if len(found) != 1:
        raise information.fault(f"Cameras must have one entry whose Location ends in {location}, {what}")
    return Fields(found[0], information.where, name=f"Cameras.{location}")


def _place(camera: Fields) -> Floats:
    """(4, 4) points of the depth camera to those of this one."""
    rt = camera.section("Rt")
    R, t = np.array(rt.numbers("Rotation", (9,))).reshape(3, 3), np.array(rt.numbers("Translation", (3,)))
    if np.abs(R @ R.T - np.eye(3)).max() > 0.01 or np.linalg.det(R) < 0 or np.abs(t).max() > 1:
        raise rt.fault("it is not a rotation and a translation in metres")
    return se3.pose(se3.project_so3(R), t)


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
        raise fields.fault("a lens centre (codx, cody) other than 0 is not supported")
    kind = " ".join(str(fields.data.get(key, "")) for key in ("type", "model", "ModelType")).lower()
    # In the older model, the mixed tangential term has half the weight.
    if "6kt" in kind and (values["p1"] or values["p2"]):
        raise fields.fault(
            "the lens model Rational6KT with p1, p2 other than 0 is not supported; only Brown-Conrady is"
        )
    return {"lens": "radial-tangential"} | values
