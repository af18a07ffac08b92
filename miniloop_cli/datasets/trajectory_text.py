"""Tables of numbers from any tool: encoding, comments, header, separators, decimal points or commas."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from miniloop_cli.datasets.paths import read_bytes, shown
from miniloop_cli.errors import InputError

COMMENTS = ("#", "%", "//")
MAX_COLUMNS = 256
NUMERIC = re.compile(r"(?:[0-9+\-., ;\t]|[eE][+-]?[0-9]{1,3}(?![0-9]))*")  # longer exponents are damage
NO_NUMBERS = re.compile(r"[+-]?(nan|inf(inity)?)", re.IGNORECASE)
SEPARATOR = re.compile(r"\s*[,;]\s*|\s+")
SEPARATOR_BESIDE_DECIMAL_COMMA = re.compile(r"\s*;\s*|\s+")
QUOTED = re.compile(r'(?<![^\s,;#])"([^"]*)"(?![^\s,;])')  # a whole cell
REMARK = re.compile(r"\s+#")  # a # within a number is damage, not a remark
UTF_8, UTF_16 = b"\xef\xbb\xbf", (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True)
class Text:
    """The lines of a table, with their numbers in the file, its comments and its header."""

    name: str  # of the file, for messages
    lines: tuple[tuple[int, str], ...]
    comments: tuple[str, ...]  # before the first line of numbers, without their sign
    header: str | None  # the first line, where it begins with a word
    encoding: str

    def where(self, line: int) -> str:
        """File and line, for a message."""
        return f"{self.name}:{line}"


@dataclass(frozen=True)
class Table:
    """Finite numbers in rows, which may differ in length."""

    text: Text
    rows: tuple[tuple[float, ...], ...]
    decimal_commas: bool

    def where(self, row: int) -> str:
        """File and line of a row, for a message."""
        return self.text.where(self.text.lines[row][0])


def read_text(path: Path) -> Text:
    """The lines of a text file in UTF-8, UTF-16 or another extension of ASCII. Raises InputError for a binary file."""
    name, data = shown(path), read_bytes(path)
    content, encoding = _decoded(data, name)
    comments: list[str] = []
    lines: list[tuple[int, str]] = []
    header = None
    for number, raw in enumerate(re.split(r"\r\n|\r|\n", content), 1):
        line = QUOTED.sub(r"\1", raw.strip())
        if not line:
            continue
        if line.startswith(COMMENTS):
            if not lines and header is None:
                comments.append(line.lstrip("#%/ \t"))
        elif not lines and header is None and _is_word(SEPARATOR.split(line)[0]):
            header = line
        else:
            lines.append((number, REMARK.split(line)[0]))
    return Text(name, tuple(lines), tuple(comments), header, encoding)


def parse(text: Text, decimal_commas: bool) -> Table:
    """The numbers of all lines; commas are separators or decimal points. Raises InputError naming a line."""
    rows = [_numbers(line, text.where(number), decimal_commas) for number, line in text.lines]
    if rows and all(row[-1] is None for row in rows):  # a separator at the end of every line
        rows = [row[:-1] for row in rows]
    whole: list[tuple[float, ...]] = []
    for (number, _), row in zip(text.lines, rows, strict=True):
        values = tuple(value for value in row if value is not None)
        if len(values) < len(row):
            raise InputError(f"{text.where(number)}: a value is missing between two separators")
        whole.append(values)
    return Table(text, tuple(whole), decimal_commas)


def may_have_decimal_commas(text: Text) -> bool:
    """Whether commas may be decimal points: none at the end of a number, and no other points."""
    lines = [line for _, line in text.lines]
    return any("," in line for line in lines) and not any(
        "." in line or re.search(r"(^|[^0-9]),|,([^0-9]|$)", line) for line in lines
    )


def _decoded(data: bytes, name: str) -> tuple[str, str]:
    encoding = "UTF-8"
    if data.startswith(UTF_16):
        encoding = "UTF-16"
    elif b"\0" in data[:200]:
        # Digits in UTF-16 without a mark have a zero byte before or after each.
        even, odd = data[:200:2].count(0), data[1:200:2].count(0)
        encoding = "UTF-16-LE" if not even else "UTF-16-BE" if not odd else "binary"
    try:
        if encoding == "UTF-8":
            content = data.removeprefix(UTF_8).decode("utf-8", "surrogateescape")
        else:
            content = data.decode(encoding)
    except (UnicodeDecodeError, LookupError):
        content = "\0"
    if "\0" in content:
        raise InputError(f"{name} is not a text file: expected lines of numbers")
    return content, encoding


def _is_word(cell: str) -> bool:
    return bool(re.match(r"[^\W\d]", cell)) and not NO_NUMBERS.fullmatch(cell)


def _numbers(line: str, where: str, decimal_commas: bool) -> list[float | None]:
    cells = (SEPARATOR_BESIDE_DECIMAL_COMMA if decimal_commas else SEPARATOR).split(line)
    if any(NO_NUMBERS.fullmatch(cell) for cell in cells):
        if NO_NUMBERS.fullmatch(cells[0]):
            raise InputError(f"{where}: the timestamp is {cells[0]}; remove the row")
        raise InputError(f"{where}: NaN or infinity in the pose; remove the row")
    if len(cells) > MAX_COLUMNS:
        raise InputError(f"{where}: {len(cells)} values; a pose has at most 16")
    try:
        if not NUMERIC.fullmatch(line):
            raise ValueError
        values = [float(cell.replace(",", ".")) if cell else None for cell in cells]
    except ValueError:
        raise InputError(f"{where}: not a number in '{shown(line[:80])}'") from None
    if any(value is not None and math.isinf(value) for value in values):
        raise InputError(f"{where}: a number too large to be read; remove the row")
    return values
