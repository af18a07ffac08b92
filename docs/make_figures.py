"""Makes the pictures of the documentation with the program itself: `python docs/make_figures.py [NAME...]`.

The rooms are simulated. The pictures of a desk need MINILOOP_TUM, a folder that holds freiburg1_desk_100 (see
scripts/fetch_tum.sh), and the mesh open3d; screenshots of reports need chromium. What is not there is left out.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure

from miniloop_cli.api import evaluate, register, simulate
from miniloop_cli.datasets import open_sequence
from miniloop_cli.evaluation.plots import save
from miniloop_cli.export.mesh import fuse
from miniloop_cli.export.model import Model
from miniloop_cli.geometry import se3
from miniloop_cli.report import charts, templating
from miniloop_cli.report.images import match_picture
from miniloop_cli.report.splat import overview, render
from miniloop_cli.results.columns import load
from miniloop_cli.results.folder import Results
from miniloop_cli.scene.registration import RegistrationError

IMG = Path(__file__).with_name("img")
WORK = Path(tempfile.gettempdir()) / "miniloop-figures"
BLUE, ORANGE, GREY = "#1f5fbf", "#e08e0b", "#8a8f98"


def write_image(name: str, rgb: np.ndarray, width: int = 960) -> None:
    """A picture as JPEG, at most `width` pixels wide."""
    height = round(rgb.shape[0] * width / rgb.shape[1])
    if rgb.shape[1] > width:
        rgb = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(IMG / name), np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 85])


def room(**changes: Any) -> tuple[Path, Path]:
    """A simulated recording and its result, made once."""
    name = str(changes.get("scene", "room"))
    recording, result = WORK / name, WORK / "results" / name
    if not (result / "report.html").is_file():
        simulate(recording, overwrite=True, **changes)
        try:
            register(recording, result)
        except RegistrationError as error:
            print(error)
    return recording, result


def hinge() -> None:
    """Two matches of an edge leave one turn about the line through them."""
    rng = np.random.default_rng(4)
    axis = np.array([[0.0, 0.0, -0.7], [0.0, 0.0, 0.7]])
    scan = rng.uniform((0.25, -0.5, -0.6), (0.9, 0.5, 0.6), (14, 3))
    scan[0] = 0.75, 0.1, 0.25
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    ax = figure.add_subplot(projection="3d")
    ax.plot(*(1.5 * axis).T, color="black", lw=1)
    ax.plot(*axis.T, "o", color="black", ms=8, label="two matches: the hinge")
    for degrees, alpha in ((0, 1.0), (40, 0.25), (80, 0.25), (120, 0.25)):
        turned = scan @ se3.exp_so3(np.radians([0, 0, degrees])).T
        ax.plot(
            *turned.T, ".", color=BLUE, alpha=alpha, ms=7, label=None if degrees else "the other scan, one angle free"
        )
    circle = np.array([se3.exp_so3(np.array([0, 0, t])) @ scan[0] for t in np.linspace(0, 2 * np.pi, 100)])
    ax.plot(*circle.T, color=ORANGE, lw=1.5, label="where a third match can go")
    ax.plot(*scan[:1].T, "o", color=ORANGE, ms=9)
    ax.set_axis_off()
    ax.set_box_aspect((1, 1, 1), zoom=1.5)
    ax.view_init(22, -60)
    ax.legend(loc="upper left", fontsize=9, frameon=False)
    save(figure, IMG / "hinge.png")


def matches() -> None:
    """The inlier matches of an ordinary edge, as the report draws them."""
    recording, result = room(frames=30)
    data, sequence = load(result), open_sequence(recording)
    kept = data.edges.worst_first
    edge = int(kept[len(kept) // 2])
    picture = match_picture(sequence, int(data.edges.i[edge]), int(data.edges.j[edge]), *data.inlier_px[edge])
    assert picture is not None  # the images were written a moment ago
    write_image("matches.jpg", picture)


def overlap() -> None:
    """Overlap matrix and graph, as pictures of their own."""
    _, result = room(frames=30)
    data = load(result)
    style = files("miniloop_cli.report").joinpath("page.css").read_text(encoding="utf-8")
    n = len(data.frames)
    for name, svg in (
        ("overlap-matrix", templating.render("chart.svg", chart=charts.overlap_matrix(data.edges, n))),
        (
            "overlap-graph",
            templating.render("graph.svg", graph=charts.overlap_graph(data.edges, n, data.frames.registered)),
        ),
    ):
        head = '<svg xmlns="http://www.w3.org/2000/svg" width="460" height="460" '
        alone = svg.replace("<svg ", head, 1).replace(">", f"><style>{style}</style>", 1)
        (IMG / f"{name}.svg").write_text(alone + "\n", encoding="utf-8")


def stages() -> None:
    """The position error of every frame after averaging, after the pose graph and after bundle adjustment."""
    recording, _ = room(frames=30)
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    ax = figure.subplots()
    for color, refine, title in (
        (GREY, "none", "averaging"),
        (ORANGE, "posegraph", "and pose graph"),
        (BLUE, "bundle", "and bundle adjustment"),
    ):
        register(recording, WORK / refine, overrides=[f"refine={refine}"])
        found = evaluate(WORK / refine, recording)
        rmse_cm = 100 * found.numbers["ate_rmse_m"]
        ax.plot(100 * found.position_errors_m, ".-", color=color, lw=1, label=f"{title}: {rmse_cm:.2f} cm RMSE")
    ax.set_xlabel("frame")
    ax.set_ylabel("position error (cm)")
    ax.set_ylim(bottom=0)
    ax.grid(alpha=0.3, lw=0.5)
    ax.legend(fontsize=9, frameon=False)
    save(figure, IMG / "stages.png")


def reports() -> None:
    """The top of a report where it worked, where it worked in part, and where it did not."""
    for name, changes in (
        ("good", {"frames": 30}),
        ("partly", {"frames": 40, "scene": "two-rooms"}),
        ("failed", {"frames": 8, "width": 320, "height": 240, "scene": "textureless"}),
    ):
        screenshot(room(**changes)[1] / "report.html", f"report-{name}.jpg")


def screenshot(page: Path, name: str, size: tuple[int, int] = (1000, 1150)) -> None:
    """The top of a page in a real browser."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        print(f"no chromium: {name} left as it is")
        return
    target = WORK / "screenshot.png"
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--window-size={size[0]},{size[1]}"]
    # Time for the 3D view, which is drawn without a graphics card.
    flags += ["--virtual-time-budget=60000", "--enable-unsafe-swiftshader"]
    flags += ["--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"]
    flags += [f"--user-data-dir={WORK / 'profile'}", f"--screenshot={target}"]
    subprocess.run([browser, *flags, page.as_uri()], check=True, capture_output=True)
    shot = cv2.imread(str(target))
    if shot is None:
        raise SystemExit(f"{browser} left no picture of {page}")
    write_image(name, shot[..., ::-1], size[0])


def desk() -> None:
    """A real recording: its mesh and its report."""
    recording = Path(os.environ.get("MINILOOP_TUM", "")) / "freiburg1_desk_100"
    if not recording.is_dir():
        print("MINILOOP_TUM is not set: the pictures of the desk are left as they are")
        return
    result = WORK / "desk"
    register(recording, result)
    screenshot(result / "report.html", "desk-report.jpg")
    model = Model(Results(result), open_sequence(recording))
    surface = fuse(model, voxel_m=0.006, quiet=True)
    view = overview(surface.points, model.trajectory.T_world_cam, 10, 20, (1200, 760))
    write_image("desk-mesh.jpg", render(surface.points, surface.point_colors, view, 0.007))


FIGURES: dict[str, Callable[[], None]] = {
    "hinge": hinge,
    "matches": matches,
    "overlap": overlap,
    "stages": stages,
    "reports": reports,
    "desk": desk,
}

if __name__ == "__main__":
    IMG.mkdir(exist_ok=True)
    for chosen in sys.argv[1:] or FIGURES:
        FIGURES[chosen]()
