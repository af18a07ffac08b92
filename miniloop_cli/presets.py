"""Settings from a preset or a YAML file, overridden by `--set key=value`."""

from __future__ import annotations

import difflib
import logging
from collections.abc import Set
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from miniloop_cli.config import Settings
from miniloop_cli.errors import ConfigError
from miniloop_cli.runtime.safe_yaml import load_plain

LOG = logging.getLogger("miniloop")
PRESETS = ("default", "paper", "fast", "accurate")
# Names of release 0.1, accepted for this release. Settings first, then whole sections.
RENAMED = {
    "rough.min_alone": "rough.min_bridge_inliers",
    "gravity.min_alone": "gravity.min_bridge_inliers",
    "averaging.min_alone": "averaging.min_bridge_inliers",
    "averaging.min_alike": "averaging.min_photo_consistency",
    "matching.min_agreeing": "matching.min_distance_consistent",
    "matching.all_up_to": "matching.exhaustive_max_scans",
    "matching.similar": "matching.retrieval_k",
    "matching.neighbours": "matching.sequential_window",
    "verification.rescue_inliers": "verification.min_weak_inliers",
    "verification.second_round": "verification.guided_matching",
    "cycles.rescue": "cycles.loop_support",
    "rough": "pose_prior",
}


def keys(model: type[BaseModel] = Settings, prefix: str = "") -> dict[str, Any]:
    """Every dotted key with its field, in order of declaration."""
    found: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            found |= keys(field.annotation, f"{prefix}{name}.")
        else:
            found[prefix + name] = field
    return found


def preset_path(name: str) -> Path:
    """The file of a preset: inside the installed package, or beside it in a checkout. Raises ConfigError."""
    package = Path(__file__).parent
    for folder in (package / "configs", package.parent / "configs"):
        if (folder / f"{name}.yaml").is_file():
            return folder / f"{name}.yaml"
    raise ConfigError(f"preset '{name}' is missing from this installation; reinstall miniloop")


def load_settings(config: str | Path = "default", overrides: tuple[str, ...] = ()) -> Settings:
    """Settings from a preset's name or a YAML file, then `key=value` overrides (dotted keys, values as YAML).

    Raises ConfigError that names the key, the source and the nearest known key.
    """
    path = preset_path(str(config)) if str(config) in PRESETS else Path(config)
    if not path.is_file():
        near = difflib.get_close_matches(str(config), PRESETS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"give one of {', '.join(PRESETS)} or a YAML file"
        raise ConfigError(f"no settings '{config}'; {hint}")
    try:
        data = load_plain(path.read_text(encoding="utf-8")) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: not readable YAML ({' '.join(str(error).split())})") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: settings are 'section: {{key: value}}', found {type(data).__name__}")
    _use_new_names(data, str(path))
    for override in overrides:
        _apply(data, override)
    _use_new_names(data, "--set")
    return _validate(data, str(path), {override.partition("=")[0].strip() for override in overrides})


def _use_new_names(data: dict[str, Any], source: str) -> None:
    """Rename, in place, keys of release 0.1, and log the new names."""
    for old, new in RENAMED.items():
        section, _, name = old.rpartition(".")
        values = data.get(section) if section else data
        if not isinstance(values, dict) or name not in values:
            continue
        value, name = values.pop(name), new.rpartition(".")[2]
        both = isinstance(value, dict) and isinstance(values.get(name), dict)
        values[name] = values[name] | value if both else value
        LOG.warning("%s: '%s' is called '%s' now; the old name goes with the next release", source, old, new)


def _apply(data: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals:
        raise ConfigError(f"--set {override}: write it as key=value, for example --set features.count=2000")
    *sections, name = key.strip().split(".")
    for section in sections:
        data = data.setdefault(section, {})
        if not isinstance(data, dict):
            raise ConfigError(f"--set {override}: '{section}' is a value, not a section")
    try:
        data[name] = load_plain(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"--set {override}: the value is not readable YAML") from error


def _validate(data: dict[str, Any], source: str, overridden: Set[str] = frozenset()) -> Settings:
    try:
        return Settings.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        source = "--set" if key in overridden else source
        if first["type"] == "extra_forbidden":
            near = difflib.get_close_matches(key, list(keys()) + list(Settings.model_fields), n=1)
            hint = f"; did you mean '{near[0]}'?" if near else "; see 'miniloop config show'"
            raise ConfigError(f"{source}: unknown setting '{key}'{hint}") from None
        raise ConfigError(
            f"{source}: setting '{key}': {first['msg'].replace('Input should', 'must')} (given: {first['input']!r})"
        ) from None
