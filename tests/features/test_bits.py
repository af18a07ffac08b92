import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numba import njit, types
from numba.extending import intrinsic

from miniloop_cli.features.hamming import WORDS, by_adders, by_counting, set_bits


def counted_by(set_bits):
    @njit
    def counted(words):
        found = np.empty(len(words), np.uint32)
        for k in range(len(words)):
            w = words[k]
            found[k] = set_bits(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7])
        return found

    return counted


def intrinsic_of(way):
    @intrinsic
    def counting(_, a, b, c, d, e, f, g, h):
        return types.uint32(*[types.uint32] * WORDS), lambda _, builder, __, words: way(builder, words)

    return counting


WAYS = {
    "of this processor": counted_by(set_bits),
    "adders": counted_by(intrinsic_of(by_adders)),
    "counting": counted_by(intrinsic_of(by_counting)),
}
every_way = pytest.mark.parametrize("way", WAYS)


@every_way
@given(words=st.lists(st.lists(st.integers(0, 2**32 - 1), min_size=WORDS, max_size=WORDS), min_size=1, max_size=40))
@example(words=[[2**32 - 1] * WORDS, [0] * WORDS, [2**k for k in range(WORDS)]])
def test_as_many_as_python_counts(way, words):
    found = WAYS[way](np.array(words, np.uint32))
    assert found.tolist() == [sum(word.bit_count() for word in row) for row in words]


@every_way
def test_every_single_bit_counts_once(way):
    words = np.zeros((32 * WORDS, WORDS), np.uint32)
    for bit in range(32 * WORDS):
        words[bit, bit // 32] = 1 << bit % 32
    assert (WAYS[way](words) == 1).all()
    assert (WAYS[way](~words) == 32 * WORDS - 1).all()
