"""`register --cluster` on a real scheduler and two worker processes: the same bytes, also where a worker is killed."""

import json
import os
import socket
import subprocess
import sys
import threading
import time

import cluster_work
import pytest
from command_line import ROOT, command, differing, environment, run_process

from miniloop_cli import cluster as cluster_module
from miniloop_cli.cluster import Cluster, connected
from miniloop_cli.errors import MiniloopError
from miniloop_cli.parallel import Workers

QUIET = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "stdin": subprocess.DEVNULL}


@pytest.fixture
def dask(tmp_path, shared):
    """Address of a scheduler on loopback and its two worker processes."""
    Client = pytest.importorskip("distributed", reason="needs the extra [cluster]").Client
    file = tmp_path / "scheduler.json"
    variables = environment(
        MINILOOP_CACHE=shared / "nothing-is-kept-here",
        PYTHONPATH=os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "cli"))),
    )

    def start(what, *more):
        arguments = [sys.executable, "-m", "dask", what, "--scheduler-file", str(file), "--no-dashboard", *more]
        return subprocess.Popen(arguments, env=variables, cwd=tmp_path, **QUIET)

    processes = [start("scheduler", "--host", "127.0.0.1", "--port", "0")]
    try:
        deadline = time.monotonic() + 600
        while not file.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        processes += [start("worker", "--no-nanny", "--nthreads", "1", "--host", "127.0.0.1") for _ in range(2)]
        address = json.loads(file.read_text())["address"]
        with Client(address, timeout=600, set_as_default=False) as client:  # we wait for 10 s only, for a first one
            client.wait_for_workers(2, timeout=120)
        yield address, processes[1:], processes[0]
    finally:
        for process in processes:
            process.kill()
            process.wait()
    assert not (shared / "nothing-is-kept-here").exists(), "results stay with the caller"


def test_a_run_on_a_cluster_that_loses_a_worker_gives_the_same_bytes(dask, recording, registered, shared, tmp_path):
    address, workers, _ = dask
    output = tmp_path / "results"
    arguments = command("register", recording, "-o", output, "--cluster", address, "--fresh", "-v")
    environ = environment(MINILOOP_CACHE=tmp_path / "cache")
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, env=environ, cwd=shared) as run:
        said = []
        for line in run.stderr:
            said.append(line)
            if line.startswith("matching ..."):
                workers[0].kill()
    assert run.returncode == 0, "".join(said)
    assert workers[0].wait() != 0
    assert workers[1].poll() is None
    assert differing(registered.folder, output) == []


def test_work_of_a_worker_that_dies_is_done_by_the_others(dask, tmp_path):
    address, processes, _ = dask
    with connected(address) as cluster:
        work = Workers(cluster=cluster).spread(cluster_work.die_once, tmp_path / "died", range(60), "squaring", 60)
        assert list(work) == [item**2 for item in range(60)]
    assert (tmp_path / "died").exists()
    assert sum(process.poll() is None for process in processes) == 1


def test_a_scheduler_that_does_not_answer_is_told_within_bounds(monkeypatch, recording, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra [cluster]")
    with socket.socket() as silent:  # accepts connections and says nothing
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        begin = time.monotonic()
        monkeypatch.setattr(cluster_module, "ANSWER_S", 1)
        with pytest.raises(MiniloopError, match=r"no scheduler answers within 1 s.*dask scheduler"), connected(address):
            pass
        assert time.monotonic() - begin < 30
    done = run_process("register", recording, "-o", tmp_path / "r", "--cluster", "nonsense://x", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.strip().count("\n") == 0
    assert "--cluster nonsense://x" in done.stderr


def test_without_dask_the_way_to_get_it_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MiniloopError, match=r"pip install 'miniloop\[cluster\]'"), connected("tcp://127.0.0.1:1"):
        pass


@pytest.mark.parametrize("lost", ["scheduler", "workers"])
def test_a_cluster_that_is_lost_is_told_in_one_line_and_the_run_continues(
    dask, recording, registered, shared, tmp_path, lost
):
    """Where the last worker dies between two pieces of work the run waits for another, and can be interrupted."""
    address, workers, scheduler = dask
    output, environ = tmp_path / "results", environment(MINILOOP_CACHE=tmp_path / "cache")
    arguments = ["register", recording, "-o", output]
    with subprocess.Popen(
        command(*arguments, "--cluster", address, "-v"), stderr=subprocess.PIPE, text=True, env=environ, cwd=shared
    ) as run:
        said = []
        for line in run.stderr:
            said.append(line)
            if line.startswith("matching ..."):
                for process in workers if lost == "workers" else [scheduler]:
                    process.kill()
                killer = threading.Timer(15 if lost == "workers" else 600, run.terminate)
                killer.start()
    killer.cancel()
    assert run.returncode in (1, 130), "".join(said)
    words = ("is lost", "died over the same work") if run.returncode == 1 else ("interrupted",)
    assert any(word in said[-1] for word in words), "".join(said)
    assert "Traceback" not in "".join(said)
    assert run_process(*arguments, "-q", cwd=shared, MINILOOP_CACHE=tmp_path / "cache").returncode == 0
    assert differing(registered.folder, output) == []


def test_a_worker_that_leaves_while_it_is_sent_something(monkeypatch):
    """The scheduler answers with a KeyError then; the others are sent it again."""
    joblib, sent = pytest.importorskip("joblib"), []

    def parallel_config(*_, scatter, **__):
        sent.append(scatter)
        if len(sent) < 3:
            raise KeyError("tcp://127.0.0.1:41279")
        return "held"

    monkeypatch.setattr(joblib, "parallel_config", parallel_config)
    assert Cluster(None)._holding(["package"]) == "held"
    assert len(sent) == 3
