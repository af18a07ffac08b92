"""False edges put into the graph of a recording: each on its own, or whole clusters that agree with each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.geometry import se3
from miniloop_cli.graph.visibility import partners
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.registration import RegistrationError
from miniloop_cli.scene.view_graph import components
from miniloop_cli.stages.average import photometric_check
from miniloop_cli.stages.extract import extract
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Bools, Floats, Ints, Pair
from miniloop_cli.verification.photometric_check import PhotometricCheck

KINDS = ("random", "consistent")
TRUE_DEG, TRUE_M = 5.0, 0.10  # an estimate within this of the ground truth is a true edge
KEPT_EDGES = 3  # no scan loses its last true edges to false ones: without them its pose is unknown
FALSE_DEG, FALSE_M = 15.0, 0.30
PATIENCE = 200  # draws in a row that bring no false edge: there are no more to be had
LEAST_SCANS = 10
# All gates open, so that every edge is there which its inliers verify.
UNGATED = (
    "refine=none",
    "averaging.min_photo_consistency=0",
    "averaging.min_bridge_inliers=0",
    "averaging.max_residual_deg=180",
    "averaging.max_residual_m=1000",
)


@dataclass(frozen=True)
class TrueGraph:
    """A recording's true edges with their own estimates; `scans` (k,) they connect, true poses of all (n, 4, 4).

    `photometric`: what the scans show besides their matches.
    """

    name: str
    edges: EdgeTable
    scans: Ints
    T_world_cam: Floats
    photometric: PhotometricCheck

    def motions(self, i: Ints | int, j: Ints | int) -> Floats:
        """True T_j_i (..., 4, 4) of pairs of scans."""
        return _motions(self.T_world_cam, i, j)


def true_graph(folder: Path, max_frames: int | None, seed: int, workers: Workers) -> TrueGraph:
    """The edges that their inliers verify and that agree with the ground truth, of the scans that they connect.

    Raises InputError without ground truth, RegistrationError where fewer than LEAST_SCANS scans hang together.
    """
    sequence, truth = open_with_truth(folder, max_frames)
    settings, store = load_settings("default", UNGATED), Store(default_folder())
    edges = register(sequence, settings, store, workers, seed).edges
    T, known = associate(np.array([frame.timestamp_s for frame in sequence.frames]), truth)
    near = near_to(edges.T_j_i, _motions(T, edges.i, edges.j), TRUE_DEG, TRUE_M)
    edges = edges.subset(edges.verified & known[edges.i] & known[edges.j] & near)
    piece = components(len(sequence.frames), edges.pairs)
    inside = np.flatnonzero(piece == 0)
    if len(inside) < LEAST_SCANS:
        raise RegistrationError(f"{folder}: fewer than {LEAST_SCANS} scans hang together by true edges")
    run = Run(store, workers, seed)
    scans = extract(sequence, settings.features, settings.depth, run)
    shown = photometric_check(scans, settings.ransac, settings.verification.chi2, run)
    # Edges get the matches of others: the rows of those name other features here, and say nothing of outlines.
    outline = [np.zeros(max(map(len, scans.features)), bool)] * len(scans)
    photometric = replace(shown, outline=outline)
    return TrueGraph(sequence.name, edges.subset(piece[edges.i] == 0), inside, T, photometric)


def near_to(T_a: Floats, T_b: Floats, deg: float, metres: float) -> Bools:
    """Whether relative poses (..., 4, 4) differ by less than an angle and a distance."""
    E = se3.inverse(T_b) @ T_a
    return (se3.rotation_angle_deg(E[..., :3, :3]) < deg) & (np.linalg.norm(E[..., :3, 3], axis=-1) < metres)


def _motions(T_world_cam: Floats, i: Ints | int, j: Ints | int) -> Floats:
    return se3.inverse(T_world_cam[j]) @ T_world_cam[i]


def with_false_edges(graph: TrueGraph, kind: str, share: float, rng: np.random.Generator) -> tuple[EdgeTable, Bools]:
    """Edges of which a share is false, sorted by (i, j), and which (m,) those are.

    A false edge is as an estimator would find it: its scans overlap by its relative pose, which is off by more than
    FALSE_DEG or FALSE_M, and its matches, inliers and information are those of some true edge.
    `random`: a pair of scans with the relative pose of another pair. `consistent`: two places taken for one; two runs
    of scans, an eighth to a third of all each, are made to coincide, and pairs of them that then overlap agree in
    it but for the noise of true edges; such clusters follow one another until there are enough false edges.
    A false edge takes the place of the true one of its pair, if there is one. If there are fewer such pairs than
    asked for, the share is less.
    """
    edges = graph.edges
    noise = edges.T_j_i @ se3.inverse(graph.motions(edges.i, edges.j))
    degree = np.bincount(edges.pairs.ravel(), minlength=len(graph.T_world_cam))
    true = {(i, j) for i, j in edges.pairs.tolist()}
    false: dict[Pair, Edge] = {}
    stalled = 0
    while len(false) < share * (len(true) + len(false)) and stalled < PATIENCE:
        before = len(false)
        for (i, j), T_j_i in _cluster(graph, rng) if kind == "consistent" else _lone(graph, rng):
            if len(false) >= share * (len(true) + len(false)):
                break
            replaces = (i, j) in true
            if (i, j) in false or (replaces and min(degree[i], degree[j]) <= KEPT_EDGES):
                continue
            like = int(rng.integers(len(edges)))
            found = noise[like] @ T_j_i
            if near_to(found, graph.motions(i, j), FALSE_DEG, FALSE_M):
                continue
            if replaces:
                true.remove((i, j))
                degree[[i, j]] -= 1
            false[i, j] = replace(edges.edge(like), i=i, j=j, T_j_i=found)
        stalled = stalled + 1 if len(false) == before else 0
    mixed = edges.replaced(list(false.values()))
    return mixed, np.array([(i, j) in false for i, j in mixed.pairs.tolist()])


def _lone(graph: TrueGraph, rng: np.random.Generator) -> list[tuple[Pair, Floats]]:
    """A pair of scans, i < j, and a wrong T_j_i."""
    i, j = sorted(int(scan) for scan in rng.choice(graph.scans, 2, replace=False))
    return [((i, j), _some_motion(graph, rng))]


def _some_motion(graph: TrueGraph, rng: np.random.Generator) -> Floats:
    """T_j_i (4, 4) of a true edge, either way round."""
    like = int(rng.integers(len(graph.edges)))
    T = graph.motions(int(graph.edges.i[like]), int(graph.edges.j[like]))
    return T if rng.random() < 0.5 else se3.inverse(T)


def _cluster(graph: TrueGraph, rng: np.random.Generator) -> list[tuple[Pair, Floats]]:
    """Pairs across two runs of scans that overlap once the second run lies over the first, in random order."""
    count = len(graph.scans)
    sizes = rng.integers(max(count // 8, 2), count // 3 + 1, 2)
    first = int(rng.integers(0, count - sizes.sum() + 1))
    second = int(rng.integers(first + sizes[0], count - sizes[1] + 1))
    a, b = graph.scans[first : first + sizes[0]], graph.scans[second : second + sizes[1]]
    moved = graph.T_world_cam.copy()
    i, j = int(rng.choice(a)), int(rng.choice(b))
    moved[b] = moved[i] @ se3.inverse(_some_motion(graph, rng)) @ se3.inverse(moved[j]) @ moved[b]
    photometric = graph.photometric
    pairs = partners(moved, np.concatenate([a, b]), photometric.points, photometric.camera, count)
    across = [pair for pair in pairs if pair[0] in set(a.tolist()) and pair[1] in set(b.tolist())]
    return [((i, j), _motions(moved, i, j)) for i, j in rng.permutation(np.array(across).reshape(-1, 2)).tolist()]


# Edges to T_world_cam (n, 4, 4), which of the scans have a pose, and the edges as judged (None: they are not judged).
Solution = tuple[Floats, Bools, EdgeTable | None]
Solve = Callable[[TrueGraph, EdgeTable], Solution]
