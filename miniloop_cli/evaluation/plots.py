"""Figures of a trajectory and of its errors (matplotlib, no display needed)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.typing import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRUTH, ESTIMATE = "#8a8f98", "#1f5fbf"
# Column of the horizontal and of the vertical axis of each view, and the sign of the latter.
WORLD_VIEWS = {"top (x, y)": (0, 1, 1), "side (x, z)": (0, 2, 1)}  # z up, as in motion capture
CAMERA_VIEWS = {"top (x, z)": (0, 2, 1), "side (z, -y)": (2, 1, -1)}  # the first camera's axes: y down, z forward


def write_plots(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write trajectory.png (top and side view with the ground truth) and errors.png (over time) into `folder`."""
    rmse_cm = 100 * evaluation.numbers["ate_rmse_m"]
    truth, errors = evaluation.T_true[:, :3, 3], evaluation.position_errors_m
    views = trajectory_figure(evaluation.T_aligned[:, :3, 3], truth, errors, f"ATE {rmse_cm:.2f} cm RMSE")
    return [save(views, folder / "trajectory.png"), save(error_figure(evaluation), folder / "errors.png")]


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, without a date, so that two runs give the same bytes."""
    with atomic_write(path, "wb") as file:
        figure.savefig(file, format="png", dpi=130, metadata={"Software": None})
    return path


def trajectory_figure(
    positions_m: Floats,
    truth_m: Floats | None = None,
    errors_m: Floats | None = None,
    title: str = "",
) -> Figure:
    """Top and side view of (n, 3) positions, over the (n, 3) true ones, coloured by (n,) errors.

    With a ground truth the axes are those of its world (z up); without, those of the first camera.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.6), layout="constrained")
    views = WORLD_VIEWS if truth_m is not None else CAMERA_VIEWS
    axes = figure.subplots(1, 2)
    for ax, (name, (u, v, sign)) in zip(axes, views.items(), strict=True):
        if truth_m is not None:
            ax.plot(truth_m[:, u], sign * truth_m[:, v], color=TRUTH, lw=2.5, label="ground truth")
        ax.plot(positions_m[:, u], sign * positions_m[:, v], color=ESTIMATE, lw=1, label="estimate")
        if errors_m is None:
            ax.plot(positions_m[:, u], sign * positions_m[:, v], ".", color=ESTIMATE, ms=3)
        else:
            dots = ax.scatter(
                positions_m[:, u], sign * positions_m[:, v], c=100 * errors_m, s=14, cmap="plasma", zorder=3
            )
        ax.plot(positions_m[0, u], sign * positions_m[0, v], "o", mfc="none", mec="black", ms=9, label="first frame")
        finish(ax, name)
    axes[0].legend(loc="best", fontsize=8, frameon=False)
    if errors_m is not None:
        figure.colorbar(dots, ax=axes, label="position error (cm)", shrink=0.85)
    if title:
        figure.suptitle(title)
    return figure


def finish(ax: Axes, title: str) -> None:
    """Equal scales, metres, a light grid."""
    ax.set_title(title, fontsize=10)
    ax.set_xlabel("m")
    ax.set_ylabel("m")
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(alpha=0.3, lw=0.5)


def error_figure(evaluation: Evaluation) -> Figure:
    """Position and rotation error of every pose over time, with the RMSE; rotations after the same alignment."""
    from matplotlib.figure import Figure

    from miniloop_cli.geometry import se3

    R_error = np.swapaxes(evaluation.T_true[:, :3, :3], 1, 2) @ evaluation.T_aligned[:, :3, :3]
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    seconds = evaluation.timestamps_s - evaluation.timestamps_s[0]
    series = {"position (cm)": 100 * evaluation.position_errors_m, "rotation (deg)": se3.rotation_angle_deg(R_error)}
    for ax, (name, values) in zip(figure.subplots(2, 1, sharex=True), series.items(), strict=True):
        rmse = float(np.sqrt((values**2).mean()))
        ax.plot(seconds, values, ".-", color=ESTIMATE, lw=1, ms=4)
        ax.axhline(rmse, color=TRUTH, lw=1, ls="--", label=f"RMSE {rmse:.2f}")
        ax.set_ylabel(name)
        ax.set_ylim(bottom=0)
        ax.legend(loc="upper right", fontsize=8, frameon=False)
        ax.grid(alpha=0.3, lw=0.5)
    figure.axes[-1].set_xlabel("seconds")
    protocol = evaluation.numbers["protocol"]
    figure.suptitle(f"errors after {protocol['alignment']} alignment on positions ({protocol['association']})")
    return figure
