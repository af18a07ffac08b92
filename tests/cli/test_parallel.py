"""The parallel map: order, bounds, ends; and libraries held at one thread, those loaded later included."""

import json
import subprocess
import sys
import threading
import time

import cv2
import pytest
from threadpoolctl import threadpool_info

from miniloop_cli.runtime.parallel import Workers, single_inner_threads

AHEAD = 16  # items a thread that may be begun before they are asked for

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


@pytest.mark.slow
def test_no_matrix_library_that_is_loaded_inside_has_threads_of_its_own():
    """Sums cut into as many parts as there are cores would give every machine its own last digits."""
    done = subprocess.run([sys.executable, "-c", HELD], capture_output=True, text=True, check=True)
    threads = json.loads(done.stdout)
    assert threads and set(threads) == {1}


def threads():
    """Threads of OpenCV and of every library of matrices or of OpenMP that is loaded."""
    return cv2.getNumThreads(), [(pool["filepath"], pool["num_threads"]) for pool in threadpool_info()]


@pytest.fixture
def three_threads():
    """OpenCV at another number of threads than its own, to see that it is given back."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    yield threads()
    cv2.setNumThreads(before)


def test_threads_are_given_back(three_threads):
    with single_inner_threads():
        assert cv2.getNumThreads() == 1
        with single_inner_threads():
            assert cv2.getNumThreads() == 1
        assert cv2.getNumThreads() == 1
    assert threads() == three_threads
    with pytest.raises(ZeroDivisionError), single_inner_threads():
        raise ZeroDivisionError
    assert threads() == three_threads
    list(Workers(2).map(str, range(9), "words", 9))
    assert threads() == three_threads


def test_threads_are_given_back_by_whoever_ends_last(three_threads):
    """Two maps that are taken from in turn: the one that began first is closed first."""
    first, second = (Workers(1).map(str, range(9), "words", 9) for _ in range(2))
    next(first), next(second)
    first.close()
    assert cv2.getNumThreads() == 1
    assert {count for _, count in threads()[1]} == {1}
    second.close()
    assert threads() == three_threads


def test_threads_are_given_back_after_blocks_of_several_threads(three_threads):
    begun, end = threading.Barrier(3), threading.Event()

    def hold():
        with single_inner_threads():
            begun.wait()
            end.wait()

    others = [threading.Thread(target=hold) for _ in range(2)]
    with single_inner_threads():
        for other in others:
            other.start()
        begun.wait()
    assert cv2.getNumThreads() == 1, "others are still at work"
    end.set()
    for other in others:
        other.join()
    assert threads() == three_threads


def test_no_more_items_are_begun_than_agreed():
    begun = []
    results = Workers(2).map(begun.append, range(1000), "items", 1000)
    next(results)
    time.sleep(0.2)
    assert 1 < len(begun) <= 2 * AHEAD + 1
    results.close()


class StoppedError(Exception):
    """How the loop ends in a test."""


@pytest.mark.parametrize("end", ["error in an item", "error in the loop", "closed", "interrupt"])
def test_no_item_is_at_work_after_the_loop(end):
    """The interpreter would stop its thread in the middle of compiled code, which aborts the process."""
    at_work = set()

    def work(item):
        at_work.add(item)
        time.sleep(0.05)
        at_work.remove(item)
        if end == "error in an item" and item == 5:
            raise StoppedError
        return item

    results = Workers(4).map(work, range(1000), "items", 1000)
    try:
        for item in results:
            if item == 3 and end == "closed":
                results.close()
                break
            if item == 3 and end == "error in the loop":
                results.throw(StoppedError)
            if item == 3 and end == "interrupt":
                results.throw(KeyboardInterrupt)
    except (StoppedError, KeyboardInterrupt):
        pass
    assert not at_work
