"""What the certificate takes on view graphs with known poses."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.experiments.view_graphs import ViewGraph
from miniloop_cli.averaging.optimum import prove_optimum
from miniloop_cli.bench import Row
from miniloop_cli.config import Averaging
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Floats

NOT_PROVEN: Row = {"proof_edges": None, "proof_cpu_seconds": None, "certified": None, "relative_gap": None}


def certificate_row(graph: ViewGraph, T_world_cam: Floats, noise_deg: float, noise_m: float) -> Row:
    """CPU seconds of the certificate of averaged poses (n, 4, 4), and what it says.

    Its edges are the true ones, as the pipeline rejects false edges before; their information is that of the noise.
    """
    sigma = np.repeat([np.radians(noise_deg), noise_m], 3)
    information = np.diag(1 / np.maximum(sigma, 1e-6) ** 2)
    none, inlier = np.zeros((0, 2), np.int64), np.zeros(0, bool)
    true = np.flatnonzero(~graph.false)
    edges = EdgeTable.of([
        Edge(int(i), int(j), none, inlier, graph.T_j_i[e], information, verdict=Verdict.VERIFIED)
        for e, (i, j) in zip(true, graph.pairs[true], strict=True)
    ])  # fmt: skip
    label = components(len(T_world_cam), graph.pairs[true])
    component = np.where(np.bincount(label)[label] > 1, label, -1)
    before = time.process_time()
    _, proof = prove_optimum(Poses(T_world_cam, component), edges, Averaging())
    seconds = time.process_time() - before
    found = {"certified": proof.certified, "relative_gap": None if proof.problem else proof.relative_gap}
    return {"proof_edges": len(true), "proof_cpu_seconds": seconds} | found
