"""Settings: typed, documented, unknown keys refused; presets in YAML, overridden by `--set key=value`."""

from __future__ import annotations

import difflib
from collections.abc import Set
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from miniloop_cli.errors import ConfigError
from miniloop_cli.runtime.safe_yaml import load_plain

PRESETS = ("default", "paper", "fast", "accurate")


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Depth(Section):
    """Which depth readings are believed."""

    min_m: float = Field(0.3, ge=0, description="Nearest depth that is used (m).")
    max_m: float = Field(8.0, gt=0, description="Farthest depth that is used (m).")
    edge_ratio: float = Field(
        0.04, gt=0, description="A feature whose four neighbouring readings differ by more than this share is dropped."
    )


class Features(Section):
    """What is detected in the colour images."""

    type: Literal["rootsift", "sift", "orb", "surf", "akaze", "brisk"] = Field(
        "rootsift", description="Detector and descriptor."
    )
    count: int = Field(3000, ge=16, description="Strongest features kept in a scan.")
    contrast: float = Field(
        0.02, gt=0, description="SIFT: contrast threshold; lower finds more in dim or plain images."
    )


class Matching(Section):
    """Which features of two scans are taken for the same point."""

    ratio: float = Field(0.8, gt=0, le=1, description="Nearest over second-nearest descriptor distance, at most.")
    pairs: str = Field("auto", description="auto, exhaustive, sequential, or a file of lines 'i j' (frame numbers).")
    count: int = Field(1200, ge=16, description="Strongest features of a scan in a full comparison.")
    min_agreeing: int = Field(
        6, ge=0, description="auto: a pair with fewer matches that all agree in their distances is left out."
    )
    all_up_to: int = Field(
        200, ge=2, description="auto: up to so many scans every pair is looked at; beyond, retrieval."
    )
    similar: int = Field(40, ge=1, description="auto, beyond all_up_to: scans that look most alike, per scan.")
    neighbours: int = Field(10, ge=1, description="sequential, and beyond all_up_to: frames after each frame.")
    min_matches: int = Field(12, ge=3, description="T of the paper: an edge of the graph needs this many matches.")


class Ransac(Section):
    """The robust estimator of a pair and of a cycle."""

    score: Literal["msac", "count"] = Field(
        "msac",
        description="msac: truncated noise-scaled residuals; count: inliers within threshold_m, as in the paper.",
    )
    threshold_m: float = Field(0.08, gt=0, description="Inlier distance while sampling (m); loose on purpose.")
    iterations: int = Field(2000, ge=1, description="Most hypotheses an estimation.")
    confidence: float = Field(0.999, gt=0, lt=1, description="Stop when an all-inlier sample was drawn this surely.")
    adaptive: bool = Field(True, description="Stop early; off: always `iterations` hypotheses, as in the paper.")
    local_optimization: bool = Field(True, description="Gauss-Newton on all inliers of all edges of the cycle.")


class Verification(Section):
    """When an edge is believed."""

    chi2: float = Field(16.0, gt=0, description="A match is an inlier below this squared Mahalanobis distance.")
    min_inliers: int = Field(10, ge=3, description="Inliers that a verified edge needs.")
    min_share: float = Field(0.2, ge=0, le=1, description="... and their share of the matches.")
    rescue_inliers: int = Field(6, ge=3, description="Enough for a frame that would hang on fewer than three edges.")
    second_round: bool = Field(
        True, description="Match pairs that failed again where averaged poses say that their scans overlap."
    )


class Cycles(Section):
    """The decomposition of the overlap graph and its joint estimation."""

    longest: Literal[2, 3, 4, 5, 6, 7] = Field(5, description="Longest cycle; 2: every edge alone (pairwise).")
    decomposition: Literal["dfs", "support"] = Field(
        "support",
        description="dfs: the paper's depth-first search; support: weak edges get strong partners, few are left over.",
    )
    rescue: bool = Field(
        True, description="Try edges that were not verified again, in loops over edges that were; agreeing loops vouch."
    )


class Gravity(Section):
    """With `--gravity`: how far an accelerometer is believed."""

    max_median_deg: float = Field(
        4.0, gt=0, description="Gravity that contradicts the sure edges by more, at the median, is not used (degrees)."
    )
    agree_deg: float = Field(4.0, gt=0, description="An edge that agrees so well is confirmed by it (degrees).")
    max_deg: float = Field(
        8.0,
        gt=0,
        description="An edge that contradicts the vertical by more, and by 4 times that median, is dropped (degrees).",
    )
    min_alone: int = Field(
        8, ge=3, description="In place of averaging.min_alone for edges that gravity confirms: inliers without a loop."
    )


class Rough(Section):
    """With `--init`: how far rough relative poses may be off."""

    max_deg: float = Field(20.0, gt=0, description="An edge that contradicts rough poses by more is dropped (degrees).")
    max_m: float = Field(0.5, gt=0, description="An edge that contradicts rough poses by more is dropped (m).")
    min_alone: int = Field(
        8, ge=3, description="In place of averaging.min_alone for edges that agree: inliers without a loop."
    )


class Averaging(Section):
    """From relative to absolute poses."""

    rotations: Literal["robust", "plain"] = Field("robust", description="L1 then IRLS; plain: without weights.")
    rotation_scale_deg: float = Field(3.0, gt=0, description="Geman-McClure scale of the IRLS (degrees).")
    translations: Literal["robust", "plain"] = Field("robust", description="Reweighted; plain: one least squares.")
    translation_scale_m: float = Field(0.03, gt=0, description="Scale of the translation reweighting (m).")
    max_residual_deg: float = Field(5.0, gt=0, description="An edge farther off than this is dropped (degrees).")
    max_residual_m: float = Field(0.10, gt=0, description="An edge farther off than this is dropped (m).")
    min_alike: float = Field(
        0.4, ge=0, lt=1, description="Share of what two scans both see that must look alike in both; 0: not checked."
    )
    min_alone: int = Field(20, ge=0, description="Inliers that an edge needs which no loop of edges confirms.")


class Bundle(Section):
    """The joint refinement by bundle adjustment over feature tracks."""

    max_scans: int = Field(3000, ge=2, description="Of more scans only the pose graph is refined: time is bounded so.")
    partners: int = Field(15, ge=1, description="Scans that each scan is matched with again, guided by the poses.")
    radius_px: float = Field(8.0, gt=0, description="How far from its predicted place a feature is looked for (px).")
    max_distance2: float = Field(0.3, gt=0, description="Squared descriptor distance of a guided match, at most.")
    min_frames: int = Field(3, ge=2, description="Scans that a track must be seen in.")
    depth_sigma_factor: float = Field(2.0, gt=0, description="Depth noise in units of the sensor model.")
    timing: bool = Field(
        True,
        description="Estimate rolling shutter and the lag of depth behind colour from the recording, if observable.",
    )
    motion: bool = Field(
        True,
        description="With timing: estimate the motion within each frame from its own rows; off: by the path of poses.",
    )


class Cloud(Section):
    """The model that is written."""

    voxel_m: float = Field(0.01, gt=0, description="One point a voxel of this edge length (m).")
    stride_px: int = Field(4, ge=1, description="Every so manieth pixel of a scan enters the model.")


class Settings(Section):
    """All settings of `miniloop register`."""

    depth: Depth = Depth()
    features: Features = Features()
    matching: Matching = Matching()
    ransac: Ransac = Ransac()
    verification: Verification = Verification()
    cycles: Cycles = Cycles()
    gravity: Gravity = Gravity()
    rough: Rough = Rough()
    averaging: Averaging = Averaging()
    refine: Literal["none", "posegraph", "bundle"] = Field("bundle", description="Joint refinement of all poses.")
    bundle: Bundle = Bundle()
    cloud: Cloud = Cloud()


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
    """Where a preset lies: inside the installed package, or beside it in a checkout."""
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
    for override in overrides:
        _apply(data, override)
    return _validate(data, str(path), {override.partition("=")[0].strip() for override in overrides})


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
