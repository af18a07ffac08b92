"""Parts of the image for the grouped jackknife, which estimates a variance from the results without each part.

Measurements in one part of the image share errors: of lens, rows and depth, and of the surfaces seen there. Treated as
independent, they give standard deviations that are two to four times too small. The jackknife remains valid if errors
within a part are correlated (Tukey 1958); if they are not, it slightly overestimates the variance (Efron & Stein,
Annals of Statistics 9(3), 1981). 3 x 3 parts are large enough to contain the correlations, and numerous enough for a
variance.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.typing import Floats, Ints

SIDE = 3
PARTS = SIDE**2


def image_part(px: Floats, camera: Camera) -> Ints:
    """The part (k,), 0 to PARTS - 1, of each pixel (k, 2); pixels outside the image belong to the nearest part."""
    column, row = np.clip(SIDE * px / (camera.width, camera.height), 0, SIDE - 1).astype(np.int64).T
    return SIDE * row + column


def remaining_fraction(part: Ints) -> Floats:
    """Share (p,) of the measurements that is left without each of the PARTS parts; `part` (n,): that of each one."""
    return 1 - np.bincount(part, minlength=PARTS) / max(len(part), 1)
