"""benchmarks/results.json: runs (what was measured, how, when), their tables, single values, and printed output."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.atomic_files import atomic_write

PATH = Path(__file__).parents[1] / "results.json"
Json = dict[str, Any]


class FigureError(MiniloopError):
    """results.json, or a page that takes figures from it, is wrong."""


@dataclass
class Figures:
    """What was measured.

    runs: name -> command, date, commit, machine (each text or None) of one measurement.
    tables: key -> what, run, columns, rows.
    values: key -> what, unit, and either value (and digits) and run, or the table, row and column of a cell.
    outputs: key -> what, run, lines: what a program printed.
    """

    runs: dict[str, Json] = field(default_factory=dict)
    tables: dict[str, Json] = field(default_factory=dict)
    values: dict[str, Json] = field(default_factory=dict)
    outputs: dict[str, Json] = field(default_factory=dict)

    def table(self, key: str) -> str:
        """A Markdown table; a column of numbers stands to the right. Raises FigureError for an unknown key."""
        found = _entry(self.tables, key)
        rows = [[cell_text(cell) for cell in row] for row in found["rows"]]
        right = [all(re.fullmatch(r"[-\d.,/% ]*", row[k]) for row in rows) for k in range(len(found["columns"]))]
        rule = "|".join("---:" if one and k else "---" for k, one in enumerate(right))
        lines = [_line(found["columns"]), f"|{rule}|", *map(_line, rows)]
        return "\n".join(lines)

    def value(self, key: str) -> str:
        """A single figure as text, without its unit. Raises FigureError for an unknown key."""
        found = _entry(self.values, key)
        if "table" in found:
            return self._cell(key, found)
        return f"{found['value']:.{found['digits']}f}" if "digits" in found else cell_text(found["value"])

    def output(self, key: str) -> str:
        """A fenced block of what a program printed, and its commands. Raises FigureError for an unknown key."""
        lines = _entry(self.outputs, key)["lines"]
        return "\n".join(["```console" if lines[0].startswith("$ ") else "```text", *lines, "```"])

    def run_of(self, key: str) -> str:
        """The name of the run that a table, value or output comes from."""
        found = self.tables.get(key) or self.outputs.get(key) or _entry(self.values, key)
        return self.run_of(found["table"]) if "table" in found else found["run"]

    def _cell(self, key: str, named: Json) -> str:
        table = _entry(self.tables, named["table"])
        start = [str(cell) for cell in named["row"]]
        rows = [row for row in table["rows"] if [cell_text(cell) for cell in row[: len(start)]] == start]
        if len(rows) != 1 or table["columns"].count(named["column"]) != 1:
            raise FigureError(f"value {key}: no cell {start}, {named['column']!r} in table {named['table']}")
        return cell_text(rows[0][table["columns"].index(named["column"])])


def load(path: Path = PATH) -> Figures:
    """What results.json holds. Raises FigureError for an entry whose run is not described."""
    figures = Figures(**json.loads(path.read_text(encoding="utf-8")))
    for key in (*figures.tables, *figures.values, *figures.outputs):
        if figures.run_of(key) not in figures.runs:
            raise FigureError(f"{path.name}: {key} names the run {figures.run_of(key)!r}, which is not under 'runs'")
    return figures


def save(figures: Figures, path: Path = PATH) -> None:
    """Write results.json, a row of a table on a line of its own."""
    content = {kind: dict(sorted(getattr(figures, kind).items())) for kind in ("runs", "tables", "values", "outputs")}
    text = json.dumps(content, indent=1, ensure_ascii=False)
    text = re.sub(r"\[\s*((?:[^][\"]|\"(?:[^\"\\]|\\.)*\")*?)\s*\]", _one_line, text)
    with atomic_write(path) as file:
        file.write(text + "\n")


def put_table(figures: Figures, key: str, what: str, table: tuple[Sequence[str], Sequence[Sequence[Any]]]) -> None:
    """Set a table; its run is the first part of its key."""
    columns, rows = table
    run = key.partition(".")[0]
    figures.tables[key] = {"what": what, "run": run, "columns": list(columns), "rows": [list(row) for row in rows]}


def cell_text(value: Any) -> str:
    """A cell: numbers to a sensible number of digits, "-" for none."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3f}" if abs(value) < 0.1 else f"{value:.2f}" if abs(value) < 20 else f"{value:.0f}"
    return str(value)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _entry(entries: dict[str, Json], key: str) -> Json:
    if key not in entries:
        raise FigureError(f"{PATH.name} has no figure {key!r}")
    return entries[key]


def _one_line(match: re.Match[str]) -> str:
    return "[" + re.sub(r"\s*\n\s*", " ", match[1]) + "]"
