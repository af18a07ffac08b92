"""Equal exposure and white balance of views: a gain for each view and colour, so that common surfaces agree."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, diags_array

from miniloop_cli.typing import Floats, Floats32, Ints

DARKEST, BRIGHTEST = 12, 243  # of 255: values beyond are clipped
ROUNDS = 5
SPREAD = 0.1  # of a logarithm: samples that differ more count less (highlights, wrong positions)
PRIOR = 1.0  # weight, in samples, of a prior gain of 1 for views without common surfaces
LARGEST_GAIN = 3.0


def gains(view: Ints, point: Ints, colors: Floats32, views: int) -> Floats:
    """(views, 3) factors on the colours of each view.

    Samples: the view (k,), the point of the surface (k,) and its RGB colour in the view (k, 3). Least squares over
    log(gain) + log(colour) = log(albedo of the point), reweighted by a Cauchy kernel; the mean log gain is 0.
    """
    found = np.ones((views, 3))
    for channel in range(3):
        value = colors[:, channel]
        usable = (value > DARKEST) & (value < BRIGHTEST)
        found[:, channel] = np.exp(_log_gains(view[usable], point[usable], np.log(value[usable].astype(float)), views))
    return found.clip(1 / LARGEST_GAIN, LARGEST_GAIN)


def _log_gains(view: Ints, point: Ints, log_value: Floats, views: int) -> Floats:
    """(views,) the logarithms: the normal equations with the albedos eliminated."""
    gain = np.zeros(views)
    if not len(view):
        return gain
    _, point = np.unique(point, return_inverse=True)
    weight = np.ones(len(view))
    for _ in range(ROUNDS):
        total = np.bincount(point, weight)
        albedo = np.bincount(point, weight * (log_value + gain[view])) / total
        residual = log_value + gain[view] - albedo[point]
        weight = 1 / (1 + (residual / SPREAD) ** 2)
        total = np.bincount(point, weight)
        W = coo_array((weight, (view, point)), shape=(views, len(total))).tocsr()
        A = np.diag(np.bincount(view, weight, views)) - (W @ diags_array(1 / total) @ W.T).toarray()
        mean = np.bincount(point, weight * log_value) / total
        b = -np.bincount(view, weight * (log_value - mean[point]), minlength=views)
        gain = np.linalg.solve(A + PRIOR * np.eye(views), b)
        gain -= gain.mean()
    return gain
