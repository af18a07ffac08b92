"""Access to the fields of camera files: values of the right kind by key, or an error that names the key."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from miniloop_cli.datasets.intrinsics import require_known
from miniloop_cli.errors import ConfigError
from miniloop_cli.errors import printable as shown

Values = dict[str, Any]  # by the keys of our own camera.yaml
Size = tuple[int, int]  # width, height (px)
MOST_NUMBERS = 1000
MATRIX = ("rows", "cols", "data", "dt", "type_id")  # the keys of a matrix of OpenCV or ROS
SIZE = "the size in pixels of the images that it was calibrated for"


@dataclass(frozen=True)
class Reading:
    """The values of a camera file, by the keys of camera.yaml, and the part of the file that they come from."""

    values: Values
    note: str = ""


@dataclass(frozen=True)
class Fields:
    """A mapping of a camera file; `where` names it in errors. `image_size`: that of the recording, if known."""

    data: dict[Any, Any]
    where: str
    image_size: Size | None = None
    name: str = ""

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def known(self, used: Iterable[str], ignored: Iterable[str] = ()) -> None:
        """Raise ConfigError for a key that is neither `used` nor `ignored`."""
        ignored = set(ignored)
        require_known([key for key in self.data if key not in ignored], used, self.place)

    @property
    def place(self) -> str:
        """File and part of the file."""
        return f"{self.where}: {self.name}" if self.name else self.where

    def fault(self, text: str) -> ConfigError:
        """A ConfigError that names the place."""
        return ConfigError(f"{self.place}: {text}")

    def section(self, key: str) -> Fields:
        """The mapping under a key. Raises ConfigError."""
        value = self._get(key, "a group of keys")
        if not isinstance(value, dict):
            raise self.fault(f"{key} must be a group of keys")
        return Fields(value, self.where, self.image_size, f"{self.name}.{key}" if self.name else key)

    def number(self, key: str, what: str = "a number") -> float:
        """A finite number. Raises ConfigError."""
        value = self._get(key, what)
        if not _is_number(value):
            raise self.fault(f"{key} must be a finite number")
        return float(value)

    def numbers(self, key: str, counts: Sequence[int], what: str = "a list of numbers") -> list[float]:
        """Finite numbers of one of the lengths, from a list, also nested, or a matrix. Raises ConfigError."""
        value = self._get(key, what)
        if isinstance(value, dict):
            require_known(value, MATRIX, f"{self.place}: {key}")
            rows, columns, value = value.get("rows"), value.get("cols"), value.get("data")
            shape = [size for size in (rows, columns) if isinstance(size, int | float)]
            if len(shape) == 2 and isinstance(value, list) and shape[0] * shape[1] != len(value):
                raise self.fault(f"{key} has {len(value)} numbers, not {rows:g} rows of {columns:g}")
        found = _flat(value)
        if found is not None and len(found) in counts and all(map(_is_number, found)):
            return [float(number) for number in found]
        lengths = f"up to {counts[-1]}" if isinstance(counts, range) else " or ".join(map(str, counts))
        raise self.fault(f"{key} must have {lengths} finite numbers")

    def text(self, key: str, default: str | None = None) -> str:
        """A word in lower case; `default`, if given, for a missing key. Raises ConfigError."""
        value = self._get(key, "a word") if default is None else self.data.get(key, default)
        if not isinstance(value, str):
            raise self.fault(f"{key} must be a word")
        return value.strip().lower()

    def size(self, *keys: tuple[str, str]) -> Values:
        """Width and height under the first pair of keys that exists. Raises ConfigError if there is none."""
        for width, height in keys:
            if width in self or height in self:
                return {"width": self.number(width, SIZE), "height": self.number(height, SIZE)}
        width, height = keys[0]
        raise self.fault(f"{width} and {height} missing; add {SIZE}")

    def _get(self, key: str, what: str) -> Any:
        if key not in self.data:
            raise self.fault(f"{key} missing; add {what}")
        return self.data[key]


def _is_number(value: Any) -> bool:
    return (
        not isinstance(value, bool) and isinstance(value, int | float) and abs(value) < 1e300 and math.isfinite(value)
    )


def _flat(values: Any) -> list[Any] | None:
    """A list, or a list of lists of one length, as one list; None for anything else."""
    if not isinstance(values, list) or len(values) > MOST_NUMBERS:
        return None
    lengths = {len(value) if isinstance(value, list) else None for value in values}
    if lengths <= {None}:
        return values
    return [number for value in values for number in value] if len(lengths) == 1 else None


def pinhole(fields: Fields, K: Sequence[float], key: str) -> Values:
    """fx fy cx cy of a 3 x 3 matrix, row by row. Raises ConfigError for skew and for other matrices."""
    fx, skew, cx, zero, fy, cy, *last = K
    if last != [0, 0, 1] or zero != 0:
        raise fields.fault(f"{key} is not of the form fx 0 cx, 0 fy cy, 0 0 1")
    if skew != 0:
        raise fields.fault(f"{key} has a skew of {skew:g}, which is not supported")
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy}


LENS_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def opencv_lens(fields: Fields, coefficients: Sequence[float]) -> Values:
    """The lens of OpenCV's distortion coefficients: none, 4, 5, 8, or more if the rest is zero. Raises ConfigError."""
    if len(coefficients) not in (0, 4, 5, 8, 12, 14):
        raise fields.fault(f"{len(coefficients)} distortion coefficients; expected 4, 5, 8, 12 or 14, as in OpenCV")
    if any(coefficients[8:]):
        raise fields.fault("thin-prism and tilt coefficients (the 9th and later) are not supported; undistort first")
    return {"lens": "radial-tangential"} | dict(zip(LENS_NAMES, coefficients[:8], strict=False))


def fisheye_lens(fields: Fields, coefficients: Sequence[float]) -> Values:
    """The lens of Kannala and Brandt's four coefficients. Raises ConfigError for another number."""
    if len(coefficients) != 4:
        raise fields.fault(f"{len(coefficients)} coefficients of a fisheye lens; expected 4")
    return {"lens": "fisheye"} | dict(zip(("k1", "k2", "k3", "k4"), coefficients, strict=True))


def depth_scale(fields: Fields, *keys: str) -> Values:
    """Stored units a metre under the first of the keys that exists; nothing without one."""
    for key in keys:
        if key in fields:
            return {"depth_scale": fields.number(key)}
    return {}


def choose_by_size(fields: Fields, cameras: Mapping[str, tuple[float, float]], what: str) -> str:
    """The one camera of several that has the images' size. Raises ConfigError if none or several have it."""
    if len(cameras) == 1:
        return next(iter(cameras))
    fitting = [name for name, size in cameras.items() if size == fields.image_size]
    if len(fitting) == 1:
        return fitting[0]
    names = shown(", ".join(f"{name} ({w:g} x {h:g})" for name, (w, h) in cameras.items()), 200)
    wanted = " x ".join(map(str, fields.image_size)) if fields.image_size else "unknown"
    raise fields.fault(f"{len(cameras)} {what}: {names}; the images' size is {wanted}; leave only the right one")
