"""False edges put into the graph of a recording: each on its own, or whole clusters that agree with each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import networkx as nx
import numpy as np

from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.geometry import se3
from miniloop_cli.graph.visibility import partners
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import VERIFIED, Edge
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.points import scan_points
from miniloop_cli.scene.registration import RegistrationError
from miniloop_cli.typing import Bools, Floats, Ints
from miniloop_cli.verification.photometric_check import PhotometricCheck
from miniloop_cli.verification.repetition import steps_m

KINDS = ("random", "consistent")
TRUE_DEG, TRUE_M = 5.0, 0.10  # an estimate within this of the ground truth is a true edge
KEPT_EDGES = 3  # no scan loses its last true edges to false ones: nobody could place it then
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
    edges: list[Edge]
    scans: Ints
    T_world_cam: Floats
    photometric: PhotometricCheck


def true_graph(folder: Path, max_frames: int | None, seed: int, workers: Workers) -> TrueGraph:
    """The edges that their inliers verify and that agree with the ground truth, of the scans that they connect.

    Raises InputError without ground truth, RegistrationError where fewer than LEAST_SCANS scans hang together.
    """
    sequence, truth = open_with_truth(folder, max_frames)
    run = register(sequence, load_settings("default", UNGATED), Store(default_folder()), workers, seed)
    T, known = associate(np.array([frame.timestamp_s for frame in sequence.frames]), truth)

    def is_true(edge: Edge) -> bool:
        return _near(edge.T_j_i, _motion(T, edge.i, edge.j), TRUE_DEG, TRUE_M)

    edges = [e for e in run.edges if e.verdict == VERIFIED and known[e.i] and known[e.j] and is_true(e)]
    pieces = sorted(nx.connected_components(nx.Graph((e.i, e.j) for e in edges)), key=len)
    if not pieces or len(pieces[-1]) < LEAST_SCANS:
        raise RegistrationError(f"{folder}: fewer than {LEAST_SCANS} scans hang together by true edges")
    features = [scan.features for scan in run.scans]
    points = [scan_points(found, sequence.camera) for found in features]
    steps = steps_m(features, points, sequence.camera.width, load_settings(), workers)
    # Edges get the matches of others: the rows of those name other features here, and say nothing of outlines.
    outline = [np.zeros(max(map(len, features)), bool)] * len(features)
    photometric = PhotometricCheck([scan.view for scan in run.scans], points, outline, steps, sequence.camera)
    inside = [e for e in edges if e.i in pieces[-1]]
    return TrueGraph(sequence.name, inside, np.array(sorted(pieces[-1])), T, photometric)


def _near(T_a: Floats, T_b: Floats, deg: float, metres: float) -> bool:
    """Whether two relative poses (4, 4) differ by less than an angle and a distance."""
    E = se3.inverse(T_b) @ T_a
    return bool(se3.rotation_angle_deg(E[:3, :3]) < deg and np.linalg.norm(E[:3, 3]) < metres)


def _motion(T_world_cam: Floats, i: int, j: int) -> Floats:
    return se3.inverse(T_world_cam[j]) @ T_world_cam[i]


def with_false_edges(graph: TrueGraph, kind: str, share: float, rng: np.random.Generator) -> tuple[list[Edge], Bools]:
    """Edges of which a share is false, sorted by (i, j), and which (m,) those are.

    A false edge is as an estimator would find it: its scans overlap by its relative pose, which is off by more than
    FALSE_DEG or FALSE_M, and its matches, inliers and information are those of some true edge.
    `random`: a pair of scans with the relative pose of another pair. `consistent`: two places taken for one; two runs
    of scans, an eighth to a third of all each, are laid over each other, and pairs of them that then overlap agree in
    it but for the noise of true edges; such clusters follow one another until there are enough false edges.
    A false edge takes the place of the true one of its pair, if there is one. If there are fewer such pairs than
    asked for, the share is less.
    """
    edges = {(e.i, e.j): e for e in graph.edges}
    degree = np.bincount(np.array(list(edges)).ravel(), minlength=len(graph.T_world_cam))
    false: dict[tuple[int, int], Edge] = {}
    stalled = 0
    while len(false) < share * (len(edges) + len(false)) and stalled < PATIENCE:
        before = len(false)
        for i, j, T_j_i in _cluster(graph, rng) if kind == "consistent" else _lone(graph, rng):
            if len(false) >= share * (len(edges) + len(false)):
                break
            replaces = (i, j) in edges
            if (i, j) in false or (replaces and min(degree[i], degree[j]) <= KEPT_EDGES):
                continue
            like = graph.edges[int(rng.integers(len(graph.edges)))]
            noise = like.T_j_i @ se3.inverse(_motion(graph.T_world_cam, like.i, like.j))
            if _near(noise @ T_j_i, _motion(graph.T_world_cam, i, j), FALSE_DEG, FALSE_M):
                continue
            if edges.pop((i, j), None):
                degree[[i, j]] -= 1
            false[i, j] = replace(like, i=i, j=j, T_j_i=noise @ T_j_i)
        stalled = stalled + 1 if len(false) == before else 0
    pairs = sorted({**edges, **false})
    return [false.get(pair) or edges[pair] for pair in pairs], np.array([pair in false for pair in pairs])


def _lone(graph: TrueGraph, rng: np.random.Generator) -> list[tuple[int, int, Floats]]:
    i, j = sorted(int(scan) for scan in rng.choice(graph.scans, 2, replace=False))
    return [(i, j, _some_motion(graph, rng))]


def _some_motion(graph: TrueGraph, rng: np.random.Generator) -> Floats:
    """T_j_i (4, 4) of a true edge, either way round."""
    like = graph.edges[int(rng.integers(len(graph.edges)))]
    T = _motion(graph.T_world_cam, like.i, like.j)
    return T if rng.random() < 0.5 else se3.inverse(T)


def _cluster(graph: TrueGraph, rng: np.random.Generator) -> list[tuple[int, int, Floats]]:
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
    return [(i, j, _motion(moved, i, j)) for i, j in rng.permutation(np.array(across).reshape(-1, 2)).tolist()]


# Edges to T_world_cam (n, 4, 4), which of the scans have a pose, and the edges as judged (None: they are not judged).
Solution = tuple[Floats, Bools, Sequence[Edge] | None]
Solve = Callable[[TrueGraph, Sequence[Edge]], Solution]
