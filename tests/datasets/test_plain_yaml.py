"""Cameras and settings that would keep or crash the YAML loader: refused in one line, at once."""

import pytest

from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.errors import ConfigError, MiniloopError
from miniloop_cli.presets import load_settings

TEXTS = {
    "nested": "fx: " + "[" * 3000,
    "nested maps": "{a: " * 3000,
    "dashes": "- " * 3000,
    "impossible date": "fx: 2020-99-99",
    "code": "fx: !!python/object/apply:os.system ['touch evil']",
    "itself": "fx: &a [*a]",
    "not text": "fx: \x00",
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS.keys())
@pytest.mark.parametrize("read", [read_camera_file, load_settings])
def test_absurd_files_are_refused_in_one_line(tmp_path, monkeypatch, read, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(MiniloopError) as error:
        read(tmp_path / "c.yaml")
    assert "c.yaml" in str(error.value)
    assert str(error.value).isprintable()
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]


def test_absurd_values_on_the_command_line():
    with pytest.raises(ConfigError, match="not readable YAML"):
        load_settings("default", ("features.count=" + "[" * 3000,))
