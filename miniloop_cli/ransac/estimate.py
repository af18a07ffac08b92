"""The robust estimator: from matches of a pair or of a closed cycle of scans to the pose of every edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from miniloop_cli.config import Ransac
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.procrustes import align_points
from miniloop_cli.ransac.local_refinement import edge_poses, refine_locally
from miniloop_cli.ransac.matches import EdgeMatches, Packed, pack
from miniloop_cli.ransac.search import search
from miniloop_cli.solvers import load, solver_name
from miniloop_cli.typing import Bools, Floats

SIGMAS = 3.0  # the threshold of a match grows by so many of its own sigmas


@dataclass(frozen=True)
class EdgeEstimate:
    """The estimate of one edge.

    T (4, 4) maps the first scan's points into the second's; `inliers` (m,) bool; `chi2` (m,) squared Mahalanobis
    distances; `information` (6, 6) from this edge's own inliers; `covariance` (6, 6) of T in the joint estimate;
    both for the perturbation [exp(w) | v] T.
    """

    T: Floats
    inliers: Bools
    chi2: Floats
    information: Floats
    covariance: Floats


@dataclass(frozen=True)
class CycleEstimate:
    """Edges in the order of the cycle, the closing edge (first scan to last scan) last; the number of hypotheses."""

    edges: tuple[EdgeEstimate, ...]
    hypotheses: int


def estimate(
    edges: Sequence[EdgeMatches],
    settings: Ransac,
    chi2_gate: float,
    rng: np.random.Generator,
    upright: bool = False,
) -> CycleEstimate | None:
    """Relative poses of a pair (one edge) or of a cycle of n scans (n edges), jointly; None if none was found.

    Edge e < n - 1 leads from scan e to scan e + 1 of the cycle, the last from scan 0 to scan n - 1. `upright`: the
    axis z of all scans is vertical (2 to 4 scans). Raises MiniloopError for matches that are not finite and for a
    number of scans without a solver.
    """
    if not edges:
        raise MiniloopError("at least one edge is needed")
    solver = load(solver_name(max(len(edges), 2), upright))
    matches, soft = pack(edges), settings.score == "msac"
    gate2 = _gate2(matches, settings)
    T, hypotheses = search(matches, 1 / gate2, solver, settings, upright, rng)
    if T is None:
        return None
    if not soft:
        return _counted(edges, T, settings.threshold_m, hypotheses)
    return _settled(edges, T, matches, 4 * gate2.max(), chi2_gate, upright, hypotheses)


def refit(
    edges: Sequence[EdgeMatches], T: Floats, settings: Ransac, chi2_gate: float, hypotheses: int = 0
) -> CycleEstimate | None:
    """The last step of `estimate`, from given poses T (n-1, 3, 4) of the chain: refinement and inliers."""
    matches = pack(edges)
    if settings.score == "count":
        return _counted(edges, T, settings.threshold_m, hypotheses)
    return _settled(edges, T, matches, 4 * _gate2(matches, settings).max(), chi2_gate, False, hypotheses)


def _gate2(matches: Packed, settings: Ransac) -> Floats:
    """(N,) squared inlier distance (m^2) of each match while sampling."""
    if settings.score == "count":
        return np.full(matches.P.shape[1], settings.threshold_m**2)
    variance = (matches.CP[[0, 3, 5]].sum(axis=0) + matches.CQ[[0, 3, 5]].sum(axis=0)) / 3
    return settings.threshold_m**2 + SIGMAS**2 * variance


def _settled(
    edges: Sequence[EdgeMatches],
    T: Floats,
    matches: Packed,
    gate2: float,
    chi2_gate: float,
    upright: bool,
    hypotheses: int,
) -> CycleEstimate | None:
    settled = refine_locally(T, matches, gate2, chi2_gate, upright)
    if settled is None:
        return None
    chi2, information, covariance = settled
    start, poses = matches.start, edge_poses(T, len(edges))
    return CycleEstimate(
        tuple(
            EdgeEstimate(
                se3.pose(pose[:, :3], pose[:, 3]),
                chi2[first:last] < chi2_gate,
                chi2[first:last],
                information[e],
                covariance[e],
            )
            for e, (pose, first, last) in enumerate(zip(poses, start[:-1], start[1:], strict=True))
        ),
        hypotheses,
    )


def _counted(edges: Sequence[EdgeMatches], T: Floats, threshold_m: float, hypotheses: int) -> CycleEstimate:
    """The paper's last step: inliers by distance, Procrustes on them, edge by edge."""
    poses = edge_poses(T, len(edges))
    found = []
    for edge, pose34 in zip(edges, poses, strict=True):
        pose = se3.pose(pose34[:, :3], pose34[:, 3])
        near = np.linalg.norm(se3.transform(pose, edge.p) - edge.q, axis=1) < threshold_m
        if near.sum() >= 3:
            motion = align_points(edge.p[near], edge.q[near])
            pose = se3.pose(motion.R, motion.t)
        distance2 = ((se3.transform(pose, edge.p) - edge.q) ** 2).sum(axis=1)
        variance = distance2[near].sum() / max(3 * near.sum() - 6, 1)
        information = _isotropic_information(se3.transform(pose, edge.p[near]), variance)
        covariance = np.linalg.pinv(information).astype(float)
        found.append(EdgeEstimate(pose, near, distance2 / max(variance, 1e-12), information, covariance))
    return CycleEstimate(tuple(found), hypotheses)


def _isotropic_information(x: Floats, variance_m2: float) -> Floats:
    """(6, 6) information of a pose from (m, 3) transformed points with the same isotropic noise."""
    J = np.concatenate([-se3.hat(x), np.broadcast_to(np.eye(3), (len(x), 3, 3))], axis=2)
    return np.einsum("nki,nkj->ij", J, J) / max(variance_m2, 1e-12)
