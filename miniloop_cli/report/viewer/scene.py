"""The 3D view of a result as plain values for JSON: frames, edges, ground truth, upward direction."""

from __future__ import annotations

from typing import Any

import numpy as np

from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.upward import up_direction
from miniloop_cli.report.charts import named
from miniloop_cli.report.viewer import packing
from miniloop_cli.report.viewer.matches import drawn_matches
from miniloop_cli.report.viewer.placed import Placed, place
from miniloop_cli.results.columns import Edges, ReportData
from miniloop_cli.results.folder import LARGEST
from miniloop_cli.scene.interpolation import nearest
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.typing import Bools, Floats, Ints

MOST_EDGES = 20_000  # verified and weak ones first; the rest is in edges.csv

Values = dict[str, Any]


def scene(data: ReportData, evaluation: Evaluation | None) -> Values:
    """All values except points and images. Lengths in m, angles in deg, times in s; null for unknown values."""
    leveled = data.results.leveled
    placed = place(data, leveled)
    main = placed.T_world_cam[placed.piece == 0]
    return {
        "name": data.name,
        "up": rounded(up_direction(main if len(main) else _known(placed), leveled), 6),
        "camera": _camera(data),
        "frames": frame_values(data, placed, evaluation),
        "edges": edge_values(data, placed.piece >= 0),
        "truth": truth_values(data, placed, evaluation),
    }


def _known(placed: Placed) -> Floats:
    return placed.T_world_cam[placed.piece >= 0]


def _camera(data: ReportData) -> Values | None:
    """Half the opening of the image at distance 1, for the frusta."""
    camera = data.sequence.camera if data.sequence else data.results.camera
    if camera is None:
        return None
    return {
        "left": round(camera.cx / camera.fx, 4),
        "right": round((camera.width - 1 - camera.cx) / camera.fx, 4),
        "top": round(camera.cy / camera.fy, 4),
        "bottom": round((camera.height - 1 - camera.cy) / camera.fy, 4),
        "width": camera.width,
        "height": camera.height,
    }


def frame_values(data: ReportData, placed: Placed, evaluation: Evaluation | None) -> Values:
    """Columns, one entry a frame; `pose` is x y z qx qy qz qw, camera to world."""
    frames, known = data.frames, placed.piece >= 0
    rows = np.full((len(frames), 7), np.nan)
    rows[known] = se3.to_rows(placed.T_world_cam[known])
    return {
        "seconds": rounded(frames.timestamp_s - frames.timestamp_s[0] if len(frames) else np.zeros(0), 4),
        "stamp": [f"{stamp:.6f}" for stamp in frames.timestamp_s],
        "pose": [rounded(row, 6) if ok else None for row, ok in zip(rows, known, strict=True)],
        "piece": placed.piece.tolist(),
        "status": frames.status,
        "reason": frames.reason,
        "found_by": frames.found_by,
        "keypoints": rounded(frames.keypoints, 0),
        "sigma_m": rounded(frames.sigma_trans_m, 6),
        "sigma_deg": rounded(frames.sigma_rot_deg, 5),
        "error_m": rounded(_errors_m(data, evaluation), 6),
        "speed": rounded(speeds(frames.timestamp_s, rows[:, :3], placed.piece), 4),
        "ellipsoid": ellipsoids(data.covariance, placed.T_world_cam),
    }


def speeds(stamps_s: Floats, positions_m: Floats, piece: Ints) -> Floats:
    """(n,) metres a second from the frame before to the one after, if both have poses of the same piece.

    stamps_s (n,), positions_m (n, 3), piece (n,), -1: no pose.
    """
    speed, own = np.full(len(stamps_s), np.nan), np.flatnonzero(piece >= 0)
    for number in set(piece[own].tolist()):
        rows = own[piece[own] == number]
        if len(rows) > 1:
            at = np.arange(len(rows))
            before, after = rows[np.maximum(at - 1, 0)], rows[np.minimum(at + 1, len(rows) - 1)]
            moved = np.linalg.norm(positions_m[after] - positions_m[before], axis=1)
            speed[rows] = moved / np.maximum(stamps_s[after] - stamps_s[before], 1e-9)
    return speed


def ellipsoids(covariance: Floats | None, T_world_cam: Floats) -> list[list[float] | None]:
    """For each frame: standard deviations (m) along the axes of the position's ellipsoid, and the axes as x y z w.

    `covariance` (n, 6, 6) is of (w, v) in T_world_cam [exp(w) | v], so that the position moves by R v.
    """
    if covariance is None:
        return [None] * len(T_world_cam)
    R = T_world_cam[:, :3, :3]
    world = R @ covariance[:, 3:, 3:] @ np.swapaxes(R, 1, 2)
    known = (np.abs(world) < LARGEST).all(axis=(1, 2))  # NaN compares false
    values, axes = np.linalg.eigh(world[known])
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    rows = np.concatenate([np.sqrt(np.maximum(values, 0)), se3.quaternions(axes)], axis=1)
    found: list[list[float] | None] = [None] * len(T_world_cam)
    for k, row in zip(np.flatnonzero(known).tolist(), rows, strict=True):
        found[k] = [*rounded(row[:3], 7), *rounded(row[3:], 5)]
    return found


def _errors_m(data: ReportData, evaluation: Evaluation | None) -> Floats:
    errors = np.full(len(data.frames), np.nan)
    if evaluation:
        errors[nearest(data.frames.timestamp_s, evaluation.timestamps_s)] = evaluation.position_errors_m
    return errors


def truth_values(data: ReportData, placed: Placed, evaluation: Evaluation | None) -> list[list[float] | None] | None:
    """True positions by frame, moved into the world of the result; None without ground truth."""
    if evaluation is None:
        return None
    rows = nearest(data.frames.timestamp_s, evaluation.timestamps_s)
    T = placed.T_world_cam[rows[0]]
    # All aligned poses are moved by the same rigid motion, and perhaps scaled, so the first one determines it.
    R = evaluation.T_aligned[0, :3, :3] @ T[:3, :3].T
    scale = float(evaluation.numbers["scale"])
    shift = evaluation.T_aligned[0, :3, 3] - scale * R @ T[:3, 3]
    positions = (evaluation.T_true[:, :3, 3] - shift) @ R / scale
    found: list[list[float] | None] = [None] * len(data.frames)
    for row, position in zip(rows.tolist(), positions, strict=True):
        found[row] = rounded(position, 5)
    return found


def edge_values(data: ReportData, posed: Bools) -> Values:
    """Columns with an entry for each edge shown; posed (n,) marks the frames with a pose. Texts are numbered.

    `drawn`: how many of the matches in `packed` are of each edge.
    """
    edges = data.edges
    rows = chosen(edges)
    drawn, packed = drawn_matches(data, rows)
    solvers, verdicts = sorted(set(edges.solver)), [verdict.label for verdict in Verdict]
    return {
        "i": edges.i[rows].tolist(),
        "j": edges.j[rows].tolist(),
        "solvers": solvers,
        "solver_words": [named(name) for name in solvers],
        "solver": [solvers.index(edges.solver[k]) for k in rows],
        "verdicts": verdicts,
        "verdict": [verdicts.index(v) if (v := edges.verdict[k]) in verdicts else 0 for k in rows],
        "rejection": [edges.rejection[k] for k in rows],
        "reason": [edges.reason[k] for k in rows],
        "cycle": [edges.cycle[k] if edges.cycle[k] != "-1" else "" for k in rows],
        "matches": rounded(edges.matches[rows], 0),
        "inliers": rounded(edges.inliers[rows], 0),
        "deg": rounded(edges.rot_deg[rows], 3),
        "m": rounded(edges.trans_m[rows], 5),
        "drawn": drawn.tolist(),
        "packed": packing.text(packed),
        "left_out": len(edges) - len(rows),
    }


def chosen(edges: Edges) -> Ints:
    """Rows (k,) of the edges shown: verified, then weak, then rejected, each by falling residual."""
    order = edges.by_residual
    rank = np.where(edges.verified, 0, np.where(edges.rejected, 2, 1))[order]
    return order[np.argsort(rank, kind="stable")][:MOST_EDGES]


def rounded(values: Floats, digits: int) -> list[Any]:
    """The values (n,) as numbers for JSON; None for what is not finite."""
    known = zip(np.asarray(values, float).tolist(), np.isfinite(values), strict=True)
    if digits == 0:
        return [round(value) if ok else None for value, ok in known]
    return [round(value, digits) if ok else None for value, ok in known]
