"""The text of a time stamp: a number in any unit, or a date with the time of day."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime

from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import InputError

DATE = re.compile(
    r"(?<!\d)(?P<year>(?:19|20)\d\d)(?P<between>[-_.]?)(?P<month>\d\d)(?P=between)(?P<day>\d\d)(?P<then>[-_T. ]*)"
    r"(?P<hour>\d\d)(?P<apart>[-_:.hH]?)(?P<minute>\d\d)[-_:.mM]?(?P<second>\d\d)"
    r"(?:[.,](?P<fraction>\d{1,9})|[-_]?(?P<digits>\d{3}|\d{6}|\d{9}))?(?!\d)"
)
PARTS = ("year", "month", "day", "hour", "minute", "second")
LARGEST = 1e19  # nanoseconds since 1970 are below


def date_s(name: str) -> float | None:
    """Seconds since 1970 (UTC) of the date and time of day in a text, None without one."""
    match = DATE.search(name)
    if match is None or (match["between"] and not match["apart"] and "T" not in match["then"]):
        return None  # 2024-05-01_000012 ends in a counter
    year, month, day, hour, minute, second = (int(match[part]) for part in PARTS)
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    digits = match["fraction"] or match["digits"]
    return moment.timestamp() + (int(digits) / 10 ** len(digits) if digits else 0.0)


def parse_stamp(text: str, where: str) -> float:
    """A finite stamp in any unit; a date in seconds since 1970. Raises InputError naming `where` (file and line)."""
    try:
        value = float(text)
    except ValueError:
        if (date := date_s(text)) is not None:
            return date
        raise InputError(f"{where}: expected a timestamp in seconds, found '{shown(text[:40])}'") from None
    if not math.isfinite(value):
        raise InputError(f"{where}: the timestamp is {text[:40]}; remove the row")
    if abs(value) > LARGEST:
        raise InputError(f"{where}: the timestamp {text[:40]} is too large even for nanoseconds")
    return value
