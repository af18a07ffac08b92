"""The site holds, beside docs/, the files of the repository that its pages link to."""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
PAGES = ("BENCHMARK.md", "CHANGELOG.md", "CONTRIBUTING.md", "CODE_OF_CONDUCT.md", "SECURITY.md")
FOLDERS = ("examples", "scripts")
SINGLE = ("LICENSE", "Dockerfile")
WHOLE = 20
"""The largest number of letters of a word of code that stands on one line of a table."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and files from outside docs/, under repository/."""
    paths = [ROOT / name for name in (*PAGES, *SINGLE)]
    paths += [path for folder in FOLDERS for path in sorted((ROOT / folder).iterdir()) if path.is_file()]
    for path in paths:
        name = path.relative_to(ROOT).as_posix()
        shown = name if name.endswith(".md") else f"{name}.txt"
        files.append(File.generated(config, f"repository/{shown}", content=path.read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links between docs/ and the rest of the repository to where the files lie on the site."""
    here = page.file.src_uri
    outside = here.startswith("repository/")
    up = "../" * here.count("/")
    leave = "" if outside else f"{up}../"  # how a link leaves docs/ in the repository

    def moved(match: re.Match[str]) -> str:
        target, anchor = match[1], match[2] or ""
        name = target.removeprefix(leave)
        if not target.startswith(leave) or not (ROOT / name).exists():
            return match[0]
        if name.startswith("docs/"):
            return f"]({up}{name.removeprefix('docs/')}{anchor})"
        return f"]({up}repository/{name if name.endswith('.md') else name + '.txt'}{anchor})"

    return re.sub(r"\]\(([^)#:\s]+)(#[^)\s]*)?\)", moved, markdown)


def on_page_content(html: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Tables break neither words of code nor a number and its unit; paragraphs of help with columns keep their lines.

    The style sheet keeps code in the first column of a table on one line.
    """
    html = re.sub(r"(?<!<tr>\n)<td.*?</td>", lambda cell: _unbroken(cell[0]), html, flags=re.DOTALL)
    if page.file.src_uri != "cli.md":
        return html
    return re.sub(r"<p>([A-Z][a-z ]+:  .*?)</p>", r"<pre><code>\1</code></pre>", html, flags=re.DOTALL)


def _unbroken(cell: str) -> str:
    cell = re.sub(r"(?<=\d) (?=%|(?:[kMG]B|[cm]?m|[mµ]?s|deg|px)\b)", "\u00a0", cell)
    return re.sub(r"<code>[^<]*(?=</code>)", lambda code: "<code>" + re.sub(r"\S+", _word, code[0][6:]), cell)


def _word(match: re.Match[str]) -> str:
    """A short word of code stays whole; a long one may break behind its slashes, dots and underscores."""
    if len(match[0]) <= WHOLE:
        return f'<span class="whole">{match[0]}</span>'
    return re.sub(r"(?<=\w)([/._]+)(?=[\w*])", r"\1<wbr>", match[0])
