"""Writes docs/licences.md: `python docs/make_licences.py`, in an environment with the package and its extras."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, metadata, requires
from pathlib import Path

HEAD = """# Licences of what miniloop uses

miniloop itself is under the MIT licence. What it is installed with, and the extras, by what each package says of itself
(version examined: the newest when this page was made, by `docs/make_licences.py`). None of it is changed, and only
three.js is shipped: it draws the 3D view, under the MIT licence, and its version and licence lie beside it in
`miniloop_cli/report/viewer/assets`.
evo and codespell are GPL: evo is an independent oracle of tests and benchmarks, codespell a check of spelling. The
program does not import them.

| package | needed by | version | licence |
|---|---|---|---|
"""


def licence(name: str) -> tuple[str, str]:
    """Version and licence, from the package's own metadata."""
    found = metadata(name)
    said = found.get("License-Expression") or found.get("License") or ""
    classifiers = [c.split(" :: ")[-1] for c in found.get_all("Classifier") or [] if c.startswith("License ::")]
    short = said.strip().splitlines()[0] if said.strip() else ""
    usable = 0 < len(short) < 60 and not short.startswith("License agreement")
    return found["Version"], short if usable else ", ".join(classifiers) or "see the package"


def page() -> str:
    rows = {}
    for requirement in requires("miniloop") or []:
        name = re.match(r"[\w.-]+", requirement)[0]
        if name == "miniloop":  # an extra that holds others
            continue
        extra = re.search(r"extra == ['\"](\w+)['\"]", requirement)
        rows.setdefault(name, []).append(extra[1] if extra else "the program")
    lines = []
    for name, needed in sorted(rows.items(), key=lambda row: ("the program" not in row[1], row[0].lower())):
        try:
            version, terms = licence(name)
        except PackageNotFoundError:
            version, terms = "not installed", ""
        lines.append(f"| {name} | {', '.join(needed)} | {version} | {terms} |")
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(__file__).with_name("licences.md").write_text(page(), encoding="utf-8")
