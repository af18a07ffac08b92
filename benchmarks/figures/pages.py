"""Pages take figures from results.json where they are marked.

`<!--=KEY-->0.35<!--/-->` is a value, `<!--table=KEY-->` to `<!--/table-->` a table, `<!--output=KEY-->` to
`<!--/output-->` what a program printed, and `<!--run=NAME.machine-->` to `<!--/-->` what is known of a run. Neither
GitHub nor the site shows the marks.
"""

from __future__ import annotations

import re
from pathlib import Path

from benchmarks.figures.store import FigureError, Figures
from miniloop_cli.runtime.atomic_files import atomic_write

ROOT = Path(__file__).parents[2]
LISTING = ROOT / "docs" / "figures.md"
VALUE = re.compile(r"(<!--=([\w.-]+)-->).*?(<!--/-->)", re.DOTALL)
RUN = re.compile(r"(<!--run=([\w-]+)\.(\w+)-->).*?(<!--/-->)", re.DOTALL)
TABLE = re.compile(r"(<!--table=([\w.-]+)-->).*?(<!--/table-->)", re.DOTALL)
OUTPUT = re.compile(r"(<!--output=([\w.-]+)-->).*?(<!--/output-->)", re.DOTALL)
# Markdown takes a line that begins with a comment for HTML, and what follows on it for no Markdown.
FIRST_ON_LINE = re.compile(r"^[ >]*(?:(?:[-*+]|\d+\.) +)?<!--(?:=|run=)", re.MULTILINE)
ABOUT = """# Every figure, and where it comes from

<!-- Made by `python -m benchmarks figures`; do not edit. -->

Each measured figure of README, BENCHMARK.md and these pages stands once, in `benchmarks/results.json`. This list is
made from it. A figure is as good as the run that it comes from. The commit is the one that recorded the figures. A
machine that was not noted is "not noted".
"""


def pages() -> list[Path]:
    """All pages that may hold figures."""
    beside = [ROOT / name for name in ("README.md", "BENCHMARK.md")]
    return [*beside, *(page for page in sorted((ROOT / "docs").rglob("*.md")) if page != LISTING)]


def filled(text: str, figures: Figures) -> str:
    """The text with all marked figures as they are in results.json.

    Raises FigureError for an unknown key, and for a value that begins a line.
    """
    if first := FIRST_ON_LINE.search(text):
        line = text.count("\n", 0, first.end()) + 1
        raise FigureError(f"line {line} begins with a mark, which Markdown takes for HTML; put a word before it")
    text = VALUE.sub(lambda match: match[1] + figures.value(match[2]) + match[3], text)
    text = RUN.sub(lambda match: match[1] + str(figures.runs[match[2]][match[3]]) + match[4], text)
    text = OUTPUT.sub(lambda match: f"{match[1]}\n\n{figures.output(match[2])}\n\n{match[3]}", text)
    return TABLE.sub(lambda match: f"{match[1]}\n\n{figures.table(match[2])}\n\n{match[3]}", text)


def listing(figures: Figures, used: dict[str, list[str]]) -> str:
    """The page docs/figures.md; `used` names the pages of each key."""
    parts = [ABOUT]
    for name, run in sorted(figures.runs.items()):
        facts = [f"`{run['command']}`" if run["command"] else "", run.get("note")]
        facts += [f"{run['date']}, commit {run['commit']}", f"machine: {run['machine'] or 'not noted'}"]
        rows = [
            f"| `{key}` | {figures.value(key)} {one['unit']} | {one['what']} | {', '.join(used.get(key, []))} |"
            for key, one in sorted(figures.values.items())
            if figures.run_of(key) == name
        ] + [
            f"| `{key}` | table, {len(one['rows'])} rows | {one['what']} | {', '.join(used.get(key, []))} |"
            for key, one in sorted(figures.tables.items())
            if figures.run_of(key) == name
        ]
        rows += [
            f"| `{key}` | output, {len(one['lines'])} lines | {one['what']} | {', '.join(used.get(key, []))} |"
            for key, one in sorted(figures.outputs.items())
            if figures.run_of(key) == name
        ]
        table = "\n".join(["| key | figure | what it is | where it stands |", "|---|---|---|---|", *rows])
        parts.append(f"## {name}\n\n{'; '.join(fact for fact in facts if fact)}.\n\n{table}\n")
    return "\n".join(parts)


def update(figures: Figures, check: bool) -> list[Path]:
    """Bring all pages up to date, or with `check` only tell which are not; returns those pages."""
    stale, used = [], {}
    wanted: dict[Path, str] = {}
    for page in pages():
        text = page.read_text(encoding="utf-8")
        try:
            wanted[page] = filled(text, figures)
        except FigureError as error:
            raise FigureError(f"{page.relative_to(ROOT)}: {error}") from error
        for key in dict.fromkeys(re.findall(r"<!--(?:table|output)?=([\w.-]+)-->", text)):
            used.setdefault(key, []).append(page.relative_to(ROOT).as_posix())
    wanted[LISTING] = listing(figures, used)
    for page, text in wanted.items():
        if not page.is_file() or page.read_text(encoding="utf-8") != text:
            stale.append(page)
            if not check:
                with atomic_write(page) as file:
                    file.write(text)
    return stale
