"""Ctrl-C and SIGTERM end in one line and status 130, wherever they arrive."""

import os
import shutil
import signal
import subprocess
import sys
import time
from textwrap import dedent

import pytest
from command_line import command, environment, launch

from miniloop_cli.cli.bench import factory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.signals import uninterrupted

INTERRUPTED = "miniloop: interrupted; finished work is kept, the same command continues"
sent = pytest.mark.skipif(os.name != "posix", reason="a process is ended, not interrupted, by what others send it")
MADE_OF_IT = [  # by compiled code, the definition of a class and a failed import; the last is told as our own
    SystemError("CPUDispatcher(<function conjugate_gradients>) returned a result with an exception set"),
    RuntimeError("Error calling __set_name__ on '_axis_method_wrapper' instance"),
    ImportError("initialization failed"),
    MiniloopError("open3d cannot be loaded"),
]


@pytest.mark.slow
@sent
def test_interrupted_while_threads_are_at_work(recording, tmp_path):
    """The interpreter used to stop them in the middle of compiled code, which aborted the process (status 134)."""
    line = command("register", recording, "-o", tmp_path / "out", "-q", "-j", 4)
    for _ in range(2):
        cache = tmp_path / "cache"
        shutil.rmtree(cache, ignore_errors=True)
        process = subprocess.Popen(
            line, cwd=tmp_path, env=environment(MINILOOP_CACHE=cache), stderr=subprocess.PIPE, text=True
        )
        while process.poll() is None and not list(cache.glob("features/*")):
            time.sleep(0.002)
        process.send_signal(signal.SIGTERM)
        _, stderr = process.communicate(timeout=600)
        assert process.returncode == 130
        assert stderr.strip() == INTERRUPTED


def interrupted_rows(made, seed, workers):
    """Rows of a benchmark that is interrupted inside a library."""
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as interrupt:
        raise MADE_OF_IT[made] from interrupt


@pytest.mark.parametrize("made", range(len(MADE_OF_IT)))
def test_an_interrupt_that_a_library_made_an_error_of(tmp_path, made):
    rows, draw = f"{__name__}:interrupted_rows", "miniloop_cli.bench.solvers:draw_histograms"
    options = (factory.whole("--made", 0, 0, "Which error."),)
    interrupted = factory.command(factory.Benchmark("interrupted", "", "", rows, draw, columns=(), options=options))
    done = launch("--made", made, "-q", "-o", tmp_path / "out", command=interrupted)
    assert (done.returncode, done.stdout, done.stderr.strip()) == (130, "", INTERRUPTED)
    assert list(tmp_path.iterdir()) == []


CALLBACK = """
    def callback():
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000): pass
    ctypes.CFUNCTYPE(None)(callback)()
    print('came back', flush=True)
    time.sleep(20)
"""
CAUGHT = """
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(20)
    except:
        print('came back', flush=True)
    time.sleep(20)
"""
TIDYING = """
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(20)
    finally:
        for _ in range(150): time.sleep(0.01)
        print('came back', flush=True)
"""
GIVING_BACK = """
    from llvmlite.binding import ffi, get_default_triple
    def disposed(string, dispose=ffi.lib.LLVMPY_DisposeString):
        dispose(string)
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000): pass
    ffi.lib._fntab['LLVMPY_DisposeString'] = disposed
    get_default_triple()
    print('came back', flush=True)
    time.sleep(20)
"""
LOADING = """
    from types import SimpleNamespace
    from miniloop_cli.features.match import match
    from miniloop_cli.runtime.kernels import KernelCache
    class Loaded(KernelCache):
        def _load_overload(self, *_): return print('came back', flush=True) or 'a kernel'
    def refresh():
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000): pass
    Loaded(match).load_overload(None, SimpleNamespace(refresh=refresh))
    time.sleep(20)
"""


@pytest.mark.slow
@sent
@pytest.mark.parametrize(
    "body",
    [CALLBACK, CAUGHT, TIDYING, GIVING_BACK, LOADING],
    ids=["callback", "caught", "tidying up", "giving memory back", "loading a kernel"],
)
def test_an_interrupt_is_not_lost_and_does_not_disturb_itself(tmp_path, body):
    """Where compiled code calls Python nobody can catch it, and some libraries catch everything: the command went on.

    What tidies up after an interrupt is not interrupted in turn. llvmlite that was interrupted while it gave memory
    back did so twice, and a kernel half loaded crashed (status -6 and -11, once each in 484 kills).
    """
    script = (
        "import ctypes, os, signal, time; import click; from miniloop_cli.cli.main import main\n"
        "@click.command()\n"
        f"def work():{body}"
        "main([], work)\n"
    )
    line = [*command()[:1], "-c", script]
    done = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, env=environment(), check=False)
    assert (done.returncode, done.stdout, done.stderr.strip()) == (130, "came back\n", INTERRUPTED)


@pytest.mark.slow
@sent
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_until_what_cannot_be_stopped_is_done(tmp_path, number):
    """Open3D that is interrupted while it is loaded ended the process with status 1, whatever was to be its status."""
    pytest.importorskip("open3d", exc_type=ImportError)
    body = f"""
        import os, signal, sys, threading
        from miniloop_cli.export.mesh import import_open3d
        from miniloop_cli.runtime.signals import heeded_interrupts
        try:
            with heeded_interrupts():
                threading.Timer(0.02, os.kill, (os.getpid(), {int(number)})).start()
                import_open3d()
                threading.Event().wait(20)
        except KeyboardInterrupt:
            sys.exit(130 if "open3d" in sys.modules else 2)
    """
    done = subprocess.run(
        [sys.executable, "-c", dedent(body)],
        env=environment(),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_an_interrupt_that_waits_is_not_lost_where_the_block_fails():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt) as caught, uninterrupted():
            signal.raise_signal(signal.SIGINT)
            raise ImportError("went on until here")
    finally:
        signal.signal(signal.SIGINT, before)
    assert str(caught.value.__context__) == "went on until here"


@pytest.mark.parametrize("arguments", [("--version",), ("register",)], ids=["done", "wrong usage"])
def test_the_launcher_leaves_handlers_as_it_found_them(arguments):
    before = signal_state()
    launch(*arguments)
    assert signal_state() == before


def signal_state():
    """Handlers of all signals that a program may handle, the alarm, and what is done with errors that are forgotten."""
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    alarm = signal.getitimer(signal.ITIMER_REAL) if hasattr(signal, "getitimer") else None
    return handlers, alarm, sys.unraisablehook


WITHOUT_ALARM = """
    import signal, sys, time
    for name in ("SIGALRM", "setitimer", "ITIMER_REAL"):  # as on Windows
        vars(signal).pop(name, None)
    from miniloop_cli.runtime.signals import heeded_interrupts, uninterrupted
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    for number in (signal.SIGINT, signal.SIGTERM):
        try:
            with heeded_interrupts():
                try:
                    with uninterrupted():
                        signal.raise_signal(number)
                        print("went on")
                finally:
                    print("tidied up")
        except KeyboardInterrupt:
            print("interrupted")
    assert before == [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    from miniloop_cli.cli.main import main
    main(["--version"])
"""


def test_a_system_without_an_alarm():
    """An interrupt there comes once."""
    line = [*command()[:1], "-c", dedent(WITHOUT_ALARM)]
    done = subprocess.run(line, capture_output=True, text=True, env=environment(), check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[:6] == ["went on", "tidied up", "interrupted"] * 2
    assert done.stdout.splitlines()[6].startswith("miniloop, version")
