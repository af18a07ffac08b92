"""The search for the poses of a pair or a cycle: sample, solve, score, refine, in batches."""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.config import Ransac
from miniloop_cli.ransac.gauss_newton import CAUCHY2, gauss_newton
from miniloop_cli.ransac.matches import Packed
from miniloop_cli.ransac.sampling import draw_samples
from miniloop_cli.ransac.scoring import best_of, inlier_sample_share, score_cycle
from miniloop_cli.solvers.batch import MinimalSolver
from miniloop_cli.typing import Floats

FIRST_BATCH, LARGEST_BATCH = 32, 256  # hypotheses of the first batch; later ones double
MAX_KEPT_SAMPLES = 4096  # samples from which the share of clean ones is estimated
CLEAN_WANTED = 3.0  # a sample of inliers may still give a poor pose, so several are needed
BASELINE_SHARE = 0.1
TOLERANCE_SHARE = 0.5  # of the gate: how much each of two matches may change their distance
POLISH_STEPS = 3
NEARLY_REAL = 0.2  # rad; complex roots so near the real axis are hypotheses: noise splits double roots so


def hypotheses_needed(clean_share: float, confidence: float) -> float:
    """Samples that hold a clean one (probability `clean_share` each) with this `confidence`, times CLEAN_WANTED."""
    if clean_share <= 0:
        return math.inf
    if clean_share >= 1:
        return CLEAN_WANTED
    return CLEAN_WANTED * math.log1p(-confidence) / math.log1p(-clean_share)


def search(
    matches: Packed,
    inverse_gate2: Floats,
    solver: MinimalSolver,
    settings: Ransac,
    upright: bool,
    rng: np.random.Generator,
) -> tuple[Floats | None, int]:
    """Poses (n-1, 3, 4) of least cost, or None, and the number of hypotheses tried.

    inverse_gate2 (N,) 1 / inlier distance^2 (1/m^2) of each match. The result depends on the generator alone.
    """
    sizes = np.array(solver.matches, np.int64)
    scans = max(len(sizes), 2)
    soft = float(settings.score == "msac")
    tolerance = TOLERANCE_SHARE / np.sqrt(inverse_gate2)
    best, trial, cost = np.zeros((scans - 1, 3, 4)), np.zeros((scans - 1, 3, 4)), np.inf
    floors = np.full(len(sizes), np.inf)
    kept = np.zeros((0, sizes.sum()), np.int64)
    tried, batch = 0, FIRST_BATCH
    needed: float = settings.iterations
    while tried < needed:
        count = min(batch, settings.iterations - tried)
        samples = np.empty((count, sizes.sum()), np.int64)
        p, q = np.empty((2, *samples.shape, 3))
        draw_samples(matches, tolerance, sizes, BASELINE_SHARE, upright, rng, samples, p, q)
        T, counts = solver.solve_batch(p, q, NEARLY_REAL)
        trial_cost = best_of(T, counts, matches, inverse_gate2, soft, floors, trial)
        if settings.local_optimization and np.isfinite(trial_cost):
            trial_cost = _optimise(trial, matches, inverse_gate2, soft, upright, trial_cost)
        if trial_cost < cost:
            best, trial, cost = trial, best, trial_cost
        tried, batch = tried + count, min(2 * batch, LARGEST_BATCH)
        if settings.adaptive and np.isfinite(cost):
            kept = np.concatenate([kept, samples])[-MAX_KEPT_SAMPLES:]
            share = inlier_sample_share(best, matches, inverse_gate2, kept, sizes)
            needed = min(settings.iterations, hypotheses_needed(share, settings.confidence))
    return (best if np.isfinite(cost) else None), tried


def _optimise(T: Floats, matches: Packed, inverse_gate2: Floats, soft: float, upright: bool, cost: float) -> float:
    """Refine T (n-1, 3, 4) of this cost on all matches, in place; returns the cost then.

    Graduated: first as if every match were as uncertain as the gate allows, then by its own noise.
    """
    gate2 = 1.0 / inverse_gate2.min()
    edges = len(matches.start) - 1
    H, edge_H = np.empty((6 * len(T), 6 * len(T))), np.empty((edges, 6, 6))
    floors, closing = np.empty(edges), np.empty((3, 4))
    trial = T.copy()
    for inflation2 in (gate2 / 9, 0.0):
        if gauss_newton(trial, matches, inflation2, 4 * gate2, CAUCHY2, upright, POLISH_STEPS, H, edge_H):
            floors[:] = np.inf
            refined = score_cycle(trial, matches, inverse_gate2, soft, cost, floors, closing)
            if refined < cost:
                cost, T[:] = refined, trial
    return cost
