"""Poses in the formats of many tools, recognised by the number of columns and by their names.

TUM: 8 columns, `timestamp tx ty tz qx qy qz qw`. KITTI: 12, the upper rows of a matrix; Replica and others: all 16,
or 4 lines of 4; Redwood: those below a line of 3 numbers. Anything else needs a header that names its columns.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.stamps import Unit
from miniloop_cli.datasets.trajectory_header import Columns, find_columns
from miniloop_cli.datasets.trajectory_text import Table, Text, may_have_decimal_commas, parse, read_text
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.typing import Floats, Ints

MAX_COORDINATE_M = 1e7
UNIT_QUATERNION = 0.02  # error of the length of a quaternion by rounding
RIGID = 0.01  # largest entry of R R' - 1
METRES = {None: 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
KNOWN = (
    "lines 'timestamp tx ty tz qx qy qz qw' (TUM), of 12 or 16 values of a matrix, matrices in 4 lines of 4, or a "
    "header that names the columns"
)


@dataclass(frozen=True)
class PoseFile:
    """Poses as a file has them, in its order."""

    name: str
    format: tuple[str, ...]  # the recognised format, and conversions
    T_world_cam: Floats  # (n, 4, 4), metres
    lines: Ints  # (n,) line in the file
    stamps: Floats | None  # (n,) in a unit that may be unknown; None in formats that have none
    time_unit: Unit | None = None  # of the stamps, if the file states it
    numbers: Ints | None = None  # (n,) frame numbers, if the file states them

    def where(self, row: int) -> str:
        """File and line of a pose, for a message."""
        return f"{self.name}:{self.lines[row]}"


def read_pose_file(path: Path) -> PoseFile:
    """The poses of a file. Raises InputError naming file and line for malformed and for ambiguous content."""
    text = read_text(path)
    if not text.lines:
        raise InputError(f"{text.name} has no poses; expected {KNOWN}")
    tables = [parse(text, decimal_commas=False)]
    if may_have_decimal_commas(text):
        with suppress(InputError):
            tables.append(parse(text, decimal_commas=True))
    found, problems = [], []
    for table in tables:
        try:
            found.append(_poses(table))
        except InputError as error:
            problems.append(error)
    if len(found) > 1:
        raise InputError(f"{text.name}: its commas may be separators or decimal points; write decimal points")
    if not found:
        raise problems[-1]
    return found[0]


def _poses(table: Table) -> PoseFile:
    text, first = table.text, len(table.rows[0])
    words = [f"{text.encoding} text"] if text.encoding != "UTF-8" else []
    words += ["decimal commas"] if table.decimal_commas else []
    if columns := find_columns(text.comments, text.header, first, text.name):
        return _named(table, columns, words)
    if first == 8:
        _require_lengths(table, 8)
        values = np.array(table.rows)
        return _stamped(table, values[:, 0], values[:, 1:4], values[:, 4:], None, ("TUM", *words))
    if first in (12, 16):
        _require_lengths(table, first)
        M = np.array(table.rows).reshape(-1, first // 4, 4)
        name = "KITTI (3 x 4)" if first == 12 else "matrices (4 x 4)"
        return PoseFile(text.name, (name, *words), _rigid(table, M, np.arange(len(M))), _lines(text), None)
    if first == 4 or (first == 3 and [len(row) for row in table.rows[1:2]] == [4]):
        return _blocks(table, words)
    raise InputError(f"{table.where(0)}: expected {KNOWN}; found {first} values")


def _named(table: Table, columns: Columns, words: list[str]) -> PoseFile:
    _require_lengths(table, columns.count)
    values = np.array(table.rows)
    position_m = values[:, columns.position] * METRES[columns.length_unit]
    stamps, q, words = values[:, columns.stamp], values[:, columns.quaternion], [*columns.words(), *words]
    return _stamped(table, stamps, position_m, q, columns.time_unit, tuple(words))


def _stamped(
    table: Table, stamps: Floats, position_m: Floats, q: Floats, time_unit: Unit | None, words: tuple[str, ...]
) -> PoseFile:
    length = np.hypot(np.hypot(q[:, 0], q[:, 1]), np.hypot(q[:, 2], q[:, 3]))  # does not overflow for finite numbers
    if (bad := np.abs(length - 1) > UNIT_QUATERNION).any():
        k = int(bad.argmax())
        if length[k] < 1e-6:
            raise InputError(f"{table.where(k)}: the quaternion is zero; remove the row")
        raise InputError(
            f"{table.where(k)}: not a unit quaternion (length {length[k]:.3g}); are the columns 'timestamp tx ty tz "
            "qx qy "
            "qz qw'? Name others in a header"
        )
    _require_metres(table, position_m, np.arange(len(q)))
    T = se3.pose(se3.rotations(q), position_m)
    return PoseFile(table.text.name, words, T, _lines(table.text), stamps, time_unit)


def _blocks(table: Table, words: list[str]) -> PoseFile:
    """Matrices in 4 lines of 4, each below a line of 3 numbers (Redwood's log) or not."""
    size = 5 if len(table.rows[0]) == 3 else 4
    for k, row in enumerate(table.rows):
        expected = 3 if size == 5 and k % 5 == 0 else 4
        if len(row) != expected:
            raise InputError(f"{table.where(k)}: expected {expected} values (matrices in lines of 4), found {len(row)}")
    if len(table.rows) % size:
        raise InputError(f"{table.where(len(table.rows) - 1)}: the file ends within a matrix of 4 lines")
    starts = np.arange(0, len(table.rows), size)
    M = np.array([table.rows[k + size - 4 : k + size] for k in starts])
    numbers = None
    if size == 5:
        heads = np.array([table.rows[k][0] for k in starts])
        if (heads != np.floor(heads)).any() or (np.abs(heads) > 1e9).any() or (np.diff(heads) <= 0).any():
            k = int(starts[np.r_[False, np.diff(heads) <= 0].argmax()])
            raise InputError(f"{table.where(k)}: the frame numbers of the log do not increase")
        numbers = heads.astype(np.int64)
    name = "Redwood's log" if size == 5 else "matrices in 4 lines of 4"
    return PoseFile(
        table.text.name, (name, *words), _rigid(table, M, starts), _lines(table.text)[starts], None, None, numbers
    )


def _rigid(table: Table, M: Floats, rows: Ints) -> Floats:
    """(n, 4, 4) poses with exact rotations from (n, 3 or 4, 4). Raises InputError for other matrices."""
    if M.shape[1] == 4 and (bad := np.abs(M[:, 3] - [0, 0, 0, 1]).max(axis=1) > 1e-6).any():
        turned = not np.abs(M[:, :, 3] - [0, 0, 0, 1]).max() > 1e-6
        hint = "it is written column by column; transpose it" if turned else "it does not end in 0 0 0 1"
        raise InputError(f"{table.where(int(rows[bad.argmax()]))}: not a matrix of a rigid motion: {hint}")
    R, t = M[:, :3, :3], M[:, :3, 3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
        bad = ~(off <= RIGID) | ~(np.linalg.det(R) > 0)
    if bad.any():
        raise InputError(
            f"{table.where(int(rows[bad.argmax()]))}: not a rigid motion: expected the rows of a rotation and a "
            "position"
        )
    _require_metres(table, t, rows)
    return se3.pose(se3.project_so3(R), t)


def _require_lengths(table: Table, count: int) -> None:
    for k, row in enumerate(table.rows):
        if len(row) != count:
            raise InputError(f"{table.where(k)}: expected {count} values as in the first row, found {len(row)}")


def _require_metres(table: Table, position_m: Floats, rows: Ints) -> None:
    if (bad := np.abs(position_m).max(axis=1) > MAX_COORDINATE_M).any():
        where = table.where(int(rows[bad.argmax()]))
        raise InputError(f"{where}: a value beyond {MAX_COORDINATE_M:.0e}; positions are in metres")


def _lines(text: Text) -> Ints:
    return np.array([number for number, _ in text.lines], np.int64)
