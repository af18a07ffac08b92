"""Agreement of edges with a known vertical, and a second estimate of weak edges.

With a known vertical, a pair has four degrees of freedom instead of six, and an edge of a cycle needs one match instead
of two (solvers/planar*.py). Fewer matches suffice to find a pose. An accelerometer has an error of about a degree, more
while the hand shakes, so it only guides the search; the pose is then fitted to the matches alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np

from miniloop_cli.config import Estimation, Gravity
from miniloop_cli.errors import InputError
from miniloop_cli.graph.cycles import decompose
from miniloop_cli.graph.overlap import overlap_graph
from miniloop_cli.ransac.cycle_edges import directed, judged_edge, sides, weakest_last
from miniloop_cli.ransac.gravity_aligned import estimate_upright
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.scene.priors import Accelerometer, Vertical
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.typing import Floats

SURE_INLIERS = 20  # an edge with so many, solved without gravity, is used to check the accelerometer
MIN_SURE_EDGES = 3
LONGEST = 4  # scans in a cycle of the known-vertical solvers
MIN_SIGMA_DEG = 1.0  # no accelerometer is better
REJECT_FACTOR = 4.0  # times the disagreement of sure edges: more does not happen by chance
MAX_AXES_RATIO = 0.5  # other axes than the camera's are used if they reduce the disagreement to this share
RIVAL_COSINE = 0.5  # axes whose up directions differ by more would lay the model on its side


def disagreement_deg(edges: EdgeTable, up_cam: Floats) -> Floats:
    """(m,) angle (deg) between the vertical of scan j and that of scan i rotated by the edge; NaN if one is unknown.

    up_cam (n, 3) unit vectors, NaN where there is none.
    """
    turned, up_j = np.einsum("mij,mj->mi", edges.T_j_i[:, :3, :3], up_cam[edges.i]), up_cam[edges.j]
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(turned, up_j), axis=1), (turned * up_j).sum(axis=1)))


def checked(edges: EdgeTable, accelerometer: Accelerometer, settings: Gravity) -> tuple[Vertical | None, str]:
    """The readings in the camera's axes, or None if too few edges can check them; and a note.

    Sensors have their own axes. The camera's axes are used if they agree with the edges that were solved without
    gravity; else those of the 24 rotations between right-handed axes that agree best. Raises InputError if none agrees
    within a median of `max_median_deg`.
    """
    known = np.all(np.isfinite(accelerometer.up), axis=1)
    sure = edges.subset(edges.verified & (edges.inlier_count >= SURE_INLIERS) & known[edges.i] & known[edges.j])
    if len(sure) < MIN_SURE_EDGES:
        return None, f"gravity is not used: {len(sure)} sure edges are too few to check it"
    axes = _axes()
    medians = [float(np.median(disagreement_deg(sure, accelerometer.up @ M.T))) for M in axes]
    best = int(np.argmin(medians))
    if medians[0] <= settings.max_median_deg and max(medians[best], MIN_SIGMA_DEG) > MAX_AXES_RATIO * medians[0]:
        best = 0
    if medians[best] > settings.max_median_deg:
        raise InputError(
            f"{accelerometer.source}: disagrees with {len(sure)} sure edges by {medians[best]:.1f} deg (median) for "
            f"every choice of the sensor's axes (best: {_named(axes[best])}); is it of this recording, on the same "
            "clock? Leave --gravity out, or raise gravity.max_median_deg"
        )
    found = Vertical(accelerometer.turned(axes[best]), max(medians[best], MIN_SIGMA_DEG), axes[best])
    note = (
        f"gravity is used: {medians[best]:.1f} deg from {len(sure)} sure edges (median), "
        f"with the sensor's axes as {_named(axes[best])}"
        f"{_rivals(axes, medians, best, accelerometer.up[known], settings.max_median_deg)}"
    )
    return found, note


def _rivals(axes: Sequence[Floats], medians: Sequence[float], best: int, up: Floats, most_deg: float) -> str:
    """The addition to the note if other axes, with another up direction, agree nearly as well and within most_deg."""
    apart = [np.median((up @ axes[best].T * (up @ M.T)).sum(axis=1)) < RIVAL_COSINE for M in axes]
    limit = min(max(medians[best], MIN_SIGMA_DEG) / MAX_AXES_RATIO, most_deg)
    rivals = [k for k in range(len(axes)) if apart[k] and medians[k] < limit]
    if not rivals:
        return ""
    closest = min(rivals, key=lambda k: medians[k])
    return f" (not certain: {_named(axes[closest])} is {medians[closest]:.1f} deg off)"


def with_gravity(
    edges: EdgeTable,
    vertical: Vertical,
    matches: Matches,
    points: Sequence[ScanPoints],
    estimation: Estimation,
    settings: Gravity,
    seed: int,
    workers: Workers,
) -> EdgeTable:
    """The edges after solving unverified ones again with the known vertical, and judging all by it.

    Edges that contradict it are rejected. Weak edges that agree with it are verified; with `min_bridge_inliers` inliers
    they need no loop of edges to confirm them.
    """
    known = np.all(np.isfinite(vertical.up_cam), axis=1)
    weak = edges.subset(~edges.verified & known[edges.i] & known[edges.j])
    better = {edge.pair: edge for edge in weak.edges()}
    open_edges = {pair: matches[pair] for pair in better}
    for longest in range(min(LONGEST, estimation.cycles.longest), 1, -1):
        cycles = decompose(overlap_graph(len(points), open_edges), longest, estimation.cycles.decomposition)

        def solve(cycle: tuple[int, ...]) -> list[Edge]:
            return _solve(cycle, vertical, matches, points, estimation, seed)

        for found in workers.map(solve, cycles, f"known vertical, {longest} scans", len(cycles)):
            for edge in found:
                if edge.inlier_count > better[edge.pair].inlier_count:
                    better[edge.pair] = edge
        open_edges = {pair: matches[pair] for pair, edge in better.items() if edge.verdict != Verdict.VERIFIED}
    return _judged(edges.replaced(list(better.values())), vertical, settings)


def _judged(edges: EdgeTable, vertical: Vertical, settings: Gravity) -> EdgeTable:
    """Reject edges that contradict the vertical; verify and confirm open ones that agree with it."""
    off_deg = disagreement_deg(edges, vertical.up_cam)
    limit_deg = max(settings.max_deg, REJECT_FACTOR * vertical.sigma_deg)
    agrees = edges.open & (off_deg <= min(settings.agree_deg, limit_deg))  # NaN compares false
    judged = edges.reject(off_deg > limit_deg, Rejection.CONTRADICTS_GRAVITY, off_deg)
    return replace(
        judged,
        verdict=np.where(agrees, Verdict.VERIFIED, judged.verdict),
        rejection=np.where(agrees, Rejection.NONE, judged.rejection),
        loops=np.where(agrees, 0, judged.loops),
        confirmed=np.where(agrees, judged.inlier_count >= settings.min_bridge_inliers, judged.confirmed),
    )


def _solve(
    cycle: tuple[int, ...],
    vertical: Vertical,
    matches: Matches,
    points: Sequence[ScanPoints],
    estimation: Estimation,
    seed: int,
) -> list[Edge]:
    cycle = weakest_last(cycle, matches)
    chain = sides(cycle)
    inputs = [directed(points, pair, matches) for pair in chain]
    rng = np.random.default_rng([seed, len(cycle), *cycle])
    up_cam, sigma_rad = vertical.up_cam[list(cycle)], np.radians(vertical.sigma_deg)
    found = estimate_upright(inputs, up_cam, sigma_rad, estimation.ransac, estimation.verification.chi2, rng)
    if found is None:
        return []
    return [
        judged_edge(pair, estimate, matches, f"planar{len(cycle)}", found.hypotheses, estimation.verification)
        for pair, estimate in zip(chain, found.edges, strict=True)
    ]


def _axes() -> list[Floats]:
    """The 24 rotations that map axes to axes, the identity first."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        M = np.zeros((3, 3))
        M[range(3), order] = signs
        if np.linalg.det(M) > 0:
            found.append(M)
    return found


def _named(M: Floats) -> str:
    """A rotation of axes as "x y z": the sensor's names of the camera's x (right), y (down), z (forward)."""
    names = []
    for row in M:
        k = int(np.abs(row).argmax())
        names.append(("-" if row[k] < 0 else "") + "xyz"[k])
    return " ".join(names)
