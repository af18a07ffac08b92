"""The paper's synthetic experiment (sec. 5.1): pairs and 3-, 4-, 5-cycles of five cameras, against noise and outliers.

400 points and five cameras in a cube of 400 units. Two cameras share a random 20 to 70 % of the points; the noise of a
point grows with its distance from the camera. RANSAC with 1000 hypotheses an estimation and inliers within 50 units.
The pose of camera 5 seen from camera 1 is chained from four pairs, two 3-cycles, a 4-cycle and a pair, or one 5-cycle.
The paper does not give its noise levels and shares of wrong matches: ours are NOISE and OUTLIERS.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from matplotlib.figure import Figure

from miniloop_cli.bench import Row
from miniloop_cli.bench.problems import random_rotations
from miniloop_cli.config import Ransac
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.ransac.matches import EdgeMatches
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.runtime.progress import track
from miniloop_cli.typing import Floats

Edges = dict[tuple[int, int], EdgeMatches]

CAMERAS, POINTS, SIDE = 5, 400, 400.0
SHARED = (0.2, 0.7)
# Standard deviation of a coordinate over the distance from the camera; the levels of each sweep and the fixed values.
NOISE, NOISE_FIXED = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05), 0.02
OUTLIERS, OUTLIERS_FIXED = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6), 0.2
# Smallest standard deviation (units) of a point, so that covariances are not singular.
LEAST_SIGMA = 1e-3
METHODS: dict[str, list[tuple[int, ...]]] = {
    "pairwise": [(0, 1), (1, 2), (2, 3), (3, 4)],
    "3-cycle": [(0, 1, 2), (2, 3, 4)],
    "4-,2-cycle": [(0, 1, 2, 3), (3, 4)],
    "5-cycle": [(0, 1, 2, 3, 4)],
}
PAPER = Ransac(score="count", threshold_m=50.0, iterations=1000, adaptive=False, local_optimization=False)
# The paper's estimator, and ours: graded scores, refinement on all inliers of the cycle.
VARIANTS = {"paper": PAPER, "refined": PAPER.model_copy(update={"score": "msac", "local_optimization": True})}
CHI2_GATE = 16.0


def edges_of(scans: tuple[int, ...]) -> list[tuple[int, int]]:
    """Edges of a pair or of a cycle of scans, the closing edge last."""
    chain = list(pairwise(scans))
    return chain if len(scans) == 2 else [*chain, (scans[0], scans[-1])]


def random_scene(rng: np.random.Generator, noise: float, outliers: float) -> tuple[Floats, Edges]:
    """True poses T_camera_world (5, 4, 4) and the matches between all pairs of cameras.

    noise: standard deviation by distance; outliers: share of matches whose second point is another point of the scene.
    """
    points = rng.uniform(-0.5 * SIDE, 0.5 * SIDE, (POINTS, 3))
    centres = rng.uniform(-0.5 * SIDE, 0.5 * SIDE, (CAMERAS, 3))
    T = se3.inverse(se3.pose(random_rotations(rng, (CAMERAS,)), centres))
    edges = {}
    for i in range(CAMERAS):
        for j in range(i + 1, CAMERAS):
            shared = rng.permutation(POINTS)[: int(rng.uniform(*SHARED) * POINTS)]
            wrong = shared.copy()
            count = round(outliers * len(shared))
            wrong[:count] = rng.integers(POINTS, size=count)
            (p, cov_p), (q, cov_q) = (_seen(rng, T[k], points[which], noise) for k, which in ((i, shared), (j, wrong)))
            edges[i, j] = EdgeMatches(p, q, cov_p, cov_q)
    return T, edges


def _seen(rng: np.random.Generator, T: Floats, points: Floats, noise: float) -> tuple[Floats, Floats]:
    """Points (m, 3) in the frame of a camera with noise, and their covariances (m, 3, 3)."""
    x = se3.transform(T, points)
    sigma = noise * np.linalg.norm(x, axis=1)
    variance = np.maximum(sigma, LEAST_SIGMA) ** 2
    return x + rng.normal(size=x.shape) * sigma[:, None], variance[:, None, None] * np.eye(3)


def chained(
    segments: Sequence[tuple[int, ...]], edges: Edges, settings: Ransac, rng: np.random.Generator
) -> tuple[Floats, float] | None:
    """Pose T_5_1 (4, 4) by the estimates of the segments and the share of inliers (0 to 1) among their matches."""
    T, inliers, matches = np.eye(4), 0, 0
    for scans in segments:
        used = [edges[edge] for edge in edges_of(scans)]
        found = estimate(used, settings, CHI2_GATE, rng)
        if found is None:
            return None
        poses = [edge.T for edge in found.edges]
        for pose in poses[: len(scans) - 1]:
            T = pose @ T
        for pose, edge in zip(poses, used, strict=True):
            distance = np.linalg.norm(se3.transform(pose, edge.p) - edge.q, axis=1)
            inliers += int((distance < settings.threshold_m).sum())
            matches += len(edge)
    return T, inliers / matches


def run_trial(seed: Sequence[int], noise: float, outliers: float) -> dict[tuple[str, str], tuple[float, float, float]]:
    """Rotation error (deg), translation error (units) and inliers (%) of every method and variant on one scene."""
    T, edges = random_scene(np.random.default_rng(seed), noise, outliers)
    truth = T[-1] @ se3.inverse(T[0])
    results = {}
    for k, (method, segments) in enumerate(METHODS.items()):
        for v, (variant, settings) in enumerate(VARIANTS.items()):
            found = chained(segments, edges, settings, np.random.default_rng([*seed, k, v]))
            if found is not None:
                error = se3.rotation_angle_deg(truth[:3, :3].T @ found[0][:3, :3])
                shift = np.linalg.norm(found[0][:3, 3] - truth[:3, 3])
                results[method, variant] = (float(error), float(shift), 100 * found[1])
    return results


def noise_rows(trials: int, seed: int, workers: Workers) -> list[Row]:
    """One row for each sweep, level, method and variant: means and medians over `trials` scenes.

    Every trial has its own generator, so rows do not depend on the number of jobs.
    """
    settings = [("noise", level, OUTLIERS_FIXED) for level in NOISE]
    settings += [("outliers", NOISE_FIXED, level) for level in OUTLIERS]
    rows: list[Row] = []
    with Parallel(n_jobs=workers.jobs) as parallel:
        for place, (sweep, noise, outliers) in enumerate(track(settings, "Levels", quiet=workers.quiet)):
            trial = delayed(partial(run_trial, noise=noise, outliers=outliers))
            results = list(parallel(trial([seed, place, i]) for i in range(trials)))
            for method in METHODS:
                for variant in VARIANTS:
                    found = np.array([r[method, variant] for r in results if (method, variant) in r]).reshape(-1, 3)
                    rows.append(
                        {
                            "sweep": sweep,
                            "noise": noise,
                            "outliers": outliers,
                            "method": method,
                            "variant": variant,
                            "trials": trials,
                            "failed": trials - len(found),
                            **_summary(found),
                        }
                    )
    return rows


def _summary(found: Floats) -> dict[str, float | None]:
    """Means and medians of (m, 3) errors; null if there are none."""
    names = ("rot_deg", "trans", "inliers_percent")
    kinds: dict[str, Callable[[Floats], Any]] = {"mean": np.mean, "median": np.median}
    return {
        # Digits beyond the ninth are rounding errors, which depend on the alignment of arrays in memory.
        f"{name}_{kind}": round(float(of(found[:, i])), 9) if len(found) else None
        for i, name in enumerate(names)
        for kind, of in kinds.items()
    }


def draw_noise(rows: Sequence[Row]) -> Figure:
    """The paper's figure: medians of rotation error, translation error and inliers; one row of panels a sweep."""
    figure = Figure(figsize=(11, 6.4), layout="constrained")
    panels = figure.subplots(2, 3)
    labels = {"rot_deg_median": "rotation error [deg]", "trans_median": "translation error [units]"}
    labels["inliers_percent_mean"] = "inliers [%]"
    for line, sweep in zip(panels, ("noise", "outliers"), strict=True):
        for axes, (key, label) in zip(line, labels.items(), strict=True):
            for k, method in enumerate(METHODS):
                for variant, style in (("paper", "--"), ("refined", "-")):
                    points = [
                        (100 * row[sweep], row[key])
                        for row in rows
                        if (row["sweep"], row["method"], row["variant"]) == (sweep, method, variant)
                        and row[key] is not None
                    ]
                    axes.plot(*np.reshape(points, (-1, 2)).T, style, color=f"C{k}", label=f"{method}, {variant}")
            axes.set(xlabel={"noise": "noise [% of distance]", "outliers": "wrong matches [%]"}[sweep], ylabel=label)
            axes.grid(alpha=0.3)
            axes.set_ylim(bottom=0)
    panels[0, 2].legend(fontsize=7)
    return figure
