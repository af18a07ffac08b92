"""The report's charts: trajectory, overlap matrix, overlap graph, numbers per frame, residuals of the edges."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np

from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.report.images import data_uri, png
from miniloop_cli.report.svg import MOST_DOTS, Chart, limits, spread, tenths
from miniloop_cli.results.columns import Edges, Frames, ReportData
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Bools, Ints

# Columns of the horizontal and vertical axis and the sign of the latter: z is up in a motion-capture world, the
# first camera has y down and z forward.
WORLD_VIEWS = {"Top view (x, y)": (0, 1, 1), "Side view (x, z)": (0, 2, 1)}
CAMERA_VIEWS = {"Top view (x right, z forward)": (0, 2, 1), "Side view (z forward, y up)": (2, 1, -1)}
MATRIX_PX = 800
MOST_CHORDS = 6000
KINDS = {"cycle7": 7, "cycle6": 6, "cycle5": 5, "cycle4": 4, "cycle3": 3, "pairwise": 2}
KINDS |= {"planar4": 4, "planar3": 3, "planar2": 2, "guided": 1}


def named(solver: str) -> str:
    """A solver for readers: "5-cycle", "pair"; unknown names are unchanged."""
    scans = KINDS.get(solver)
    if scans is None or scans == 1:
        return solver or "unknown"
    return ("pair" if scans == 2 else f"{scans}-cycle") + (", known vertical" if solver.startswith("planar") else "")


def frame_numbers(frames: Frames, trajectory: Trajectory) -> Ints:
    """(n,) number of the frame of every pose, by the nearest stamp."""
    from miniloop_cli.scene.interpolation import nearest

    return nearest(frames.timestamp_s, trajectory.timestamps_s)


def trajectory_charts(data: ReportData, trajectory: Trajectory, evaluation: Evaluation | None) -> list[Chart]:
    """Top and side view; with a ground truth in its world, over the true path."""
    if evaluation:
        positions, truth, views = evaluation.T_aligned[:, :3, 3], evaluation.T_true[:, :3, 3], WORLD_VIEWS
        shown = Trajectory(evaluation.timestamps_s, evaluation.T_aligned)
        notes = [f", off by {100 * e:.1f} cm" for e in evaluation.position_errors_m]
    else:
        positions, truth, views = trajectory.T_world_cam[:, :3, 3], np.empty((0, 3)), CAMERA_VIEWS
        shown, notes = trajectory, [""] * len(trajectory.timestamps_s)
    numbers = frame_numbers(data.frames, shown)
    tips = [f"frame {k}, {t:.3f} s{note}" for k, t, note in zip(numbers, shown.timestamps_s, notes, strict=True)]
    charts = []
    for title, (a, b, sign) in views.items():
        spans = limits(positions[:, a], truth[:, a]), limits(sign * positions[:, b], sign * truth[:, b])
        chart = Chart(title, *spans, "m", "m", equal=True)
        chart.line(truth[:, a], sign * truth[:, b], "truth")
        chart.line(positions[:, a], sign * positions[:, b], "estimate")
        chart.dots(positions[:, a], sign * positions[:, b], "pose", tips)
        chart.dots(positions[:1, a], sign * positions[:1, b], "first", ["first frame"], 6)
        charts.append(chart)
    return charts


def overlap_matrix(edges: Edges, n: int) -> Chart:
    """Frames against frames: matches below the diagonal, verified inliers above it, rejected pairs red."""
    block = max(1, -(-n // MATRIX_PX))
    size = -(-n // block)
    strength, rejected = np.zeros((size, size)), np.zeros((size, size), bool)
    i, j = edges.i // block, edges.j // block
    np.maximum.at(strength, (j, i), np.nan_to_num(edges.matches))
    kept = ~edges.rejected
    np.maximum.at(strength, (i[kept], j[kept]), np.nan_to_num(edges.inliers[kept]))
    rejected[i[~kept], j[~kept]] = True
    level = np.log1p(strength) / max(np.log1p(strength.max(initial=0)), 1.0)
    colors = cv2.applyColorMap(np.rint(255 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    colors[strength == 0] = 255
    colors[rejected & (strength == 0)] = (244, 200, 192)
    chart = Chart(
        "Overlap matrix", (-0.5, n - 0.5), (-0.5, n - 0.5), "frame", "frame", equal=True, down=True, height=460
    )
    end = size * block - 0.5
    chart.image(data_uri(png(colors), "png"), (-0.5, end), (-0.5, end))
    return chart


@dataclass(frozen=True)
class Graph:
    """Frames around a circle and chords between them, in pixels of a square picture, for `templates/graph.svg`."""

    size: int
    chords: list[tuple[int, str]]  # colour number of a solver, path of all its chords
    opacity: float
    nodes: list[tuple[float, float, bool, str]]  # x, y, whether the frame has a pose, tooltip
    node_radius: int
    labels: list[tuple[int, int, int]]  # x, y, frame


def overlap_graph(edges: Edges, n: int, registered: Bools) -> Graph:
    """Frames, registered (n,) or not, around a circle; edges as chords in the colour of what solved them."""
    size, radius = 460, 200
    angle = 2 * np.pi * np.arange(n) / max(n, 1)
    right, up = np.sin(angle), np.cos(angle)
    x, y = size / 2 + radius * right, size / 2 - radius * up
    inside = np.flatnonzero((edges.i < n) & (edges.j < n) & edges.verified)
    if len(inside) > MOST_CHORDS:
        inside = inside[np.linspace(0, len(inside) - 1, MOST_CHORDS).astype(int)]
    chords: dict[str, list[str]] = {}
    for k in inside:
        a, b = edges.i[k], edges.j[k]
        # Curved towards the centre, so that chords of neighbours are visible.
        bend = f"{(x[a] + x[b] + size) / 4:.0f} {(y[a] + y[b] + size) / 4:.0f}"
        chords.setdefault(edges.solver[k], []).append(f"M{x[a]:.0f} {y[a]:.0f}Q{bend} {x[b]:.0f} {y[b]:.0f}")
    order = sorted(chords, key=lambda name: (KINDS.get(name, 0), name))
    tips = [f"frame {k}" if known else f"frame {k}, not registered" for k, known in enumerate(registered)]
    step = max(1, round(n / 12 / 5) * 5) if n > 12 else 1
    kinds = np.flatnonzero(registered), np.flatnonzero(~registered)
    shown = np.sort(np.concatenate([kind[spread(len(kind), MOST_DOTS)] for kind in kinds]))
    return Graph(
        size=size,
        chords=[(KINDS.get(name, 0), "".join(chords[name])) for name in order],
        opacity=round(float(np.clip(300 / max(len(inside), 1), 0.3, 0.8)), 2),
        nodes=[(*tenths([x[k], y[k]]), bool(registered[k]), tips[k]) for k in shown.tolist()],
        node_radius=2 if n > 60 else 4,
        labels=[
            (round(size / 2 + 1.08 * radius * right[k]), round(size / 2 - 1.08 * radius * up[k] + 4), k)
            for k in range(0, n, step)
            if n - k >= step / 2
        ],
    )


def cycle_counts(edges: Edges) -> list[tuple[str, int, int]]:
    """(solver, colour number, verified edges), the longest cycles first."""
    counts = Counter(name for name, kept in zip(edges.solver, edges.verified, strict=True) if kept)
    return sorted(((name, KINDS.get(name, 0), count) for name, count in counts.items()), key=lambda row: -row[1])


def frame_charts(frames: Frames) -> list[Chart]:
    """Features and depth over the frames, those without a pose marked."""
    x = np.arange(len(frames), dtype=float)
    series = {
        "Features": ("count", {"keypoints": frames.keypoints, "with depth": frames.with_depth}),
        "Pixels with depth": ("%", {"": 100 * frames.depth_valid_share}),
        "Median depth": ("m", {"": frames.median_depth_m}),
        "Uncertainty of the position (1 sigma)": ("cm", {"": 100 * frames.sigma_trans_m}),
        "Uncertainty of the rotation (1 sigma)": ("deg", {"": frames.sigma_rot_deg}),
    }
    charts = []
    for title, (unit, lines) in series.items():
        values = list(lines.values())
        if not any(np.isfinite(v).any() for v in values):
            continue
        names = " and ".join(name for name in lines if name)
        chart = Chart(
            f"{title}: {names}" if names else title, limits(x), (0, limits(*values)[1]), "frame", unit, height=230
        )
        for number, v in enumerate(values):
            chart.line(x, v, f"series{number}")
        tips = [f"frame {k}: {v:.4g} {unit}" for k, v in enumerate(values[0])]
        for ok, css in ((True, "pose"), (False, "lost")):
            rows = np.flatnonzero(frames.registered == ok)
            chart.dots(x[rows], values[0][rows], css, [tips[k] for k in rows], 2 if ok else 3.5)
        charts.append(chart)
    return charts


def residual_chart(edges: Edges) -> Chart | None:
    """Residual of every verified edge, rotation against translation; None if there is none."""
    kept = edges.worst_first
    if not len(kept):
        return None
    cm, deg = 100 * edges.trans_m[kept], edges.rot_deg[kept]
    chart = Chart("Residuals of the edges", (0, limits(cm)[1]), (0, limits(deg)[1]), "cm", "deg")
    tips = [f"{edges.i[k]}–{edges.j[k]}, {edges.inliers[k]:.0f} inliers" for k in kept]
    chart.dots(cm, deg, "residual", tips, 2)
    return chart
