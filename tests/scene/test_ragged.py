"""Groups of rows gathered from several arrays: as one index after the other would."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.scene.ragged import rows_of

ARRAYS = [np.arange(20).reshape(10, 2), 100 + np.arange(14).reshape(7, 2)]


@st.composite
def groups(draw):
    which = draw(st.lists(st.integers(0, 1), max_size=12))
    ends = [sorted(draw(st.tuples(*[st.integers(0, len(ARRAYS[a]))] * 2))) for a in which]
    return which, ends


@given(groups())
def test_groups_follow_one_another(given_groups):
    which, ends = given_groups
    first, last = np.array(ends, np.int64).reshape(-1, 2).T
    found = rows_of(ARRAYS, np.array(which, np.int64), first, last)
    rows = [ARRAYS[a][k] for a, (i, j) in zip(which, ends, strict=True) for k in range(i, j)]
    assert np.array_equal(found, np.array(rows, np.int64).reshape(-1, 2))


def test_groups_side_by_side_are_copied_at_once():
    bounds = np.array([0, 3, 3, 10])
    found = rows_of(ARRAYS, np.zeros(3, np.int64), bounds[:-1], bounds[1:])
    assert np.array_equal(found, ARRAYS[0]) and not np.shares_memory(found, ARRAYS[0])
