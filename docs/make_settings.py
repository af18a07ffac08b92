"""Writes docs/settings.md from the settings' own declarations: `python docs/make_settings.py`."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel

from miniloop_cli.cli.config import allowed, as_yaml, value_of
from miniloop_cli.config import Settings
from miniloop_cli.presets import PRESETS, keys, load_settings
from miniloop_cli.runtime.atomic_files import atomic_write

PAGE = Path(__file__).with_name("settings.md")
INTRODUCTION = """# Settings

<!-- Made by docs/make_settings.py from miniloop_cli/config.py; do not edit. -->

All settings of `miniloop register`. A preset or a YAML file sets them (`--config fast`, `--config mine.yaml`), and
`--set section.key=value` changes one. A key that the file does not name has its default. An unknown key is an error.
`config.yaml` in the results folder holds the settings of the run; `--config` reads it again.

    miniloop config show paper            # a preset as YAML, every key explained
    miniloop config explain ransac.score  # one key, with what the presets make of it
    miniloop config schema                # JSON schema, for editors

The last column shows where a preset differs from the default.
"""


def page() -> str:
    """The whole page."""
    presets = {name: load_settings(name) for name in PRESETS}
    parts = [INTRODUCTION]
    single = []
    for name, field in Settings.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            inside = [key for key in keys() if key.startswith(f"{name}.")]
            parts.append(f"## `{name}`\n\n{(field.annotation.__doc__ or '').strip()}\n\n{table(inside, presets)}")
        else:
            single.append(name)
    parts.insert(1, f"## Without a section\n\n{table(single, presets)}")
    return "\n".join(parts)


def table(names: list[str], presets: dict[str, Settings]) -> str:
    """A row a key."""
    rows = ["| key | default | allowed | what it does | presets |", "|---|---|---|---|---|"]
    known = keys()
    for name in names:
        field = known[name]
        default = as_yaml(field.default)
        others = [(preset, as_yaml(value_of(settings, name))) for preset, settings in presets.items()]
        differing = ", ".join(f"{preset}: {value}" for preset, value in others if value != default)
        meaning = (field.description or "").replace("|", "\\|")
        rows.append(f"| `{name}` | {default} | {allowed(field)} | {meaning} | {differing} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    with atomic_write(PAGE) as file:
        file.write(page())
