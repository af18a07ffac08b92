"""Parts of the image, for the grouped jackknife: what would be found without one of them says how much is known.

Measurements of one part of the image share errors: of lens, rows and depth, and of the surfaces seen there. Counted one
by one, as if they were independent, they promise two to four times too much. How far the result moves where a part is
left out holds whatever its errors have in common (Tukey 1958); where they have nothing in common, too, but is a little
too much then (Efron & Stein, Annals of Statistics 9(3), 1981). Parts of 3 x 3 are large enough to hold what is common,
and enough to tell a variance.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.typing import Floats, Ints

SIDE = 3
PARTS = SIDE**2


def image_part(px: Floats, camera: Camera) -> Ints:
    """In which of the parts 0 to PARTS - 1 each pixel (k, 2) lies; those beyond the image are of the nearest."""
    column, row = np.clip(SIDE * px / (camera.width, camera.height), 0, SIDE - 1).astype(np.int64).T
    return SIDE * row + column


def remaining_fraction(part: Ints) -> Floats:
    """Share (p,) of the measurements, part (n,) of each, that is left without each of the PARTS parts."""
    return 1 - np.bincount(part, minlength=PARTS) / max(len(part), 1)
