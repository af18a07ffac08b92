"""What holds on systems that the tests may not run on: no module needs POSIX, files that are open are waited for."""

import ast
import os
import time

import pytest
from command_line import ROOT

from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.atomic_files import DAY_S, HOST, remove_leftovers, replace
from miniloop_cli.runtime.cache_folder import cache_folder

POSIX_ONLY = {
    *("fcntl", "grp", "posix", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty"),
    *("_posixsubprocess", "curses", "nis", "ossaudiodev", "spwd", "crypt"),
}
POSIX_ONLY_CALLS = {
    *(
        "os.fork",
        "os.getppgid",
        "os.geteuid",
        "os.getgid",
        "os.getuid",
        "os.killpg",
        "os.mkfifo",
        "os.nice",
        "os.setsid",
    ),
    *("os.sysconf", "os.uname", "os.statvfs", "os.chown", "os.O_NONBLOCK", "os.sched_getaffinity", "os.wait"),
    *("signal.SIGALRM", "signal.SIGHUP", "signal.SIGKILL", "signal.setitimer", "signal.alarm", "signal.pause"),
}


def run_on_import(tree):
    """Every node of a module that is run when it is imported: all but the bodies of functions."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        children = ast.iter_child_nodes(node)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            children = ()
        waiting.extend(children)


def posix_only(source):
    """Modules and names in a source that other systems do not have and that its import needs."""
    found = set()
    for node in run_on_import(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names} & POSIX_ONLY
        elif isinstance(node, ast.ImportFrom):
            found |= {(node.module or "").partition(".")[0]} & POSIX_ONLY
            found |= {f"{node.module}.{alias.name}" for alias in node.names} & POSIX_ONLY_CALLS
        elif isinstance(node, ast.Attribute):
            found |= {ast.unparse(node)} & POSIX_ONLY_CALLS
    return found


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import fcntl", {"fcntl"}),
        ("if True:\n    from resource import getrusage", {"resource"}),
        ("import os\nclass Host:\n    name = os.uname().nodename", {"os.uname"}),
        ("from signal import SIGALRM", {"signal.SIGALRM"}),
        ("def peak():\n    import resource", set()),
        ("import os, signal, mmap", set()),
    ],
)
def test_what_only_posix_has_is_seen(source, expected):
    assert posix_only(source) == expected


@pytest.mark.slow
def test_no_module_needs_posix_to_be_imported():
    sources = sorted((ROOT / "miniloop_cli").rglob("*.py"))
    assert len(sources) > 200
    found = {path.relative_to(ROOT).as_posix(): posix_only(path.read_text(encoding="utf-8")) for path in sources}
    assert {path: names for path, names in found.items() if names} == {}


class OpenElsewhere:
    """A file that cannot be renamed until it was tried so many times, as Windows has them."""

    def __init__(self, refusals):
        self.refusals = refusals

    def replace(self, path):
        if self.refusals:
            self.refusals -= 1
            raise PermissionError(13, "The process cannot access the file because it is being used by another process")
        path.write_text("renamed")


def test_a_file_that_is_open_elsewhere_is_waited_for(tmp_path):
    replace(OpenElsewhere(3), tmp_path / "edges.csv", patience_s=60)
    assert (tmp_path / "edges.csv").read_text() == "renamed"
    with pytest.raises(PermissionError):
        replace(OpenElsewhere(10**6), tmp_path / "edges.csv", patience_s=0.1)
    with pytest.raises(PermissionError):
        replace(OpenElsewhere(1), tmp_path / "edges.csv", patience_s=0)


def test_leftovers_are_told_by_age_where_processes_cannot_be_asked(tmp_path):
    names = [f".{name}.miniloop-{HOST}-{os.getpid()}.tmp" for name in ("edges.csv", "room", "cloud.ply")]
    old, old_folder, young = (tmp_path / name for name in names)
    old.write_text("")
    old_folder.mkdir()
    young.write_text("")
    for path in (old, old_folder):
        os.utime(path, (time.time() - 2 * DAY_S,) * 2)
    remove_leftovers(tmp_path, by_age=True)
    assert list(tmp_path.iterdir()) == [young]


def test_where_the_cache_is(tmp_path, monkeypatch):
    assert cache_folder() == type(tmp_path)(os.environ["MINILOOP_CACHE"])
    monkeypatch.setenv("MINILOOP_CACHE", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if os.name == "posix":
        assert cache_folder() == tmp_path / "miniloop"
    assert cache_folder().is_absolute()


@pytest.mark.skipif(os.name != "posix", reason="users without a home are a matter of containers")
def test_no_home_is_said(monkeypatch):
    for name in ("MINILOOP_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.getuid", lambda: 2**30)
    with pytest.raises(MiniloopError, match="set MINILOOP_CACHE"):
        cache_folder()
