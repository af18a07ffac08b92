"""`register --cluster` on a real scheduler and two worker processes: the same bytes, also where a worker is killed."""

import asyncio
import json
import logging
import os
import socket
import subprocess
import sys
import time
from concurrent.futures import CancelledError
from contextlib import nullcontext
from types import SimpleNamespace

import cluster_work
import pytest
from command_line import ROOT, command, differing, environment, run_process

from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.dask_cluster import Cluster, connected
from miniloop_cli.runtime.parallel import Workers

QUIET = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "stdin": subprocess.DEVNULL}


@pytest.fixture
def dask(tmp_path, shared):
    """A scheduler on loopback, its address, its two worker processes; `another()` starts one more."""
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

        def another():
            processes.append(start("worker", "--no-nanny", "--nthreads", "1", "--host", "127.0.0.1"))

        another()
        another()
        address = json.loads(file.read_text())["address"]
        with Client(address, timeout=600, set_as_default=False) as client:  # we wait for 10 s only, for a first one
            client.wait_for_workers(2, timeout=120)
        yield SimpleNamespace(address=address, scheduler=processes[0], workers=processes[1:], another=another)
    finally:
        for process in processes:
            process.kill()
            process.wait()
    assert not (shared / "nothing-is-kept-here").exists(), "results stay with the caller"


@pytest.mark.slow
def test_a_run_on_a_cluster_that_loses_a_worker_gives_the_same_bytes(dask, recording, registered, shared, tmp_path):
    address, workers = dask.address, dask.workers
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


@pytest.mark.slow
def test_work_of_a_worker_that_dies_is_done_by_the_others(dask, tmp_path):
    with connected(dask.address) as cluster:
        work = Workers(cluster=cluster).spread(cluster_work.die_once, tmp_path / "died", range(60), "squaring", 60)
        assert list(work) == [item**2 for item in range(60)]
    assert not logging.getLogger("distributed.client").disabled, "its log lines are held back for a while only"
    assert (tmp_path / "died").exists()
    assert sum(process.poll() is None for process in dask.workers) == 1


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_told_within_bounds(recording, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra [cluster]")
    with socket.socket() as silent:  # accepts connections and says nothing
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        begin = time.monotonic()
        words = r"no scheduler answers within 1 s.*dask scheduler"
        with pytest.raises(MiniloopError, match=words), connected(address, answer_s=1):
            pass
        assert time.monotonic() - begin < 30
    done = run_process("register", recording, "-o", tmp_path / "r", "--cluster", "nonsense://x", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.strip().count("\n") == 0
    assert "--cluster nonsense://x" in done.stderr


@pytest.mark.slow
def test_a_notebook_may_ask_for_a_cluster():
    """Its code runs inside a loop, where no other loop can be run."""
    pytest.importorskip("distributed", reason="needs the extra [cluster]")

    async def cell():
        with connected("tcp://127.0.0.1:1"):
            pass

    with pytest.raises(MiniloopError, match="no scheduler answers"):
        asyncio.run(cell())


def test_without_dask_the_way_to_get_it_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MiniloopError, match=r"pip install 'miniloop\[cluster\]'"), connected("tcp://127.0.0.1:1"):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("lost", ["scheduler", "workers"])
def test_a_cluster_that_is_lost_is_told_in_one_line_and_the_run_continues(
    dask, recording, registered, shared, tmp_path, lost
):
    """Where the last worker dies the run waits for another, but not for long."""
    output, environ = tmp_path / "results", environment(MINILOOP_CACHE=tmp_path / "cache")
    arguments = ["register", recording, "-o", output]
    with subprocess.Popen(
        command(*arguments, "--cluster", dask.address, "-v"), stderr=subprocess.PIPE, text=True, env=environ, cwd=shared
    ) as run:
        said = []
        for line in run.stderr:
            said.append(line)
            if line.startswith("matching ..."):
                for process in dask.workers if lost == "workers" else [dask.scheduler]:
                    process.kill()
    assert run.returncode == 1, "".join(said)
    assert any(words in said[-1] for words in ("is lost", "died over the same work")), "".join(said)
    assert "Traceback" not in "".join(said)
    assert run_process(*arguments, "-q", cwd=shared, MINILOOP_CACHE=tmp_path / "cache").returncode == 0
    assert differing(registered.folder, output) == []


@pytest.mark.parametrize("losses", [2, 4])
def test_the_rest_is_sent_again_where_what_was_sent_is_lost(monkeypatch, losses):
    """A worker may leave before it is sent anything, meanwhile, or with all that the others need."""
    joblib = pytest.importorskip("joblib")
    CommClosedError = pytest.importorskip("distributed.comm", reason="needs the extra [cluster]").CommClosedError
    ways = iter([KeyError("tcp://127.0.0.1:41279"), OSError("refused"), CommClosedError(), CancelledError()][:losses])
    asked = []

    async def connect(address, timeout):
        asked.append(address)
        return SimpleNamespace(abort=lambda: None)

    def parallel_config(*_, **__):
        for loss in ways:
            raise loss
        return nullcontext()

    monkeypatch.setattr(joblib, "parallel_config", parallel_config)
    monkeypatch.setattr(joblib, "Parallel", lambda **_: lambda calls: (work(*given) for work, given, _ in calls))
    monkeypatch.setattr("distributed.comm.core.connect", connect)
    scheduler = SimpleNamespace(address="tcp://here:1")
    client = SimpleNamespace(scheduler=scheduler, ncores=lambda: {"one": 2}, wait_for_workers=lambda n, timeout: n)
    work = Cluster(client).map(lambda power, item: item**power, 2, range(9))
    if losses == 4:
        with pytest.raises(MiniloopError, match="is lost"):
            list(work)
    else:
        assert list(work) == [item**2 for item in range(9)]
    assert asked == ["tcp://here:1"] * min(losses, 3)


@pytest.mark.slow
def test_work_waits_for_the_next_worker_where_all_die(dask, tmp_path):
    """What is done is not done again."""
    with connected(dask.address, replaced_s=300) as cluster:  # a machine at work takes long to start one
        work = Workers(cluster=cluster).spread(cluster_work.leave_a_trace, tmp_path, range(60), "squaring", 60)
        begun = [next(work) for _ in range(8)]
        for process in dask.workers:
            process.kill()
        dask.another()
        assert begun + list(work) == [item**2 for item in range(60)]
    assert [len(list(tmp_path.glob(f"{item}-*"))) for item in range(8)] == [1] * 8
