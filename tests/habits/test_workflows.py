"""Workflows use pinned actions and sessions that exist; the version stands in one place."""

import re
from pathlib import Path

import yaml

from miniloop_cli.version import __version__

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def steps():
    """Every step of every workflow."""
    for path in WORKFLOWS:
        for job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"].values():
            yield from job["steps"]


def test_actions_are_pinned_by_hash():
    used = [step["uses"] for step in steps() if "uses" in step]
    assert used
    assert [one for one in used if not re.fullmatch(r"[\w.-]+/[\w.-]+@[0-9a-f]{40}", one)] == []


def test_one_action_has_one_version():
    text = "\n".join(path.read_text(encoding="utf-8") for path in WORKFLOWS)
    pins = set(re.findall(r"uses: (\S+)@(\S+ # \S+)", text))
    assert len({name for name, _ in pins}) == len(pins)


def test_sessions_of_nox_exist():
    sessions = set(re.findall(r"^@nox\.session\ndef (\w+)", (ROOT / "noxfile.py").read_text(), re.MULTILINE))
    pages = [ROOT / "CONTRIBUTING.md", ROOT / "README.md", ROOT / ".github" / "pull_request_template.md", *WORKFLOWS]
    for page in pages:
        for words in re.findall(r"nox -s ([a-z ]+)", page.read_text(encoding="utf-8")):
            assert set(words.split()) <= sessions, (page.name, words)


def test_the_changelog_begins_with_this_version_or_unreleased():
    heads = re.findall(r"^## \[?([\w.]+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert heads[0] == "Unreleased" or heads[0] == __version__
    assert __version__ in heads


def test_the_readme_fits_and_names_the_two_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) < 120
    assert "\npip install . && miniloop demo\n" in text
    assert "\npip install -e '.[test]' && python -m pytest\n" in text
