"""Cameras by their values, which are checked: TUM's families, TUM's default, and our own camera.yaml."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.depth_model import DepthModel
from miniloop_cli.geometry.lens import COEFFICIENTS, Lens, fisheye_lens, radial_tangential_lens
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.sequence import DepthCamera

REQUIRED = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale")
DISTORTION = COEFFICIENTS["radial-tangential"]  # those of a fisheye are among them
DEPTH = tuple(f"depth_{field.name}" for field in fields(DepthModel))
UNCERTAINTY = "uncertainty"  # standard deviations, written for people and other tools
DEPTH_CAMERA = "depth_camera"  # a separate depth camera
KEYS = (*REQUIRED, *DISTORTION, "lens", "trust", *DEPTH, DEPTH_CAMERA, UNCERTAINTY)

DEPTH_CAMERA_KEYS = (*(key for key in REQUIRED if key != "depth_scale"), *DISTORTION, "lens", "trust")
POSE = "T_color_depth"
MOST_APART_M = 1.0

# Colour cameras of the TUM RGB-D benchmark (Sturm et al., IROS 2012): fx fy cx cy, then k1 k2 p1 p2 k3.
FREIBURG = {
    "1": (517.306408, 516.469215, 318.643040, 255.313989, (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)),
    "2": (520.908620, 521.007327, 325.141442, 249.701764, (0.231222, -0.784899, -0.003257, -0.000105, 0.917205)),
    "3": (535.4, 539.2, 320.1, 247.6, (0.0, 0.0, 0.0, 0.0, 0.0)),
}
_FAMILY = re.compile(r"(?:freiburg|(?<![a-z])fr)([123])(?![0-9])", re.IGNORECASE)


def freiburg_family(text: str) -> str | None:
    """'1', '2' or '3' if a table's header or a folder's name has freiburg1 (or fr1), ...; else None."""
    match = _FAMILY.search(text)
    return match[1] if match else None


def freiburg_camera(family: str, where: str) -> Camera:
    """The calibrated colour camera of a TUM family; `where` is the text that named it."""
    fx, fy, cx, cy, distortion = FREIBURG[family]
    source = f"calibration of TUM's freiburg{family}, named by {where}"
    return Camera(fx, fy, cx, cy, 640, 480, 5000.0, radial_tangential_lens(*distortion), source=source)


def default_camera() -> Camera:
    """TUM's ROS default."""
    source = "TUM's ROS default (525 525 319.5 239.5): no file names the camera; --camera FILE is more accurate"
    return Camera(
        525.0, 525.0, 319.5, 239.5, 640, 480, 5000.0, source=source, depth_scale_assumed=True, trust=Trust.GUESS
    )


def make_camera(values: dict[str, Any], where: str, source: str) -> Camera:
    """A camera from the keys of a camera file. Raises ConfigError naming `where` and the key."""
    require_known(values, KEYS, where)
    if missing := [key for key in REQUIRED if key not in values]:
        raise ConfigError(f"{where}: {', '.join(missing)} missing; a camera file needs {', '.join(REQUIRED)}")
    for key, value in values.items():
        if key not in ("lens", "trust", DEPTH_CAMERA, UNCERTAINTY) and (
            isinstance(value, bool) or not isinstance(value, int | float) or not _moderate(value)
        ):
            raise ConfigError(f"{where}: {key} must be a finite number")
    _check_ranges(values, where)
    fx, fy, cx, cy = (float(values[key]) for key in REQUIRED[:4])
    width, height, scale = int(values["width"]), int(values["height"]), float(values["depth_scale"])
    depth, trust = _depth_model(values, where), str(values.get("trust", Trust.CALIBRATED))
    if trust not in list(Trust):
        raise ConfigError(f"{where}: trust is one of {', '.join(Trust)}, not '{shown(trust[:40])}'")
    camera = Camera(
        fx, fy, cx, cy, width, height, scale, _lens(values, where), source=source, depth_model=depth, trust=Trust(trust)
    )
    if fault := camera.lens_fault():
        raise ConfigError(
            f"{where}: {fault}; give all its coefficients, calibrate with views that fill the image, or undistort first"
        )
    depth_camera_of(values, camera, where)
    return camera


def require_known(values: Iterable[Any], known: Iterable[str], where: str) -> None:
    """Raise ConfigError for the first unknown key, naming the most similar known one."""
    known = list(known)
    for key in values:
        if key not in known:
            spelled = {name.lower(): name for name in reversed(known)}
            near = difflib.get_close_matches(str(key)[:40].lower(), spelled, n=1)
            hint = f"did you mean '{spelled[near[0]]}'?" if near else f"choose one of {', '.join(known)}"
            raise ConfigError(f"{where}: unknown key '{shown(str(key)[:40])}'; {hint}")


def _lens(values: dict[str, Any], where: str) -> Lens:
    given = {key: float(values[key]) for key in DISTORTION if key in values}
    model = values.get("lens")
    if model is None:
        if "k4" in given and "k5" not in given and "k6" not in given:
            raise ConfigError(f"{where}: k4 without k5 and k6; add 'lens: fisheye' or 'lens: radial-tangential'")
        model = "radial-tangential"
    if model not in COEFFICIENTS:
        raise ConfigError(f"{where}: lens is one of {', '.join(COEFFICIENTS)}, not '{shown(str(model)[:40])}'")
    if foreign := [key for key, value in given.items() if value and key not in COEFFICIENTS[model]]:
        raise ConfigError(f"{where}: a {model} lens has no {foreign[0]}; lens is one of {', '.join(COEFFICIENTS)}")
    own = [given.get(key, 0.0) for key in COEFFICIENTS[model]]
    return fisheye_lens(*own) if model == "fisheye" else radial_tangential_lens(*own)


def _depth_model(values: dict[str, Any], where: str) -> DepthModel:
    given = {key: float(values[key]) for key in DEPTH if key in values}
    model = DepthModel(**{key.removeprefix("depth_"): value for key, value in given.items()})
    if not model.exact and DEPTH[-1] not in given:
        raise ConfigError(f"{where}: {DEPTH[-1]} missing; it belongs to {next(iter(given))}")
    if not model.exact and not (0.05 <= model.middle_m <= 100 and model.increasing):
        raise ConfigError(
            f"{where}: the depth model ({', '.join(given)}) reverses near and far; "
            f"{DEPTH[-1]} is in metres, and the others are small"
        )
    return model


def _moderate(value: float) -> bool:
    return abs(value) < 1e9 and math.isfinite(value)


def _check_ranges(values: dict[str, Any], where: str) -> None:
    for key in ("width", "height"):
        if values[key] != int(values[key]) or not 16 <= values[key] <= 1 << 14:
            raise ConfigError(f"{where}: {key} must be a whole number of pixels from 16 to 16384")
    size = max(values["width"], values["height"])
    for key in ("fx", "fy"):
        if values[key] < 0:
            raise ConfigError(f"{where}: {key} is negative; image y points down here, so give {-values[key]:g}")
        if not 0.05 * size < values[key] < 100 * size:
            raise ConfigError(
                f"{where}: {key} = {values[key]:g} px does not fit an image of {size} px; it is in pixels"
            )
    for key, extent in (("cx", values["width"]), ("cy", values["height"])):
        if not -extent < values[key] < 2 * extent:
            raise ConfigError(f"{where}: {key} = {values[key]:g} px is far outside the image; it is in pixels")
    if values["depth_scale"] < 1:
        hint = (
            f"; for {values['depth_scale']:g} m a unit give {1 / values['depth_scale']:g}"
            if values["depth_scale"] > 0
            else ""
        )
        raise ConfigError(f"{where}: depth_scale is stored units a metre (TUM 5000, millimetres 1000){hint}")


def save_camera(
    path: Path,
    camera: Camera,
    uncertainty: Mapping[str, Any] | None = None,
    depth_camera: DepthCamera | None = None,
) -> None:
    """Write the YAML that `camera_files.read_camera_file` reads; `uncertainty`: written in addition.

    `depth_camera`: for depth that is not registered to colour.
    """
    with atomic_write(path) as file:
        for key in REQUIRED:
            file.write(f"{key}: {_yaml(getattr(camera, key))}\n")
        if camera.lens.model == "fisheye" or len(camera.lens.coefficients) > 5:
            file.write(f"lens: {camera.lens.model}\n")
        for key, value in camera.lens.named.items():
            if value:
                file.write(f"{key}: {_yaml(value)}\n")
        if not camera.depth_model.exact:
            for key in DEPTH:
                file.write(f"{key}: {_yaml(getattr(camera.depth_model, key.removeprefix('depth_')))}\n")
        if depth_camera:
            yaml.safe_dump({DEPTH_CAMERA: as_mapping(depth_camera)}, file, sort_keys=False, width=120)
        if uncertainty:
            yaml.safe_dump({UNCERTAINTY: dict(uncertainty)}, file, sort_keys=False, width=120)


def as_mapping(own: DepthCamera) -> dict[str, Any]:
    """The entry of a depth camera in a camera file; its unit of depth is that of the file."""
    camera = own.camera
    values: dict[str, Any] = {key: getattr(camera, key) for key in REQUIRED if key != "depth_scale"}
    if camera.lens.model == "fisheye" or len(camera.lens.coefficients) > 5:
        values["lens"] = camera.lens.model
    values |= {key: value for key, value in camera.lens.named.items() if value}
    if camera.trust != Trust.CALIBRATED:
        values["trust"] = str(camera.trust)
    return values | {POSE: own.T_color_depth.tolist()}


def depth_camera_of(values: Mapping[str, Any], camera: Camera, where: str) -> DepthCamera | None:
    """The separate depth camera in a camera file's values, beside the colour `camera`; None if there is none.

    Raises ConfigError naming `where` and the key.
    """
    if DEPTH_CAMERA not in values:
        return None
    own, inside = values[DEPTH_CAMERA], f"{where}: {DEPTH_CAMERA}"
    if not isinstance(own, dict) or POSE not in own:
        raise ConfigError(
            f"{inside} needs fx, fy, cx, cy, width, height and {POSE}, four rows of four numbers: "
            "points of the depth camera to points of the colour camera, m"
        )
    try:
        T = np.asarray(own[POSE], float).reshape(4, 4)
    except (TypeError, ValueError):
        raise ConfigError(f"{inside}: {POSE} must be four rows of four numbers") from None
    R = T[:3, :3]
    if not (
        np.isfinite(T).all()
        and np.abs(R @ R.T - np.eye(3)).max() < 1e-3
        and np.linalg.det(R) > 0
        and np.array_equal(T[3], [0, 0, 0, 1])
        and np.abs(T[:3, 3]).max() < MOST_APART_M
    ):
        raise ConfigError(f"{inside}: {POSE} must be a rotation and a shift in metres, with the last row 0 0 0 1")
    rest = {key: value for key, value in own.items() if key != POSE}
    require_known(rest, DEPTH_CAMERA_KEYS, inside)
    made = make_camera(rest | {"depth_scale": camera.depth_scale}, inside, camera.source)
    T = se3.pose(se3.project_so3(R), T[:3, 3])
    return DepthCamera(made, tuple(T.ravel().tolist()))


def _yaml(value: float) -> str:
    """A number in the syntax of YAML 1.1, which needs a point before an exponent."""
    digits, e, exponent = f"{value}".partition("e")
    return f"{digits}.0e{exponent}" if e and "." not in digits else f"{value}"
