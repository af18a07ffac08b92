"""Kill runs at random moments and start them again with the same command: nothing may be lost.

    python tests/stress/kills.py [KILLS] [SEED]

A small recording is simulated and taken once undisturbed through `register`, `mesh`, `export` and `simulate`. Then each
command is started again and again on an empty cache and folder (every other time on a folder that holds an earlier
result), and gets SIGKILL, SIGTERM or SIGINT, alone or with its whole process group, when it has used a random share of
the processor seconds that the undisturbed run took; the same command, with another number of jobs, follows until one
gets through. After each kill, every visible file must be, byte for byte, the undisturbed run's (or the earlier
result's), and so must be every artefact in the cache; an artefact that is made twice was lost. In the end all files
must be the undisturbed run's, and no other may be there. Needs Linux (/proc).
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "cli"))
from command_line import command, contents, environment

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TICKS_S = 1 / os.sysconf("SC_CLK_TCK")
INTERRUPTED = "miniloop: interrupted; finished work is kept, the same command continues\n"
RECORDING = ("--frames", 6, "--width", 320, "--height", 240, "--path", "xyz", "--seed", 3, "-q")
WEIGHTS = {"register": 16, "mesh": 1, "export": 2, "simulate": 2}  # shares of the kills


@dataclass
class Command:
    """One command line: what it makes in `out`, undisturbed, and what may have been there before."""

    arguments: Callable[[Path, np.random.Generator], tuple]
    cpu_s: float = 0.0
    made: dict[str, bytes] = field(default_factory=dict)
    artefacts: dict[str, bytes] = field(default_factory=dict)
    earlier: dict[str, bytes] = field(default_factory=dict)


@dataclass
class Tally:
    """What happened: kills by command and signal, resumes, runs to the end, losses, strange words."""

    kills: Counter = field(default_factory=Counter)
    resumes: int = 0
    rounds: int = 0
    unheeded: int = 0
    shares: list[float] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)
    odd_ends: list[str] = field(default_factory=list)


def start(arguments: tuple, folder: Path) -> subprocess.Popen:
    """A process of its own group with its cache below `folder`."""
    return subprocess.Popen(
        command(*arguments),
        cwd=folder,
        env=environment(MINILOOP_CACHE=folder / "cache", PYTHONFAULTHANDLER=1),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def cpu_s(pid: int) -> float:
    """Processor seconds that a process has used, its threads included."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * TICKS_S


def children_cpu_s() -> float:
    """Processor seconds of all child processes that have ended."""
    used = os.times()
    return used.children_user + used.children_system


def kill(process: subprocess.Popen, moment_s: float, number: int, group: bool) -> bool:
    """Send the signal once the process has used `moment_s`; False if it ended before."""
    while process.poll() is None:
        if cpu_s(process.pid) >= moment_s:
            (os.killpg if group else os.kill)(process.pid, number)
            return True
        time.sleep(0.002)
    return False


def ended(process: subprocess.Popen, limit_s: float) -> str:
    """What the process said, once it has ended; one that hangs is aborted, and says where it was."""
    try:
        return process.communicate(timeout=limit_s)[1]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGABRT)
        return process.communicate()[1]


def visible(folder: Path) -> dict[str, bytes]:
    """Files below a folder that no part of whose name is hidden."""
    return {name: content for name, content in contents(folder).items() if "/." not in f"/{name}"}


def undisturbed(done: Command, folder: Path, rng: np.random.Generator) -> None:
    """Run a command to its end and keep what it made."""
    out = folder / "out"
    before = children_cpu_s()
    process = start(done.arguments(out, rng), folder)
    _, stderr = process.communicate()
    if process.returncode:
        raise SystemExit(f"the undisturbed run failed: {stderr}")
    done.cpu_s = children_cpu_s() - before
    done.made, done.artefacts = contents(out), contents(folder / "cache")


def disturbed(done: Command, name: str, folder: Path, rng: np.random.Generator, tally: Tally) -> None:
    """Kill and start again until a run gets through, looking at what is there after each."""
    out, kept, taking_up = folder / "out", {}, False
    for path, content in (done.earlier if rng.random() < 0.5 else {}).items():
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_bytes(content)
    while True:
        before = children_cpu_s()
        process = start(done.arguments(out, rng), folder)
        tally.resumes += taking_up
        number, share = SIGNALS[rng.integers(len(SIGNALS))], rng.random()
        let_through = rng.random() < 0.2
        killed = kill(process, np.inf if let_through else share * done.cpu_s, number, bool(rng.integers(2)))
        stderr = ended(process, max(300, 50 * done.cpu_s))
        where = f"{name}, {signal.Signals(number).name} after {share:.0%}"
        tally.losses += [f"{where}: {what}" for what in state(done, folder, kept)]
        if process.returncode == 0:
            tally.unheeded += killed
            if not taking_up:  # the undisturbed run may have compiled the kernels beside its work
                done.cpu_s = min(done.cpu_s, children_cpu_s() - before)
            break
        if not killed or not well_ended(process.returncode, number, stderr):
            tally.odd_ends.append(f"{where}: ended with status {process.returncode}: {stderr.strip()[-3000:]}")
        tally.kills[name, signal.Signals(number).name] += 1
        tally.shares.append(share)
        taking_up = True
    made = contents(out)
    wrong = sorted(path for path in made.keys() | done.made.keys() if made.get(path) != done.made.get(path))
    tally.losses += [f"{name}: in the end, {path} is not that of the undisturbed run" for path in wrong]
    tally.rounds += 1


def well_ended(status: int, number: int, stderr: str) -> bool:
    """Killed outright, or with the one line that says so; while the program itself is loaded, as Python does it.

    Python may end itself by SIGINT after an interrupt that compiled code passed on, which a shell sees as 130, too.
    """
    if number == signal.SIGKILL:
        return status == -number
    said = stderr.lstrip() == INTERRUPTED and status in (130, -signal.SIGINT)
    loading = stderr.rstrip().endswith("KeyboardInterrupt") and ", in main\n" not in stderr
    return said or loading or (status == -number and not stderr)


def state(done: Command, folder: Path, kept: dict[str, int]) -> Iterator[str]:
    """What is wrong with the files that are there; `kept`: the artefacts seen so far, with their inodes."""
    for path, content in visible(folder / "out").items():
        if content not in (done.made.get(path), done.earlier.get(path)):
            yield f"{path} is of no run"
    for path, content in visible(folder / "cache").items():
        if content != done.artefacts.get(path):
            yield f"artefact {path} is damaged"
        inode = (folder / "cache" / path).stat().st_ino
        if kept.setdefault(path, inode) != inode:
            yield f"artefact {path} was made twice"
    for path in set(kept) - set(visible(folder / "cache")):
        yield f"artefact {path} is gone"


def commands(folder: Path, names: tuple[str, ...]) -> dict[str, Command]:
    """The named commands on one small recording, each run once undisturbed; mesh and export need register's result."""
    rng, recording, result = np.random.default_rng(0), folder / "room", folder / "register" / "out"
    process = start(("simulate", recording, *RECORDING), folder)
    process.communicate()
    voxel = ("--voxel", 0.02, "--min-weight", 1, "-q")
    found = {
        "register": Command(lambda out, rng: ("register", recording, "-o", out, "-q", "-j", rng.choice([1, 2, 4]))),
        "mesh": Command(lambda out, _: ("mesh", result, "-o", out, *voxel)),
        "export": Command(lambda out, _: ("export", result, "--to", "colmap", "-o", out)),
        "simulate": Command(lambda out, _: ("simulate", out / "room", *RECORDING, "--overwrite")),
    }
    found = {name: one for name, one in found.items() if name in names}
    for name, one in found.items():
        (folder / name).mkdir()
        undisturbed(one, folder / name, rng)
    (folder / "other").mkdir()
    start(("register", recording, "-o", "out", "-q", "--max-frames", 4), folder / "other").communicate()
    found["register"].earlier = contents(folder / "other" / "out")
    return found


def campaign(folder: Path, kills: int, seed: int, names: tuple[str, ...] = tuple(WEIGHTS)) -> Tally:
    """At least `kills` kills, spread over the named commands by their weights."""
    rng, tally, known = np.random.default_rng(seed), Tally(), commands(folder, names)
    wanted = {name: kills * WEIGHTS[name] / sum(WEIGHTS[n] for n in names) for name in names}
    while open_ := [n for n in names if sum(c for (of, _), c in tally.kills.items() if of == n) < wanted[n]]:
        round_folder = folder / "round"
        round_folder.mkdir()
        disturbed(known[open_[0]], open_[0], round_folder, rng, tally)
        shutil.rmtree(round_folder)
        print(f"\r{sum(tally.kills.values())} kills, {len(tally.losses)} losses", end="", file=sys.stderr, flush=True)
    return tally


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # not ignored by what is started, even in the background
    kills, seed = (int(value) for value in (*sys.argv[1:], *("240", "0")[len(sys.argv) - 1 :]))
    with tempfile.TemporaryDirectory() as folder:
        tally = campaign(Path(folder), kills, seed)
    for (name, number), count in sorted(tally.kills.items()):
        print(f"\n{name:<10}{number:<10}{count:4d} kills", end="")
    counts, _ = np.histogram(tally.shares, np.linspace(0, 1, 11))
    print(f"\n{sum(tally.kills.values())} kills; by tenth of the run: {' '.join(map(str, counts))}")
    print(f"{tally.resumes} resumes, {tally.rounds} runs to the end, {len(tally.losses)} losses")
    print(f"{tally.unheeded} interrupts came too late to be heeded")
    print(f"{len(tally.odd_ends)} ended with other words than they should")
    print(*tally.losses, *tally.odd_ends, sep="\n")
    sys.exit(bool(tally.losses or tally.odd_ends))
