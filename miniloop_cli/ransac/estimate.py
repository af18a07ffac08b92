"""The robust estimator: matches of a pair or of a closed cycle of scans in, the pose of every edge out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Ransac
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.search import search
from miniloop_cli.ransac.settle import settle
from miniloop_cli.ransac.system import compose
from miniloop_cli.solvers import cycle3, cycle4, cycle5, pairwise

Floats = NDArray[np.float64]
SOLVERS = {2: pairwise, 3: cycle3, 4: cycle4, 5: cycle5}
NAMES = {2: "pairwise", 3: "cycle3", 4: "cycle4", 5: "cycle5"}
SIGMAS = 3.0  # a match may be this many of its own sigmas farther off than the threshold


@dataclass(frozen=True)
class EdgeMatches:
    """3D-3D matches from one scan to another: p (m, 3) and q (m, 3) metres, covariances (m, 3, 3) m^2."""

    p: Floats
    q: Floats
    cov_p: Floats
    cov_q: Floats

    def __len__(self) -> int:
        return len(self.p)

    @property
    def reversed(self) -> EdgeMatches:
        """The same matches seen from the other scan."""
        return EdgeMatches(self.q, self.p, self.cov_q, self.cov_p)


@dataclass(frozen=True)
class EdgeEstimate:
    """What was found for one edge.

    T (4, 4) maps the first scan's points into the second's; `inliers` (m,) bool; `chi2` (m,) squared Mahalanobis
    distances; `information` (6, 6) from this edge's own inliers; `covariance` (6, 6) of T in the joint estimate;
    both for the perturbation [exp(w) | v] T.
    """

    T: Floats
    inliers: NDArray[np.bool_]
    chi2: Floats
    information: Floats
    covariance: Floats


@dataclass(frozen=True)
class CycleEstimate:
    """Edges in the order of the cycle, the closing edge (first scan to last scan) last; hypotheses that were tried."""

    edges: tuple[EdgeEstimate, ...]
    hypotheses: int


def estimate(
    edges: Sequence[EdgeMatches], settings: Ransac, chi2_gate: float, rng: np.random.Generator
) -> CycleEstimate | None:
    """Relative poses of a pair (one edge) or of a cycle of n scans (n edges), jointly; None if none was found.

    Edge e < n - 1 leads from scan e to scan e + 1 of the cycle, the last from scan 0 to scan n - 1.
    """
    scans = max(len(edges), 2)
    solver = SOLVERS[scans]
    P, Q, CP, CQ, start = pack(edges)
    variance = (CP[[0, 3, 5]].sum(axis=0) + CQ[[0, 3, 5]].sum(axis=0)) / 3
    soft = settings.score == "msac"
    gate2 = settings.threshold_m**2 + (SIGMAS**2 * variance if soft else 0 * variance)
    found, T, _, hypotheses = search(
        scans,
        solver.MAX_SOLUTIONS,
        P,
        Q,
        CP,
        CQ,
        start,
        np.array(solver.MATCHES, np.int64),
        1 / gate2,
        float(soft),
        False,
        settings.iterations,
        settings.confidence if settings.adaptive else 1.0,
        3 if settings.local_optimization else 0,
        rng,
        np.zeros((len(edges), 6, 6)),
    )
    if not found:
        return None
    if not soft:
        return _counted(edges, T, settings.threshold_m, hypotheses)
    sound, chi2, information, covariance = settle(T, P, Q, CP, CQ, start, 4 * gate2.max(), chi2_gate, False)
    if not sound:
        return None
    poses = np.concatenate([T, compose(T)[None]]) if scans > 2 else T
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


def pack(edges: Sequence[EdgeMatches]) -> tuple[Floats, Floats, Floats, Floats, NDArray[np.int64]]:
    """Structure of arrays for the kernels: P, Q (3, N), CP, CQ (6, N) as xx xy xz yy yz zz, start (edges + 1,)."""
    rows, columns = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
    P, Q = (np.ascontiguousarray(np.concatenate(x).T) for x in ([e.p for e in edges], [e.q for e in edges]))
    CP, CQ = (
        np.ascontiguousarray(np.concatenate(x)[:, rows, columns].T)
        for x in ([e.cov_p for e in edges], [e.cov_q for e in edges])
    )
    return P, Q, CP, CQ, np.cumsum([0] + [len(e) for e in edges])


def procrustes(p: Floats, q: Floats) -> Floats:
    """Rigid (4, 4) that maps p (m, 3) onto q (m, 3), m >= 3, in least squares (Schönemann 1966; Arun et al. 1987)."""
    mean_p, mean_q = p.mean(axis=0), q.mean(axis=0)
    R = se3.project_so3((q - mean_q).T @ (p - mean_p))
    return se3.pose(R, mean_q - R @ mean_p)


def _counted(edges: Sequence[EdgeMatches], T: Floats, threshold_m: float, hypotheses: int) -> CycleEstimate:
    """The paper's ending: inliers by distance, Procrustes on them, edge by edge."""
    poses = np.concatenate([T, compose(T)[None]]) if len(edges) > 1 else T
    found = []
    for edge, pose34 in zip(edges, poses, strict=True):
        pose = se3.pose(pose34[:, :3], pose34[:, 3])
        near = np.linalg.norm(se3.transform(pose, edge.p) - edge.q, axis=1) < threshold_m
        if near.sum() >= 3:
            pose = procrustes(edge.p[near], edge.q[near])
        distance2 = ((se3.transform(pose, edge.p) - edge.q) ** 2).sum(axis=1)
        variance = distance2[near].sum() / max(3 * near.sum() - 6, 1)
        information = _isotropic_information(se3.transform(pose, edge.p[near]), variance)
        covariance = np.linalg.pinv(information)
        found.append(EdgeEstimate(pose, near, distance2 / max(variance, 1e-12), information, covariance))
    return CycleEstimate(tuple(found), hypotheses)


def _isotropic_information(x: Floats, variance_m2: float) -> Floats:
    """(6, 6) information of a pose from (m, 3) transformed points with the same isotropic noise."""
    J = np.concatenate([-se3.hat(x), np.broadcast_to(np.eye(3), (len(x), 3, 3))], axis=2)
    return np.einsum("nki,nkj->ij", J, J) / max(variance_m2, 1e-12)
