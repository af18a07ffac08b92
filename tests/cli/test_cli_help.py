"""Help, completion, colours: the manners of the command line."""

import os
import re
import shutil
import subprocess
import sys

import click
import pytest
from command_line import ROOT, command, environment, invoke, run_process

from miniloop_cli.cli.main import cli


def every_command(group=cli, path=()):
    """(words, command) of every command, groups included."""
    for name in group.list_commands(click.Context(group)):
        found = group.get_command(click.Context(group), name)
        yield (*path, name), found
        if isinstance(found, click.Group):
            yield from every_command(found, (*path, name))


COMMANDS = dict(every_command())


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_help_of_every_command_has_an_example_that_is_understood(path):
    text = invoke(*path, "--help").stdout
    assert max(len(line) for line in text.splitlines() if "Example" not in line) <= 100
    example = re.search(r"Example: +(.*)", text)
    assert example, text
    # The first command of the example is one that exists, with options that exist.
    words = re.split(r"&&|[|>#]|<\(|\)", example[1].removeprefix("source <("))[0].split()
    assert words[0] == "miniloop"
    node, words = cli, words[1:]
    while isinstance(node, click.Group) and words and not words[0].startswith("-"):
        node, words = node.get_command(click.Context(node), words[0]), words[1:]
        assert node is not None, example[1]
    known = {option for parameter in node.params for option in parameter.opts}
    assert {word for word in words if word.startswith("-") and word != "-"} <= known


def test_help_and_completion_import_nothing_heavy():
    code = (
        "import sys; from miniloop_cli.cli.main import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "import miniloop_cli.cli.register, miniloop_cli.cli.completion\n"
        "heavy = {'numpy', 'cv2', 'numba', 'scipy', 'open3d', 'pydantic', 'networkx', 'yaml', 'rich'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment(), check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts(shell, tmp_path):
    script = invoke("completion", shell).stdout
    assert "_MINILOOP_COMPLETE" in script
    assert ('"$funcstack[1]" == _miniloop' in script) == (shell == "zsh")  # also at the second press of the key
    if shutil.which(shell):
        (tmp_path / "script").write_text(script)
        assert subprocess.run([shell, "-n", tmp_path / "script"], check=False).returncode == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("reg", {"register"}),
        ("register --feat", {"--features"}),
        ("register --features su", {"surf"}),
        ("register --config f", {"fast"}),
        ("register --set ransac.s", {"ransac.score="}),
        ("register --set ransac.score=m", {"ransac.score=msac"}),
        ("register --layout 7", {"7-scenes"}),
        ("config explain matching.ra", {"matching.ratio"}),
        ("cache p", {"prune"}),
    ],
)
def test_the_tab_key(words, expected, tmp_path):
    typed = ["miniloop", *words.split()]
    done = run_process(
        cwd=tmp_path,
        _MINILOOP_COMPLETE="bash_complete",
        COMP_WORDS=" ".join(typed),
        COMP_CWORD=len(typed) - 1,
    )
    assert {line.partition(",")[2] for line in done.stdout.split()} == expected


def on_a_terminal(*arguments, **variables):
    """What a command writes to a terminal."""
    ours, theirs = pytest.importorskip("pty").openpty()
    process = subprocess.Popen(
        command(*arguments), stdout=theirs, stderr=theirs, env=environment(TERM="xterm-256color", **variables)
    )
    os.close(theirs)
    written = b""
    while True:
        try:
            chunk = os.read(ours, 65536)
        except OSError:  # how Linux says that the other end was closed
            break
        if not chunk:
            break
        written += chunk
    os.close(ours)
    assert process.wait() == 0
    return written.decode()


@pytest.mark.slow
def test_no_color(tmp_path):
    def simulated(name, **variables):
        return on_a_terminal("simulate", tmp_path / name, "--frames", 2, "--width", 64, "--height", 48, **variables)

    color = re.compile(r"\x1b\[[0-9;]*3[0-9][0-9;]*m")
    assert color.search(simulated("colourful"))
    assert not color.search(simulated("plain", NO_COLOR=1))


@pytest.mark.parametrize("group", [(), ("bench",), ("config",), ("cache",)])
def test_lists_of_commands_are_not_cut_off(group):
    assert "..." not in invoke(*group, "--help").stdout.partition("Commands:")[2]


def test_version_and_module():
    assert ROOT.joinpath("miniloop_cli", "__main__.py").is_file()
    assert re.fullmatch(r"miniloop, version \d+\.\d+\.\d+(\.dev\d+)?\n", invoke("--version").stdout)
