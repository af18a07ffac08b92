"""`miniloop config`: what it shows can be used, what it explains is so."""

import json
import logging

import pytest
import yaml
from command_line import invoke, launch

from miniloop_cli.config import Settings
from miniloop_cli.presets import PRESETS, RENAMED, keys, load_settings


@pytest.mark.parametrize("preset", PRESETS)
def test_what_is_shown_is_what_is_in_effect_and_can_be_given_back(preset, tmp_path):
    shown = invoke("config", "show", preset).stdout
    path = tmp_path / "mine.yaml"
    path.write_text(shown)
    assert load_settings(path) == load_settings(preset)
    assert max(len(line) for line in shown.splitlines()) <= 80


def test_every_setting_is_shown_with_its_meaning():
    words = " ".join(invoke("config", "show").stdout.replace("#", " ").split())
    for key, field in keys().items():
        assert field.description, key
        assert " ".join(field.description.replace("#", " ").split()) in words


def test_overrides_and_the_default_beside_them():
    shown = invoke("config", "show", "--set", "features.type=orb").stdout
    assert yaml.safe_load(shown)["features"]["type"] == "orb"
    assert "(default rootsift)" in shown
    assert "(default" not in invoke("config", "show").stdout


@pytest.mark.parametrize("given", ["on", "off", "true", "false", "auto"])
def test_tracking_is_automatic_or_switched_on_or_off(given, tmp_path):
    meant = {"true": True, "on": True, "false": False, "off": False}.get(given, given)
    shown = invoke("config", "show", "--set", f"tracking.enabled={given}").stdout
    assert yaml.safe_load(shown)["tracking"]["enabled"] is meant or meant == "auto"
    file = tmp_path / "mine.yaml"
    file.write_text(f"tracking:\n  enabled: {given}\n")
    assert yaml.safe_load(invoke("config", "show", file).stdout)["tracking"]["enabled"] == meant
    assert launch("config", "show", "--set", "tracking.enabled=perhaps").returncode == 1


def test_schema_is_that_of_the_settings():
    schema = json.loads(invoke("config", "schema").stdout)
    assert schema == Settings.model_json_schema()
    assert schema["additionalProperties"] is False


def test_explain_one_setting():
    text = invoke("config", "explain", "matching.ratio").stdout
    field = keys()["matching.ratio"]
    assert text.splitlines()[0] == "matching.ratio"
    assert field.description in " ".join(text.split())
    assert f"default  {field.default}" in text
    assert "number, above 0, at most 1" in text


def test_explain_choices_and_presets():
    text = invoke("config", "explain", "features.type").stdout
    assert "allowed  rootsift, sift, orb, surf, akaze, brisk" in text
    assert "paper surf" in text


def test_explain_every_setting_and_section():
    for key in keys():
        assert invoke("config", "explain", key).exit_code == 0
    section = invoke("config", "explain", "ransac").stdout
    assert [line for line in section.splitlines() if line and not line.startswith(" ")] == [
        key for key in keys() if key.startswith("ransac.")
    ]


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("features.cuont", "features.count"),
        ("treshold_m", "ransac.threshold_m"),
        ("refin", "refine"),
        ("zzzz", "config show"),
    ],
)
def test_misspelt_keys_are_answered(key, near):
    done = launch("config", "explain", key)
    assert done.returncode == 1
    assert near in done.stderr


def test_names_of_release_0_1_are_accepted_and_answered_with_the_new_name(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(logging.getLogger("miniloop"), "propagate", True)  # commands of other tests turn it off
    caplog.set_level(logging.WARNING, "miniloop")
    path = tmp_path / "old.yaml"
    path.write_text(
        "matching: {all_up_to: 50, similar: 9}\nrough: {max_deg: 7, min_alone: 5}\ncycles: {rescue: false}\n"
    )
    settings = load_settings(path, ("averaging.min_alone=11", "rough.max_m=0.2"))
    assert (settings.matching.exhaustive_max_scans, settings.matching.retrieval_k) == (50, 9)
    prior = settings.pose_prior
    assert (prior.max_deg, prior.min_bridge_inliers, prior.max_m) == (7, 5, 0.2)
    assert not settings.cycles.loop_support and settings.averaging.min_bridge_inliers == 11
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 7 and all("is called" in line for line in told)
    assert any("'matching.all_up_to' is called 'matching.exhaustive_max_scans' now" in line for line in told)


def test_both_names_of_the_pose_prior_are_wrong_usage(tmp_path):
    done = launch("register", tmp_path, "--init", tmp_path / "a.txt", "--pose-prior", tmp_path / "b.txt")
    assert done.returncode == 2
    assert "--init is the old name of --pose-prior" in done.stderr


def test_every_new_name_exists():
    sections = set(Settings.model_fields)
    assert set(RENAMED.values()) - sections <= set(keys()) | {"rough.min_bridge_inliers"}
