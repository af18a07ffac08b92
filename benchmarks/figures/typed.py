"""Numbers with a unit that pages hold outside of marks: settings, limits and protocols, which limits.txt lists.

A measured number belongs to results.json.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Set
from pathlib import Path

from benchmarks.figures.pages import OUTPUT, ROOT, RUN, TABLE, VALUE, pages
from benchmarks.figures.store import FigureError

LIMITS = Path(__file__).parents[1] / "limits.txt"
CODE = re.compile(r"^(```|~~~).*?^\1|`[^`\n]*`", re.DOTALL | re.MULTILINE)
UNITS = r"cm|mm|m|deg|degrees|°|s|ms|µs|us|seconds|min|minutes|MB|GB|kB|KB|%|times|of \d[\d,]*"
NUMBER = re.compile(rf"(?<![\w./^,-])(\d+(?:,\d\d\d)*(?:\.\d+)?)(?:-| ?)({UNITS})(?![\w/^])")
MADE = ("docs/settings.md", "docs/licences.md")  # by scripts


def typed_numbers(text: str) -> Iterator[tuple[int, str]]:
    """(line, "3 cm") of each number with a unit outside of marks and code."""
    for generated in (VALUE, RUN, TABLE, OUTPUT, CODE):
        text = generated.sub(lambda match: "\n" * match[0].count("\n"), text)
    for number, line in enumerate(text.split("\n"), 1):
        yield from ((number, f"{value} {unit}") for value, unit in NUMBER.findall(line))


def check_typed_numbers() -> None:
    """Compare all pages with limits.txt. Raises FigureError as `compare`."""
    names = {page.relative_to(ROOT).as_posix(): page for page in pages()}
    texts = {name: page.read_text(encoding="utf-8") for name, page in names.items() if name not in MADE}
    lines = LIMITS.read_text(encoding="utf-8").split("\n")
    compare(texts, {line for line in lines if line and not line.startswith("#")})


def compare(texts: Mapping[str, str], listed: Set[str]) -> None:
    """Compare the texts of pages by name with the `listed` lines "PAGE: NUMBER UNIT".

    Raises FigureError for a typed number that is not listed, and for a line that no page needs.
    """
    needed = set()
    for name, text in texts.items():
        for line, number in typed_numbers(text):
            needed.add(entry := f"{name}: {number}")
            if entry not in listed:
                raise FigureError(
                    f"{name}:{line}: '{number}' is typed by hand; mark it as a figure of results.json, or, if it is a "
                    f"setting, a limit or a protocol, add the line '{entry}' to {LIMITS.relative_to(ROOT)}"
                )
    if listed - needed:
        raise FigureError(f"{LIMITS.relative_to(ROOT)}: no page has '{min(listed - needed)}'; remove the line")
