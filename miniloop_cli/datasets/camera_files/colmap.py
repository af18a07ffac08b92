"""COLMAP's cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS. The centre of its first pixel is (0.5, 0.5)."""

from __future__ import annotations

import re

from miniloop_cli.datasets.camera_files.fields import Fields, Reading, Values, choose_by_size
from miniloop_cli.errors import ConfigError

# Parameters of a model, in order, by our names (f: both focal lengths).
MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
}
_ROW = re.compile(r"\d+[\s,]+[A-Z][A-Z_]+[\s,]+[\d.]+[\s,]", re.ASCII)


def matches(text: str) -> bool:
    """By the first line that is not a comment."""
    line = next((line for line in map(str.strip, text.splitlines()) if line and not line.startswith("#")), "")
    return _ROW.match(line) is not None


def read(text: str, where: str, image_size: tuple[int, int] | None) -> Reading:
    """The camera; of several different ones, that of the images' size. Raises ConfigError with the line."""
    cameras: dict[str, Values] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            name, values = _camera(line.replace(",", " ").split(), f"{where}:{number}")
            if name in cameras:
                raise ConfigError(f"{where}:{number}: {name} is given twice")
            cameras[name] = values
    different: dict[tuple[tuple[str, float], ...], str] = {}
    for name, values in cameras.items():
        different.setdefault(tuple(values.items()), name)
    sizes = {name: (cameras[name]["width"], cameras[name]["height"]) for name in different.values()}
    name = choose_by_size(Fields({}, where, image_size), sizes, "cameras")
    return Reading(cameras[name], f"{name} of {len(cameras)}" if len(cameras) > 1 else "")


def _camera(words: list[str], where: str) -> tuple[str, Values]:
    if len(words) < 4:
        raise ConfigError(f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS")
    model = words[1]
    if model not in MODELS:
        raise ConfigError(f"{where}: camera model {model} is not supported; supported are {', '.join(MODELS)}")
    names = MODELS[model].split()
    try:
        width, height, *parameters = (float(word) for word in words[2:])
    except ValueError:
        raise ConfigError(f"{where}: not numbers after the model's name") from None
    if len(parameters) != len(names):
        raise ConfigError(f"{where}: {model} has {len(names)} parameters ({', '.join(names)}), not {len(parameters)}")
    values: Values = dict(zip(names, parameters, strict=True)) | {"width": width, "height": height}
    if "f" in values:
        values["fx"] = values["fy"] = values.pop("f")
    values["lens"] = "fisheye" if model.endswith("FISHEYE") else "radial-tangential"
    return f"camera {words[0]}", values | {"cx": values["cx"] - 0.5, "cy": values["cy"] - 0.5}
