"""How much larger the difference of two independent fits is than their standard deviations say.

Standard deviations that a fit derives from its own residuals do not contain an error that acts on all of its
measurements. Two fits to different measurements show it, as far as it differs between them. All standard deviations are
then enlarged by the Birge ratio (R. T. Birge, Phys. Rev. 40, 207 (1932)); it never makes them smaller.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.typing import Floats


def birge_ratio(difference: Floats, covariance: Floats) -> float:
    """The ratio, at least 1, from the difference (q,) of two fits and its covariance (q, q); q > 0.

    Each parameter counts alone: a covariance from a few groups does not have full rank, so that its inverse would count
    combinations of parameters in which these groups agree by chance.
    """
    return max(1.0, float(np.sqrt(np.mean(difference**2 / np.diag(covariance)))))
