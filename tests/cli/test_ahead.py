"""Compilation ahead: a first run is told from a later one, and a rehearsal leaves what the next run looks for."""

import subprocess
import sys

from command_line import environment

from miniloop_cli.warmup import compile_in_background, compiled, warm_up


def test_an_empty_cache_is_seen(tmp_path):
    code = "from miniloop_cli.warmup import compiled; print(compiled())"
    said = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=environment(NUMBA_CACHE_DIR=tmp_path),
    )
    assert said.stdout.strip() == "False"


def test_a_rehearsal_compiles_what_a_run_looks_for():
    warm_up()
    assert compiled()
    compile_in_background.cache_clear()
    assert compile_in_background() is None, "nothing is started where all is compiled"
