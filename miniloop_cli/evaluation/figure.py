"""One figure of several trajectories for a paper: top view, side view, values over time, histogram."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.plots import CAMERA_VIEWS, TRUTH, WORLD_VIEWS, finish
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.typing import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, distinct for colour-blind readers, darker ones first; lines also differ in their dashes.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
DASHES = ("-", "--", "-.", ":")
FORMATS = ("pdf", "svg", "png")
BINS = 40
DPI = 300
STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "legend.fontsize": 7,
    "lines.linewidth": 1.1,
    "axes.linewidth": 0.6,
    "pdf.fonttype": 42,  # embedded fonts, as journals require
    "svg.hashsalt": "miniloop",  # the same file for the same input
}


@dataclass(frozen=True)
class Line:
    """A trajectory in the figure: (n,) stamps, (n, 3) positions (m), and (k,) values at (k,) stamps."""

    name: str
    stamps_s: Floats
    positions_m: Floats
    value_stamps_s: Floats
    values: Floats


@dataclass(frozen=True)
class Panel:
    """The quantity of the values of all lines: name with unit, and the factor to this unit."""

    words: str
    scale: float


def paper_figure(lines: list[Line], truth_m: Floats | None, panel: Panel, width_in: float = 7.0) -> Figure:
    """Top and side view, values over time and their histogram. `truth_m` (n, 3): the true path, in whose world z is up.

    Without it the axes are those of the first camera (y down, z forward).
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width_in, 0.78 * width_in), layout="constrained")
        (top, side), (time, often) = figure.subplots(2, 2)
        views = WORLD_VIEWS if truth_m is not None else CAMERA_VIEWS
        for ax, (title, (u, v, sign)) in zip((top, side), views.items(), strict=True):
            if truth_m is not None:
                ax.plot(truth_m[:, u], sign * truth_m[:, v], color=TRUTH, lw=2.2, label="ground truth")
            for number, line in enumerate(lines):
                ax.plot(line.positions_m[:, u], sign * line.positions_m[:, v], label=_label(line), **_look(number))
            finish(ax, title)
        _values(time, often, lines, panel)
        if len(lines) > 1 or truth_m is not None:
            figure.legend(*top.get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
        figure.draw_without_rendering()  # with these fonts, not with those at the time of saving
    return figure


def _values(time: Axes, often: Axes, lines: list[Line], panel: Panel) -> None:
    """Values over the seconds since the first pose of all, and their histogram."""
    start_s = min((line.stamps_s[0] for line in lines if len(line.stamps_s)), default=0.0)
    known = [panel.scale * line.values[np.isfinite(line.values)] for line in lines]
    joined = np.concatenate([*known, np.zeros(1)])
    # The largest hundredth is counted in the last bin, so that one bad pose does not hide all others.
    top = max(float(np.quantile(joined, 0.99)) * 1.02, 1e-9)
    edges = np.linspace(0, top, BINS + 1)
    for number, (line, values) in enumerate(zip(lines, known, strict=True)):
        time.plot(line.value_stamps_s - start_s, panel.scale * line.values, **_look(number))
        counts = np.histogram(np.minimum(values, top), edges)[0]
        often.stairs(100 * counts / max(len(values), 1), edges, **_look(number))
    time.set(xlabel="s", ylabel=panel.words)
    time.set_ylim(bottom=0)
    often.set(xlabel=f"{panel.words}, last bin: and more", ylabel="% of the poses", xlim=(0, top))
    for ax in (time, often):
        ax.grid(alpha=0.3, lw=0.5)


def _look(number: int) -> dict[str, Any]:
    return {"color": PALETTE[number % len(PALETTE)], "ls": DASHES[number // len(PALETTE) % len(DASHES) or number % 4]}


def _label(line: Line) -> str:
    """A literal name: a dollar sign would start a formula, a leading underscore would hide it."""
    return f" {line.name}".replace("$", r"\$") if line.name.startswith("_") else line.name.replace("$", r"\$")


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure in the format of its suffix, completely or not at all, with the same bytes each time.

    Raises MiniloopError for a suffix that is not in FORMATS.
    """
    import matplotlib as mpl

    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise MiniloopError(f"{path}: a figure is written as .{', .'.join(FORMATS)}")
    dated = {"pdf": "CreationDate", "svg": "Date", "png": "Software"}[kind]
    with mpl.rc_context(STYLE), atomic_write(path, "wb") as file:
        figure.savefig(file, format=kind, dpi=DPI, metadata={dated: None})
    return path
