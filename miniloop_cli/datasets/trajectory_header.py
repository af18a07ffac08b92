"""The meaning of the column names of a trajectory, from any tool."""

from __future__ import annotations

import re
from dataclasses import dataclass

from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.stamps import BY_SYMBOL, Unit
from miniloop_cli.errors import InputError

STAMP = re.compile(r"(?:.*_)?(?:timestamps?|time|stamp|t|sec|secs|seconds)")
POSITION = re.compile(r"(?:.*_)?(?:t|p|pos|pose|position|trans|translation|location)(?:_(?:rs_r|w|wc|wb))?|")
QUATERNION = re.compile(r"(?:.*_)?(?:q|quat|quaternion|orientation|rotation|rot)(?:_(?:rs|w|wc|wb))?")
NANOSECONDS = re.compile(r"(?:.*_)?(?:nsecs?|nanosecs?|nanoseconds)")
NAME = re.compile(r"[^\W\d][\w./]*(?:\s*[\[(][^\])]*[\])])?")
TIME_UNITS = {"s": "s", "sec": "s", "seconds": "s", "ms": "ms", "msec": "ms", "us": "us", "µs": "us", "μs": "us"}
TIME_UNITS |= {"usec": "us", "ns": "ns", "nsec": "ns"}
LENGTH_UNITS = {"m": "m", "mm": "mm", "cm": "cm"}
QUATERNION_ORDER = "xyzw"


@dataclass(frozen=True)
class Columns:
    """The roles of `count` columns, and units if the header states them."""

    count: int
    stamp: int
    position: tuple[int, int, int]
    quaternion: tuple[int, int, int, int]  # x y z w
    time_unit: Unit | None
    length_unit: str | None
    tool: str  # "EuRoC CSV", or a description of the names

    def words(self) -> list[str]:
        """Description of the recognised header."""
        used = (self.stamp, *self.position, *self.quaternion)
        if used == tuple(range(self.count)):
            words = ["TUM"]
        else:
            words = [self.tool, f"quaternion w {'first' if self.quaternion[3] < self.quaternion[0] else 'last'}"]
        if self.length_unit not in (None, "m"):
            words.append(f"positions in {self.length_unit}")
        return words + ([f"{more} more columns unused"] if (more := self.count - len(used)) else [])


def find_columns(comments: tuple[str, ...], header: str | None, count: int, name: str) -> Columns | None:
    """The columns named by a header line, or by the last comment that looks like one; None if there is none.

    `count`: numbers in the first row. Raises InputError naming the file for an incomplete header.
    """
    if header is not None:
        columns = _columns(header, count, name)
        if columns is None:
            raise InputError(
                f"{name}: the header '{shown(header[:80])}' names no time stamp, position x y z and quaternion "
                "x y z w; expected names like timestamp, tx, ty, tz, qx, qy, qz, qw"
            )
        return columns
    for comment in reversed(comments):
        if columns := _columns(comment, count, name):
            return columns
    return None


def _columns(line: str, count: int, name: str) -> Columns | None:
    """The columns; None for a line of prose."""
    names = [_split(text) for text in _names(line)]
    if len(names) > count and _roles(names[-count:])[0].keys() >= _ALL:
        names = names[-count:]  # words before them, as in "format: timestamp tx ty tz qx qy qz qw"
    roles, problem = _roles(names)
    if len(roles) < (4 if len(names) == count else 6):
        return None
    if missing := sorted(_ALL - roles.keys()):
        problem = problem or f"the header names no column for {', '.join(missing)}"
    elif len(names) != count:
        problem = problem or f"the header names {len(names)} columns, the first row has {count} values"
    if problem:
        raise InputError(f"{name}: {problem} in '{shown(line[:80])}'; expected names as in TUM's or EuRoC's files")
    time_unit, length_unit = _units(names, roles, line, name)
    return Columns(
        count,
        roles["stamp"],
        (roles["x"], roles["y"], roles["z"]),
        (roles["qx"], roles["qy"], roles["qz"], roles["qw"]),
        time_unit,
        length_unit,
        "EuRoC CSV" if "p_rs_r_x" in (stem for stem, _ in names) else "columns by their names",
    )


_ALL = {"stamp", "x", "y", "z", "qx", "qy", "qz", "qw"}


def _names(line: str) -> list[str]:
    separator = next((s for s in ";\t," if line.count(s) >= 6), None)
    if separator:
        return [cell for cell in (part.strip() for part in line.rstrip(separator).split(separator)) if cell]
    return NAME.findall(line)


def _split(text: str) -> tuple[str, str]:
    """A name in lower case, and the unit in brackets or at its end ("" without)."""
    stem, _, unit = re.sub(r"[\])\s]+$", "", text).partition("[" if "[" in text else "(")
    stem = re.sub(r"[^\w]+", "_", stem.strip().lower()).strip("_")
    unit = unit.strip()
    if not unit and (ending := re.fullmatch(r"(.+?)_(ns|nsec|us|usec|ms|msec|s|sec|mm|cm|m)", stem)):
        stem, unit = ending[1], ending[2]
    return stem, unit


def _roles(names: list[tuple[str, str]]) -> tuple[dict[str, int], str]:
    """Column by role, and a problem with them ("" if there is none)."""
    found: dict[str, int] = {}
    problem = ""
    for k, (stem, _) in enumerate(names):
        if NANOSECONDS.fullmatch(stem):
            problem = f"the time is in two columns, '{stem}' is the second; write it as one number"
        role = _role(stem)
        if role is None:
            continue
        # A bag's export has the time of the recording beside the stamp of the message.
        if role in found and not (role == "stamp" and stem.endswith("header_stamp")):
            problem = f"both '{names[found[role]][0]}' and '{stem}' look like the column of {role}"
        found[role] = k
    return found, problem


def _role(stem: str) -> str | None:
    body, axis = re.sub(r"_?[wxyz]$", "", stem), stem[-1:]
    if axis in QUATERNION_ORDER and stem:
        if QUATERNION.fullmatch(body):
            return f"q{axis}"
        if axis != "w" and POSITION.fullmatch(body):
            return axis
    return "stamp" if STAMP.fullmatch(stem) else None


def _units(names: list[tuple[str, str]], roles: dict[str, int], line: str, file: str) -> tuple[Unit | None, str | None]:
    lengths = {names[roles[axis]][1] for axis in "xyz"} - {""}
    time = names[roles["stamp"]][1]
    # "(s, m, camera to world)" at the end of the line, as miniloop's own files have it.
    general = re.search(r"\(([^)]*,[^)]*)\)\s*$", line)
    words = [word.strip() for word in general[1].split(",")] if general else []
    time = time or next((word for word in words if word in TIME_UNITS), "")
    lengths = lengths or {word for word in words if word in LENGTH_UNITS}
    if len(lengths) > 1:
        raise InputError(f"{file}: the header gives positions in {' and '.join(sorted(lengths))}; write them in metres")
    length = next(iter(lengths), None)
    for unit, known in ((time, TIME_UNITS), (length, LENGTH_UNITS)):
        if unit and unit not in known:
            expected = ", ".join(dict.fromkeys(known.values()))
            raise InputError(f"{file}: the header's unit '{shown(unit[:20])}' is unknown; expected {expected}")
    return (BY_SYMBOL[TIME_UNITS[time]] if time else None), length
