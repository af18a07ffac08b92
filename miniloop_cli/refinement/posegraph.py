"""Pose graph: all poses at once from relative poses with information matrices, under a robust kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from miniloop_cli.averaging.graph import checked_pairs, components
from miniloop_cli.geometry.se3 import exp_so3, pose, project_so3
from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.edge_terms import Edges, add_edges, evaluate_edges
from miniloop_cli.refinement.lm import Descent, minimise
from miniloop_cli.refinement.robust import KERNELS, Kernel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseGraphSettings:
    """Kernel on the squared Mahalanobis residual (6 degrees of freedom), its scale in sigmas, stopping, gauge."""

    kernel: Kernel = "cauchy"
    scale: float = 3.0
    max_iterations: int = 50
    relative_tolerance: float = 1e-6
    fixed_frame: int = 0


@dataclass(frozen=True)
class PoseGraphResult:
    """Poses (n, 4, 4); of each edge the squared Mahalanobis residual and the robust weight (m,); how it went."""

    T_world_cam: Array
    chi2: Array
    weights: Array
    descent: Descent


def refine_pose_graph(
    T_world_cam: Array, pairs: ArrayLike, T_j_i: Array, information: Array, settings: PoseGraphSettings | None = None
) -> PoseGraphResult:
    """Minimise sum rho(r^T Lambda r) over the poses (n, 4, 4), beginning at those given.

    pairs (m, 2) rows (i, j); T_j_i (m, 4, 4) maps points of scan i into scan j; information (m, 6, 6) of the noise
    xi in T_j_i(true) = Exp(xi) T_j_i, rotation (rad) first, then translation (m).
    The fixed frame keeps its pose, as does the first frame of any component that is not connected to it.
    Raises ValueError for shapes that do not fit or numbers that are not finite, GraphError for edges that are none.
    """
    settings = settings or PoseGraphSettings()
    T = np.asarray(T_world_cam, float)
    if T.ndim != 3 or T.shape[1:] != (4, 4) or not np.isfinite(T).all():
        raise ValueError(f"poses must be finite (n, 4, 4), not {T.shape}")
    if not 0 <= settings.fixed_frame < len(T):
        raise ValueError(f"no frame {settings.fixed_frame} to hold fixed among {len(T)}")
    edges = make_edges(len(T), pairs, T_j_i, information, settings.kernel, settings.scale)
    problem = _PoseGraph(T, edges, anchors(len(T), np.stack([edges.i, edges.j], axis=1), settings.fixed_frame))
    descent = minimise(problem, settings.max_iterations, settings.relative_tolerance)
    chi2, weights = np.empty(len(edges.i)), np.empty(len(edges.i))
    evaluate_edges(edges, problem.R, problem.t, chi2, weights)
    T_new = pose(problem.R, problem.t + problem.origin)
    T_new[problem.fixed] = T[problem.fixed]
    return PoseGraphResult(T_new, chi2, weights, descent)


def anchors(count: int, pairs: NDArray[np.int64], fixed_frame: int) -> NDArray[np.bool_]:
    """(count,) frames to hold fixed: the one given, and the first of every component it is not connected to."""
    labels = components(count, pairs)
    _, first = np.unique(labels, return_index=True)
    fixed = np.zeros(count, bool)
    fixed[first] = True
    fixed[first[labels[fixed_frame]]] = False
    fixed[fixed_frame] = True
    return fixed


def make_edges(count: int, pairs: ArrayLike, T_j_i: Array, information: Array, kernel: Kernel, scale: float) -> Edges:
    """Checked edges for the kernels. Raises ValueError or GraphError."""
    pairs = checked_pairs(count, pairs)
    T, L = np.asarray(T_j_i, float).reshape(-1, 4, 4), np.asarray(information, float).reshape(-1, 6, 6)
    if not len(pairs) == len(T) == len(L):
        raise ValueError(f"{len(pairs)} pairs, {len(T)} relative poses, {len(L)} information matrices: not one a row")
    if not (np.isfinite(T).all() and np.isfinite(L).all()):
        raise ValueError("relative poses and information matrices must be finite")
    L = (L + L.transpose(0, 2, 1)) / 2
    R = np.ascontiguousarray(project_so3(T[:, :3, :3]))
    i, j = np.ascontiguousarray(pairs.T)
    return Edges(i, j, R, np.ascontiguousarray(T[:, :3, 3]), L, KERNELS[kernel], float(scale**2))


class _PoseGraph:
    """The state of the descent: poses (relative to their mean position), and the last proposal."""

    def __init__(self, T: Array, edges: Edges, fixed: NDArray[np.bool_]) -> None:
        self.edges, self.fixed = edges, fixed
        self.origin = T[:, :3, 3].mean(axis=0)
        self.R, self.t = np.ascontiguousarray(project_so3(T[:, :3, :3])), T[:, :3, 3] - self.origin
        self.system = BlockSystem(fixed, np.stack([edges.i, edges.j], axis=1))
        self.block = self.system.block_of(edges.i, edges.j)
        self._proposal = (self.R, self.t)
        self._scratch = np.empty(len(edges.i)), np.empty(len(edges.i))

    def propose(self, damping: float) -> tuple[float, float]:
        S, g = np.zeros((len(self.system), 6, 6)), np.zeros((len(self.R), 6))
        cost = add_edges(self.edges, self.block, self.R, self.t, damping, S, g)
        step = self.system.factor(S).solve(-g)
        R = np.ascontiguousarray(self.R @ exp_so3(step[:, :3]))
        self._proposal = R, self.t + np.einsum("nij,nj->ni", self.R, step[:, 3:])
        return cost, evaluate_edges(self.edges, *self._proposal, *self._scratch)

    def accept(self) -> None:
        self.R, self.t = self._proposal
