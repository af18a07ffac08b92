"""What the cells that two scans share say of their relative pose."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.config import Averaging
from miniloop_cli.verification.photometric_check import agreement_ratio

cells = st.integers(0, 3000)


def test_without_cells_nothing_is_said():
    assert agreement_ratio(np.array([0, 0])) == 1


def test_a_few_cells_that_all_look_different_are_enough():
    """Of false edges that agreed with each other, those with fewer than a hundred cells were all believed."""
    least = Averaging().min_photo_consistency
    np.testing.assert_array_equal(
        agreement_ratio(np.array([[0, 57], [0, 20], [0, 8], [57, 0], [40, 17]])) < least, [1, 1, 0, 0, 0]
    )


@given(cells, cells)
def test_it_tends_to_the_share_of_the_cells(alike, different):
    found, more = agreement_ratio(np.array([[alike, different], [alike + 1, different]]))
    assert 0 < found <= more <= 1
    assert abs(found - alike / max(alike + different, 1)) < 10 / (alike + different + 10) + 1e-12
