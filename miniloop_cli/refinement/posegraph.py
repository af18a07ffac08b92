"""Pose graph: all poses at once from relative poses with information matrices, under a robust kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.geometry.se3 import exp_so3, pose, project_so3
from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.edge_terms import Edges, add_edges, evaluate_edges, make_edges
from miniloop_cli.refinement.gauge import anchor_of, restoring_motion, with_untied
from miniloop_cli.refinement.levenberg_marquardt import Descent, minimise
from miniloop_cli.refinement.pose_equations import add_pose_terms, pose_cost, term_pairs, touched
from miniloop_cli.refinement.robust import Kernel, noise_gain
from miniloop_cli.refinement.terms import PoseTerm
from miniloop_cli.typing import Floats


@dataclass(frozen=True)
class PoseGraphSettings:
    """Kernel on the squared Mahalanobis residual (6 degrees of freedom), its scale in sigmas, stopping, gauge.

    The scale is wide because information matrices of edges that share features are too optimistic.
    """

    kernel: Kernel = "cauchy"
    scale: float = 10.0
    max_iterations: int = 50
    relative_tolerance: float = 1e-6
    fixed_frame: int = 0
    covariance: bool = True


@dataclass(frozen=True)
class PoseGraphResult:
    """Poses (n, 4, 4), their covariances, and squared Mahalanobis residuals and robust weights of the edges (m,).

    covariance (n, 6, 6), None unless requested: of (w, v) in T_world_cam(true) = T_world_cam [exp(w) | v], given the
    fixed frame, which has zero; infinite for frames not connected to it. It is that of the model, times
    `variance_factor` where this exceeds 1: the ratio of the residuals to those that the information matrices predict
    (1 without loops).
    """

    T_world_cam: Floats
    covariance: Floats | None
    chi2: Floats
    weights: Floats
    variance_factor: float
    descent: Descent


def refine_pose_graph(
    T_world_cam: Floats,
    pairs: ArrayLike,
    T_j_i: Floats,
    information: Floats,
    settings: PoseGraphSettings | None = None,
    pose_terms: Sequence[PoseTerm] = (),
) -> PoseGraphResult:
    """Minimise sum rho(r^T Lambda r) over the poses (n, 4, 4), beginning at those given.

    pairs (m, 2) rows (i, j); T_j_i (m, 4, 4) maps points of scan i into scan j; information (m, 6, 6) of the noise
    xi in T_j_i(true) = Exp(xi) T_j_i, rotation (rad) first, then translation (m).
    `pose_terms` are minimised along with the edges.
    The fixed frame keeps its pose. So does the first frame of any group that is not connected to it, except in what
    pose terms measure of it.
    Raises ValueError for shapes that do not fit or numbers that are not finite, GraphError for impossible pairs.
    """
    settings = settings or PoseGraphSettings()
    T = np.asarray(T_world_cam, float)
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise ValueError(f"poses must be (n, 4, 4), not {T.shape}")
    if not np.isfinite(T).all():
        raise ValueError("poses must be finite")
    if not 0 <= settings.fixed_frame < len(T):
        raise ValueError(f"no frame {settings.fixed_frame} to hold fixed among {len(T)}")
    edges = make_edges(len(T), pairs, T_j_i, information, settings.kernel, settings.scale)
    problem = _PoseGraph(T, edges, pose_terms)
    descent = minimise(problem, settings.max_iterations, settings.relative_tolerance)
    chi2, weights = np.empty(len(edges.i)), np.empty(len(edges.i))
    evaluate_edges(edges, problem.R, problem.t, chi2, weights)

    pairs = np.concatenate([edges.pairs, term_pairs(pose_terms)])
    anchor = anchor_of(len(T), pairs, settings.fixed_frame)
    refined = problem.T_world_cam
    refined = restoring_motion(T, refined, anchor, pose_terms) @ refined
    is_anchor = anchor == np.arange(len(T))
    factor = _variance_factor(chi2, 6 * (len(chi2) - int(np.count_nonzero(~is_anchor))))
    covariance = None
    if settings.covariance:
        gain = noise_gain(settings.kernel, settings.scale, 6)
        marginals = BlockSystem(is_anchor, pairs).marginals(problem.hessian(0.0)[0])
        covariance = with_untied(gain * max(factor, 1.0) * marginals, anchor, settings.fixed_frame)
    return PoseGraphResult(refined, covariance, chi2, weights, factor, descent)


def _variance_factor(chi2: Floats, redundancy: int) -> float:
    """Ratio of the median residual to that of chi-square with 6 degrees of freedom, 5.348.

    The median, as wrong edges are not noise; it is corrected for the degrees of freedom of the poses.
    """
    return float(np.median(chi2)) / 5.348 * 6 * len(chi2) / redundancy if redundancy else 1.0


class _PoseGraph:
    """The state of the descent: poses (relative to their mean position), and the last proposal."""

    def __init__(self, T: Floats, edges: Edges, pose_terms: Sequence[PoseTerm]) -> None:
        self.edges, self.pose_terms = edges, pose_terms
        self.origin = T[:, :3, 3].mean(axis=0)
        self.R, self.t = np.ascontiguousarray(project_so3(T[:, :3, :3])), T[:, :3, 3] - self.origin
        pairs = np.concatenate([edges.pairs, term_pairs(pose_terms)])
        self._loose = np.bincount(pairs.ravel(), minlength=len(T)) == 0
        self.system = BlockSystem(self._loose & ~touched(pose_terms, len(T)), pairs)
        self.block = self.system.block_of(edges.i, edges.j)
        self._proposal = (self.R, self.t)

    @property
    def T_world_cam(self) -> Floats:
        """(n, 4, 4) the poses."""
        return pose(self.R, self.t + self.origin)

    def hessian(self, damping: float) -> tuple[Floats, Floats, float]:
        """Blocks (b, 6, 6), gradient (n, 6) and cost at the present poses."""
        S, g = np.zeros((len(self.system), 6, 6)), np.zeros((len(self.R), 6))
        cost = add_edges(self.edges, self.block, self.R, self.t, damping, S, g)
        add_pose_terms(self.pose_terms, self.T_world_cam, self._loose, damping, self.system, S, g)
        return S, g, cost + pose_cost(self.pose_terms, self.T_world_cam)

    def propose(self, damping: float) -> tuple[float, float]:
        S, g, cost = self.hessian(damping)
        step = self.system.solve(S, -g)
        R = np.ascontiguousarray(self.R @ exp_so3(step[:, :3]))
        self._proposal = R, self.t + np.einsum("nij,nj->ni", self.R, step[:, 3:])
        scratch = np.empty((2, len(self.edges.i)))
        proposed = evaluate_edges(self.edges, *self._proposal, *scratch)
        return cost, proposed + pose_cost(self.pose_terms, pose(R, self._proposal[1] + self.origin))

    def accept(self) -> None:
        self.R, self.t = self._proposal
