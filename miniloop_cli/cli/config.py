"""`miniloop config`: the settings, their meaning, and their values."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic.fields import FieldInfo


@click.group(context_settings=CONTEXT, short_help="Settings: show, explain, schema.")
def config() -> None:
    """Settings: show those in effect, explain one, or write their schema.

    \b
    Example:   miniloop config show paper
               miniloop config explain matching.ratio
               miniloop config show > mine.yaml   (then: register --config mine.yaml)
    """


@config.command(context_settings=CONTEXT, short_help="All settings as YAML, each with its meaning.")
@click.argument("name", metavar="[NAME|FILE]", default="default", shell_complete=options.complete("complete_preset"))
@options.overrides
def show(name: str, overrides: tuple[str, ...]) -> None:
    """Print the settings of a preset or file (default: default) as YAML, each with its meaning.

    The output can be saved, edited and given to `register --config`.

    \b
    Example:   miniloop config show fast --set features.count=2000
    """
    from miniloop_cli.presets import load_settings

    click.echo(described_yaml(load_settings(name, overrides)).strip().replace("\n\n\n", "\n\n"))


@config.command(context_settings=CONTEXT, short_help="JSON schema of a settings file, for editors.")
def schema() -> None:
    """Print the JSON schema of a settings file, for editors that check and complete YAML.

    \b
    Example:   miniloop config schema > miniloop.schema.json
    """
    from miniloop_cli.config import Settings

    options.write_json("-", Settings.model_json_schema())


@config.command(context_settings=CONTEXT, short_help="What a setting does and what it may be.")
@click.argument("key", metavar="KEY", shell_complete=options.complete("complete_key"))
def explain(key: str) -> None:
    """Explain a setting: its meaning, its possible values, and its values in the presets. KEY may be a section.

    \b
    Example:   miniloop config explain ransac.threshold_m
    """
    from miniloop_cli.presets import keys

    known = keys()
    inside = [name for name in known if name == key or name.startswith(f"{key}.")]
    if not inside:
        raise unknown_key(key, list(known))
    click.echo("\n\n".join(explanation(name, known[name]) for name in inside))


def unknown_key(key: str, known: list[str]) -> Exception:
    """The error for a key that does not exist, with the nearest ones."""
    import difflib

    from miniloop_cli.errors import ConfigError

    # "treshold_m" means ransac.threshold_m, so the last part alone is compared as well.
    tails = {name.rpartition(".")[2]: name for name in reversed(known)}
    near = difflib.get_close_matches(key, known, n=1)
    near = near or [tails[tail] for tail in difflib.get_close_matches(key.rpartition(".")[2], tails, n=1)]
    hint = f"did you mean '{near[0]}'?" if near else "see 'miniloop config show'"
    return ConfigError(f"unknown setting '{key}'; {hint}")


def explanation(key: str, field: FieldInfo) -> str:
    """One setting in a few lines that fit 80 columns."""
    from miniloop_cli.presets import PRESETS, load_settings

    values = {preset: as_yaml(value_of(load_settings(preset), key)) for preset in PRESETS}
    others = ", ".join(f"{preset} {value}" for preset, value in values.items() if value != as_yaml(field.default))
    lines = [key, f"  {field.description}", f"  allowed  {allowed(field)}", f"  default  {as_yaml(field.default)}"]
    if others:
        lines.append(f"  presets  {others}")
    return "\n".join(options.wrapped(line) for line in lines)


def allowed(field: FieldInfo) -> str:
    """The possible values of a setting in words: its choices, or its type and range."""
    from miniloop_cli.setting_choices import choices

    if named := choices(field):
        return ", ".join(map(as_yaml, named))
    words = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
    limits = [
        f"{text} {getattr(item, name):g}"
        for item in field.metadata
        for name, text in words.items()
        if getattr(item, name, None) is not None
    ]
    kinds: dict[Any, str] = {int: "whole number", float: "number", bool: "true or false", str: "text"}
    return ", ".join([kinds[field.annotation], *limits])


def value_of(settings: BaseModel, key: str) -> Any:
    """The value of a dotted key."""
    value: Any = settings
    for part in key.split("."):
        value = getattr(value, part)
    return value


def as_yaml(value: Any) -> str:
    """A plain value as YAML writes it."""
    import yaml

    return yaml.safe_dump(value, default_flow_style=True, width=1000).removesuffix("\n").removesuffix("\n...")


def described_yaml(settings: BaseModel, indent: str = "") -> str:
    """All settings as YAML with each description as a comment above its key."""
    from pydantic import BaseModel

    lines = []
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if isinstance(value, BaseModel):
            lines.append(f"\n{indent}# {(type(value).__doc__ or '').strip()}\n{indent}{name}:\n")
            lines.append(described_yaml(value, indent + "  ") + "\n")
            continue
        changed = "" if value == field.default else f" (default {as_yaml(field.default)})"
        lines.append(options.wrapped(f"{indent}# {field.description}{changed}", f"{indent}# ") + "\n")
        lines.append(f"{indent}{name}: {as_yaml(value)}\n")
    return "".join(lines)
