"""What CI runs, on this machine: `nox -s NAME`; `nox -l` lists the names."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import nox

nox.options.default_venv_backend = "uv|virtualenv"
nox.options.sessions = ["lint", "types", "test"]
nox.options.reuse_existing_virtualenvs = True


@nox.session
def lint(session: nox.Session) -> None:
    """Style, layers, spelling and whitespace, workflows."""
    session.install("-e", ".[dev]")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("lint-imports")
    session.run("pre-commit", "run", "--all-files")
    session.run("zizmor", "--offline", "-q", ".github/workflows")
    if shutil.which("actionlint"):  # a program of its own, not on PyPI
        session.run("actionlint", external=True)


@nox.session
def types(session: nox.Session) -> None:
    """mypy over the package."""
    session.install("-e", ".[test]")
    session.run("mypy")


@nox.session
def test(session: nox.Session) -> None:
    """The fast tests; further arguments go to pytest."""
    session.install("-e", ".[test]")
    session.run("python", "-m", "pytest", "-m", "not slow", *session.posargs)


@nox.session
def slow(session: nox.Session) -> None:
    """All tests; further arguments go to pytest."""
    session.install("-e", ".[test]")
    session.run("python", "-m", "pytest", *session.posargs)


@nox.session
def docs(session: nox.Session) -> None:
    """Figures and generated pages are up to date; the site builds without a warning."""
    session.install("-e", ".[docs]")
    session.run("python", "-m", "benchmarks", "figures", "--check")
    session.run("mkdocs", "build", "--strict")


@nox.session
def bench(session: nox.Session) -> None:
    """A benchmark: `nox -s bench -- averaging --help`."""
    session.install("-e", ".[bench]")
    session.run("python", "-m", "benchmarks", *(session.posargs or ["--help"]))


@nox.session
def build(session: nox.Session) -> None:
    """Wheel and sdist; each is installed in an environment of its own, and the demo is run from it."""
    session.install("build", "twine")
    for old in Path("dist").glob("miniloop-*"):
        old.unlink()
    session.run("python", "-m", "build")
    packages = sorted(Path("dist").resolve().glob("miniloop-*"))
    session.run("twine", "check", "--strict", *map(str, packages))
    for package in packages:
        place = Path(session.create_tmp()).resolve() / package.suffix.lstrip(".")
        session.run("python", "-m", "venv", "--clear", str(place))
        scripts = place / ("Scripts" if sys.platform == "win32" else "bin")
        session.run(str(scripts / "python"), "-m", "pip", "install", "-q", str(package), external=True)
        with session.chdir(place):
            session.run(str(scripts / "miniloop"), "demo", external=True)
