import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from numba import njit

from miniloop_cli.features.bits import WORDS, set_bits


@njit
def counted(words):
    found = np.empty(len(words), np.uint32)
    for k in range(len(words)):
        w = words[k]
        found[k] = set_bits(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7])
    return found


@given(st.lists(st.lists(st.integers(0, 2**32 - 1), min_size=WORDS, max_size=WORDS), min_size=1, max_size=40))
@example([[2**32 - 1] * WORDS, [0] * WORDS, [2**k for k in range(WORDS)]])
def test_as_many_as_python_counts(words):
    found = counted(np.array(words, np.uint32))
    assert found.tolist() == [sum(word.bit_count() for word in row) for row in words]


def test_every_single_bit_counts_once():
    words = np.zeros((32 * WORDS, WORDS), np.uint32)
    for bit in range(32 * WORDS):
        words[bit, bit // 32] = 1 << bit % 32
    assert (counted(words) == 1).all()
    assert (counted(~words) == 32 * WORDS - 1).all()
