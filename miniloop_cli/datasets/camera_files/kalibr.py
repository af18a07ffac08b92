"""Kalibr's camchain.yaml (cam0, cam1, ...) and sensor.yaml of EuRoC, which is one such camera."""

from __future__ import annotations

import re

from miniloop_cli.datasets.camera_files.fields import (
    SIZE,
    Fields,
    Reading,
    Values,
    depth_scale,
    fisheye_lens,
    opencv_lens,
)

USED = ("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "distortion_coefficients", "resolution")
IGNORED = tuple(
    """
    T_cn_cnm1 T_cam_imu T_imu_cam T_cam_lidar T_BS timeshift_cam_imu cam_overlaps rostopic rate_hz
    sensor_type comment intrinsic_matrix image_topic label id
    """.split()
)
_CAMERA = re.compile(r"cam\d{1,4}\Z", re.ASCII)


def matches(data: dict) -> bool:
    """By cam0, cam1 ..., or by one camera's `intrinsics` with a model."""
    return any(_is_camera(data, key) for key in data) or ("intrinsics" in data and "distortion_model" in data)


def read(fields: Fields) -> Reading:
    """The first camera that has the images' size, else the first. Raises ConfigError."""
    names = sorted((key for key in fields.data if _is_camera(fields.data, key)), key=lambda key: int(key[3:]))
    if not names:
        return Reading(_camera(fields) | depth_scale(fields, "depth_scale"))
    imus = [key for key in fields.data if re.match(r"imu\d*\Z", str(key))]
    fields.known((*names, "depth_scale"), imus)
    cameras = {name: fields.section(name) for name in names}
    fitting = [name for name, camera in cameras.items() if _size(camera) == fields.image_size]
    name = (fitting or names)[0]
    note = (
        "" if len(names) == 1 else f"{name} of {', '.join(names)}" + (", the first of the images' size" * bool(fitting))
    )
    return Reading(_camera(cameras[name]) | depth_scale(fields, "depth_scale"), note)


def _is_camera(data: dict, key: object) -> bool:
    return isinstance(key, str) and _CAMERA.match(key) is not None and isinstance(data[key], dict)


def _size(camera: Fields) -> tuple[float, float] | None:
    if "resolution" not in camera:
        return None
    width, height = camera.numbers("resolution", (2,), f"[width, height], {SIZE}")
    return width, height


def _camera(camera: Fields) -> Values:
    camera.known((*USED, "depth_scale"), IGNORED)
    model = camera.text("camera_model")
    if model != "pinhole":
        raise camera.fault(
            f"camera_model is {model}; only pinhole is supported: calibrate with pinhole-radtan or pinhole-equi"
        )
    values = dict(zip(("fx", "fy", "cx", "cy"), camera.numbers("intrinsics", (4,)), strict=True))
    values |= dict(
        zip(("width", "height"), camera.numbers("resolution", (2,), f"[width, height], {SIZE}"), strict=True)
    )
    key = "distortion_coefficients" if "distortion_coefficients" in camera else "distortion_coeffs"
    lens = camera.text("distortion_model")
    k = camera.numbers(key, range(15)) if key in camera or lens not in ("none", "") else []
    if lens == "equidistant":
        return values | fisheye_lens(camera, k)
    if lens in ("radtan", "radial-tangential", "plumb_bob") or not k:
        return values | opencv_lens(camera, k)
    raise camera.fault(f"distortion_model is {lens}; supported are radtan and equidistant")
