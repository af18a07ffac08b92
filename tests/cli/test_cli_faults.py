"""Full disks, missing permissions, little memory, dying workers, damaged artefacts: what is finished stays valid."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import command, contents, differing, environment, run_process

from miniloop_cli.runtime.artifact_store import Artifact, Store
from miniloop_cli.runtime.atomic_files import HOST, atomic_write
from miniloop_cli.runtime.folder_lock import exclusive
from miniloop_cli.stages.artifacts import EDGES

# Root may write everywhere; without these capabilities it is held to the same permissions as anybody.
LIKE_ANYBODY = ("setpriv", "--bounding-set", "-dac_override,-dac_read_search", "--inh-caps", "-all")
posix = pytest.mark.skipif(os.name != "posix", reason="permissions, signals and numbers of processes as POSIX has them")


@pytest.fixture
def small_disk(tmp_path):
    """A function that mounts an empty file system of so many bytes, or makes the mounted one as large."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(size, how="defaults"):
        line = ["mount", "-t", "tmpfs", "-o", f"{how},size={size}", "tmpfs", folder]
        if shutil.which("mount") is None or subprocess.run(line, capture_output=True, check=False).returncode:
            pytest.skip("mounting a small file system is not permitted here")
        return folder

    yield mount
    subprocess.run(["umount", folder], capture_output=True, check=False)


def whole(folder, reference):
    """Visible files of a folder, each of which must be that of the reference."""
    found = {name: content for name, content in contents(folder).items() if not name.startswith(".")}
    assert all(reference[name] == content for name, content in found.items())
    return set(found)


@pytest.mark.slow
def test_a_disk_that_fills_and_is_given_room(registered, recording, shared, tmp_path, small_disk):
    reference = contents(registered.folder)
    output = small_disk("100k") / "out"
    done = run_process("register", recording, "-o", output, "-q", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "No space left on device; free some space or choose -o" in done.stderr
    left = whole(output, reference)
    assert "edges.csv" in left
    assert "trajectory.txt" not in left
    small_disk("50m", "remount")
    assert run_process("register", recording, "-o", output, "-q", cwd=tmp_path).returncode == 0
    assert differing(output, registered.folder) == []


@pytest.mark.slow
def test_a_cache_that_fills_costs_time_only(registered, recording, tmp_path, small_disk):
    cache = small_disk("700k")
    done = run_process("register", recording, "-o", tmp_path / "out", "-q", cwd=tmp_path, MINILOOP_CACHE=cache)
    assert (done.returncode, done.stderr) == (0, "")
    assert differing(tmp_path / "out", registered.folder) == []
    kept = list(cache.rglob("*.npz"))
    assert kept
    assert [path for path in cache.rglob("*") if path.is_file()] == kept
    assert all(Store(cache).load(Artifact(path.parent.name, 1), path.stem) is not None for path in kept)


@pytest.mark.slow
def test_a_simulation_on_a_full_disk_leaves_nothing(tmp_path, small_disk):
    disk = small_disk("300k")
    done = run_process("simulate", disk / "room", "--frames", 9, "--width", 320, "--height", 240, "-q", cwd=tmp_path)
    assert done.returncode == 1
    assert "cannot write" in done.stderr
    assert "No space left" in done.stderr
    assert list(disk.iterdir()) == []


@pytest.mark.slow
@posix
def test_no_permission_to_write(registered, recording, tmp_path):
    prefix = LIKE_ANYBODY if os.geteuid() == 0 else ()
    if prefix and not shutil.which(prefix[0]):
        pytest.skip("needs setpriv to give up root's rights")
    closed = tmp_path / "closed"
    closed.mkdir()
    readonly = Path(shutil.copytree(recording, closed / "room"))
    for path in (*readonly.rglob("*"), readonly, closed):
        path.chmod(0o555 if path.is_dir() else 0o444)

    def run(output, **variables):
        line = [*prefix, *command("register", readonly, "-o", output, "-q")]
        return subprocess.run(
            line, capture_output=True, text=True, cwd=tmp_path, env=environment(**variables), check=False
        )

    done = run(closed / "out", MINILOOP_CACHE=tmp_path / "cache")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"miniloop: cannot write to {closed / 'out'}: Permission denied; choose another -o\n"
    done = run(tmp_path / "out", MINILOOP_CACHE=closed / "cache")  # nor a cache: only time is lost
    assert (done.returncode, done.stderr) == (0, "")
    made, expected = contents(tmp_path / "out"), contents(registered.folder)
    assert made["trajectory.txt"] == expected["trajectory.txt"]
    assert made["edges.csv"] == expected["edges.csv"]
    for path in (closed, readonly, *readonly.rglob("*")):
        path.chmod(0o755)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc; RLIMIT_AS is not heeded elsewhere")
@pytest.mark.parametrize("more_mb", [40, 200])
def test_too_little_memory_is_said_and_more_of_it_continues(recording, registered, tmp_path, more_mb):
    """Limited once the libraries are loaded: while they are, some of them end the process by themselves."""
    script = (
        "import miniloop_cli.api, miniloop_cli.pipeline, miniloop_cli.report, mahotas, resource, sys\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + int(sys.argv[1]) * 2**20,) * 2)\n"
        "from miniloop_cli.cli.main import main\n"
        "main(sys.argv[2:])\n"
    )
    output, cache = tmp_path / "out", tmp_path / "cache"
    arguments = ("register", recording, "-o", output, "-q", "-j", "1")
    line = [*command()[:1], "-c", script, str(more_mb), *map(str, arguments)]
    variables = {"MINILOOP_CACHE": cache}
    done = subprocess.run(
        line, capture_output=True, text=True, cwd=tmp_path, env=environment(**variables), check=False, timeout=200
    )
    if more_mb < 128 or done.returncode:
        message = "miniloop: out of memory: use fewer frames (--max-frames) or fewer jobs (--jobs 1)\n"
        assert (done.returncode, done.stderr) == (1, message)
    if output.exists():
        whole(output, contents(registered.folder))
    assert run_process(*arguments, cwd=tmp_path, **variables).returncode == 0
    assert differing(output, registered.folder) == []


@pytest.mark.slow
@posix
def test_a_helper_that_dies_is_not_missed(registered, recording, tmp_path):
    """The process that compiles ahead is killed as soon as it is there."""
    script = (
        "import miniloop_cli.warmup as ahead, os, signal, sys\n"
        "ahead.compiled = lambda: False\n"
        "helper = ahead.compile_in_background()\n"
        "os.kill(helper.pid, signal.SIGKILL)\n"
        "assert helper.wait() == -signal.SIGKILL\n"
        "from miniloop_cli.cli.main import main\n"
        "main(sys.argv[1:])\n"
    )
    line = [*command()[:1], "-c", script, "register", recording, "-o", tmp_path / "out", "-q", "-j", "2"]
    done = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, env=environment(), check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert differing(tmp_path / "out", registered.folder) == []


def damages():
    """Ways in which a file on disk may come to harm, each a function from the content to another."""
    rng = np.random.default_rng(0)
    for share in rng.random(40):
        yield lambda content, share=share: flipped(content, int(share * len(content)))
    for share in (0.0, 0.3, 0.999):
        yield lambda content, share=share: content[: int(share * len(content))]
    yield lambda content: b"\0" * len(content)
    yield lambda content: content + b"\0"


def flipped(content, position):
    return content[:position] + bytes([content[position] ^ 0x10]) + content[position + 1 :]


def test_every_damage_to_an_artefact_is_noticed(tmp_path):
    """One bit anywhere, also in the names, shapes and tables of the zip file, which have no checksum of their own."""
    store, arrays = Store(tmp_path), {"a": np.arange(30.0).reshape(10, 3), "name": np.array(["x", "yz"])}
    path = store.path(EDGES, "k")
    store.save(EDGES, "k", arrays)
    content = path.read_bytes()
    every_byte = [lambda content, k=k: flipped(content, k) for k in range(len(content))]
    for damage in (*every_byte, *damages()):
        path.write_bytes(damage(content))
        assert store.load(EDGES, "k") is None
        assert not path.exists()
    store.save(EDGES, "k", arrays)
    assert path.read_bytes() == content
    loaded = store.load(EDGES, "k")
    assert loaded.keys() == arrays.keys()
    assert all(np.array_equal(loaded[name], arrays[name]) for name in arrays)


@pytest.mark.slow
def test_damaged_artefacts_are_made_again(registered, recording, tmp_path):
    cache, output = tmp_path / "cache", tmp_path / "out"
    arguments = ("register", recording, "-o", output, "-q")
    assert run_process(*arguments, cwd=tmp_path, MINILOOP_CACHE=cache).returncode == 0
    paths = sorted(cache.rglob("*.npz"))
    before = {path: path.read_bytes() for path in paths}
    for path, damage in zip(paths, list(damages())[-len(paths) :], strict=True):
        path.write_bytes(damage(before[path]))
    assert run_process(*arguments, cwd=tmp_path, MINILOOP_CACHE=cache).returncode == 0
    assert {path: path.read_bytes() for path in cache.rglob("*.npz")} == before
    assert differing(output, registered.folder) == []


def test_the_lock_of_a_dead_process_does_not_stay(tmp_path):
    script = (
        "import sys, time; from pathlib import Path; from miniloop_cli.runtime.folder_lock import exclusive\n"
        "with exclusive(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    )
    line = [*command()[:1], "-c", script, str(tmp_path / "out")]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, text=True, env=environment())
    assert process.stdout.readline() == "held\n"
    with pytest.raises(Exception, match="in use by another run"), exclusive(tmp_path / "out"):
        pass
    process.kill()
    process.communicate()
    assert (tmp_path / "out" / ".lock").exists()
    with exclusive(tmp_path / "out"):
        pass
    assert not (tmp_path / "out").exists()


@posix
def test_leftovers_of_dead_processes_go_and_those_of_living_ones_stay(tmp_path):
    dead, alive = 2**31 - 1, os.getppid()
    gone = tmp_path / f".cloud.ply.miniloop-{HOST}-{dead}.tmp"
    stay = [
        tmp_path / f".cloud.ply.miniloop-{HOST}-{alive}.tmp",
        tmp_path / f".cloud.ply.miniloop-{HOST}x-{dead}.tmp",
        tmp_path / ".mine.tmp",
    ]
    for path in (gone, *stay):
        path.write_text("")
    with atomic_write(tmp_path / "cloud.ply") as file:
        file.write("x")
    assert set(tmp_path.iterdir()) == {*stay, tmp_path / "cloud.ply"}
