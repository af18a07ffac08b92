"""The parallel map: order, and libraries held at one thread, those loaded later included."""

import json
import subprocess
import sys

from miniloop_cli.runtime.parallel import Workers

HELD = """
from threadpoolctl import threadpool_info
from miniloop_cli.runtime.parallel import single_inner_threads
with single_inner_threads():
    import miniloop_cli.stages.average, miniloop_cli.refinement.joint, miniloop_cli.pipeline
    import scipy.interpolate, scipy.linalg, scipy.sparse.linalg, scipy.spatial.transform
    print([pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"])
"""


def test_results_come_in_order():
    assert list(Workers(4).map(lambda n: n * n, range(200), "squares", 200)) == [n * n for n in range(200)]


def test_no_matrix_library_that_is_loaded_inside_has_threads_of_its_own():
    """Sums cut into as many parts as there are cores would give every machine its own last digits."""
    done = subprocess.run([sys.executable, "-c", HELD], capture_output=True, text=True, check=True)
    threads = json.loads(done.stdout)
    assert threads and set(threads) == {1}
