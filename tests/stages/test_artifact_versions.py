"""Whoever changes what a stage computes changes the version of its artefact: what is kept would be stale else.

`stage_code.json` holds, of each kind of artefact, its version and a hash of the code that it is made by. Where that
code has changed and gives the same content as before, record it: python tests/stages/test_artifact_versions.py
"""

import ast
import hashlib
import json
import sys
from functools import cache
from pathlib import Path

import pytest

from miniloop_cli.report.cached_images import PICTURES
from miniloop_cli.results.write import CLOUD
from miniloop_cli.stages import artifacts

PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
PACKAGE = Path(artifacts.__file__).parents[1]
RECORDED = Path(__file__).with_name("stage_code.json")
MADE_BY = {
    artifacts.PROBED: "stages/track.py",
    artifacts.TRACKED: "stages/track.py",
    artifacts.FEATURES: "stages/extract.py",
    artifacts.MATCHES: "stages/match.py",
    artifacts.EDGES: "stages/solve_edges.py",
    artifacts.REPETITION: "verification/repetition.py",
    artifacts.GUIDED: "stages/guided_matching.py",
    artifacts.REFINED: "stages/refine.py",
    artifacts.JOINED: "stages/join.py",
    artifacts.SECOND_MODES: "stages/doubt.py",
    CLOUD: "results/write.py",
    PICTURES: "report/cached_images.py",
}
# What these do is in the key already (settings, versions), or changes no content (how work is spread, kept, told).
NOT_COUNTED = ("runtime", "errors", "typing", "config", "presets", "version", "stages/artifacts", "stages/run")


def source_of(module: str) -> Path | None:
    """The file of a module of the package that counts."""
    path = PACKAGE.joinpath(*module.split(".")[1:])
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    name = path.relative_to(PACKAGE).as_posix()
    return path if path.is_file() and not name.startswith(NOT_COUNTED) else None


@cache
def parsed(path: Path) -> tuple[str, tuple[Path, ...]]:
    """The code of a file without comments and docstrings, and the files of the package that it imports."""
    tree, imported = ast.parse(path.read_text(encoding="utf-8")), set[Path]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("miniloop_cli"):
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            imported |= {found for name in names if (found := source_of(name))}
        body = getattr(node, "body", None)
        if (
            isinstance(body, list)
            and body
            and isinstance(body[0], ast.Expr)
            and isinstance(body[0].value, ast.Constant)
        ):
            del body[0]
    return ast.dump(tree), tuple(sorted(imported))


def code_hash(root: str) -> str:
    """Hash of a file's code and of all that it imports, one way or another."""
    seen, waiting = set[Path](), [PACKAGE / root]
    while waiting:
        path = waiting.pop()
        if path not in seen:
            seen.add(path)
            waiting += parsed(path)[1]
    text = "".join(path.relative_to(PACKAGE).as_posix() + parsed(path)[0] for path in sorted(seen))
    return hashlib.sha256(text.encode()).hexdigest()


def today() -> dict[str, object]:
    made = {artifact.kind: [artifact.version, code_hash(root)] for artifact, root in MADE_BY.items()}
    return {"python": PYTHON} | made


@pytest.mark.parametrize("artifact", MADE_BY, ids=lambda artifact: artifact.kind)
def test_code_changes_with_its_version(artifact):
    recorded = json.loads(RECORDED.read_text())
    if recorded["python"] != PYTHON:
        pytest.skip(f"Python {recorded['python']} wrote the record, and versions write syntax trees in their own ways")
    version, code = recorded[artifact.kind]
    now = code_hash(MADE_BY[artifact])
    assert (artifact.version, now) == (version, code), (
        f"what makes '{artifact.kind}' has changed: where its content changes, change its version; then record both "
        f"with python tests/stages/{Path(__file__).name}"
    )


def test_every_kind_is_watched():
    kinds = {value.kind for value in vars(artifacts).values() if isinstance(value, artifacts.Artifact)}
    assert kinds <= {artifact.kind for artifact in MADE_BY}
    assert len({artifact.kind for artifact in MADE_BY}) == len(MADE_BY)


def test_an_exporter_is_no_part_of_what_features_are_made_by():
    before = code_hash(MADE_BY[artifacts.FEATURES])
    names = set()
    waiting = [PACKAGE / MADE_BY[artifacts.FEATURES]]
    while waiting:
        path = waiting.pop()
        if path not in names:
            names.add(path)
            waiting += parsed(path)[1]
    folders = {path.relative_to(PACKAGE).parts[0] for path in names}
    assert "features" in folders and not folders & {"export", "report", "results", "cli", "evaluation", "refinement"}
    assert before == code_hash(MADE_BY[artifacts.FEATURES])


if __name__ == "__main__":
    RECORDED.write_text(json.dumps(today(), indent=1) + "\n", encoding="utf-8")
