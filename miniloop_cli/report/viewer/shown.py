"""The content of `miniloop view`: a result with its model, or a model alone."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from miniloop_cli.errors import InputError
from miniloop_cli.report.templating import asset, render
from miniloop_cli.report.truth import against_truth
from miniloop_cli.report.viewer.frame_images import FrameImages, RecordingImages
from miniloop_cli.report.viewer.map_scene import MapData, map_cloud, map_scene
from miniloop_cli.report.viewer.models import Glb, Tiled, read_model, tiled
from miniloop_cli.report.viewer.scene import scene
from miniloop_cli.results.columns import ReportData
from miniloop_cli.version import __version__

UP = {"x": [1, 0, 0], "-x": [-1, 0, 0], "y": [0, 1, 0], "-y": [0, -1, 0], "z": [0, 0, 1], "-z": [0, 0, -1]}
KIND = {"js": "text/javascript", "css": "text/css", "json": "application/json", "jpg": "image/jpeg"}
MOST_POINTS_AT_ONCE = 5_000_000

Answer = tuple[str, bytes]  # media type and content


@dataclass(frozen=True)
class Shown:
    """All content that a page requests, by path. `values`: the scene."""

    values: dict[str, Any]
    model: Tiled | Glb | None
    images: FrameImages = field(default_factory=FrameImages)

    def answer(self, path: str) -> Answer | None:
        """Media type and content of a path below the page's own; None if it does not exist."""
        name, _, rest = path.partition("/")
        if path == "":
            return "text/html", render("served.html", name=self.values["name"], version=__version__).encode(
                "utf-8", "backslashreplace"
            )
        if path == "viewer.js":
            return KIND["js"], asset("viewer/assets/viewer.js").encode()
        if path == "viewer.css":
            return KIND["css"], (asset("page.css") + asset("viewer/assets/viewer.css")).encode()
        if path == "scene.json":
            return KIND["json"], json.dumps(self.values, allow_nan=False).encode()
        if path == "model.json":
            return KIND["json"], json.dumps(self.model.values if self.model else None, allow_nan=False).encode()
        if path == "model.glb" and isinstance(self.model, Glb):
            return "model/gltf-binary", self.model.file
        if name == "points" and isinstance(self.model, Tiled):
            return self._points(rest, self.model)
        if name == "frame":
            return self._frame(rest)
        return None

    def _points(self, words: str, model: Tiled) -> Answer | None:
        ends = words.split("-")
        if len(ends) != 2 or not all(end.isascii() and end.isdigit() and len(end) < 12 for end in ends):
            return None
        begin, end = map(int, ends)
        if not begin < end <= min(len(model.levels), begin + MOST_POINTS_AT_ONCE):
            return None
        return "application/octet-stream", model.points(begin, end)

    def _frame(self, words: str) -> Answer | None:
        number = words.removesuffix(".jpg")
        if not (number.isascii() and number.isdigit() and len(number) < 10):
            return None
        found = self.images.jpeg(int(number))
        return (KIND["jpg"], found) if found else None


def show_result(data: ReportData, model_path: Path | None = None) -> Shown:
    """A result with its cloud, or with the PLY model at `model_path` in the same world.

    Raises InputError for a result without frames and for a model that cannot be read.
    """
    if not len(data.frames):
        raise InputError(f"{data.results.root} holds no frames: give the folder that `miniloop register` wrote")
    trajectory = data.results.trajectory if (data.results.root / "trajectory.txt").is_file() else None
    images = FrameImages((RecordingImages.of(data),))
    values = scene(data, against_truth(data, trajectory)) | {"images": images.any}
    path = model_path or data.results.root / "cloud.ply"
    return Shown(values, read_model(path) if path.is_file() else None, images)


def show_map(data: MapData, result: Path) -> Shown:
    """A map of several recordings with their common model. Raises InputError for a damaged file."""
    images = FrameImages(tuple(RecordingImages.of(run) for run in data.runs))
    points, colors = map_cloud(data, result)
    model = tiled(points, colors) if len(points) else None
    return Shown(map_scene(data) | {"images": images.any}, model, images)


def show_model(path: Path, up: str | None) -> Shown:
    """A model alone. `up`: a key of UP; by default y in GLB files, as in their standard, and z in others."""
    model = read_model(path)
    direction = UP[up or ("y" if path.suffix.lower() == ".glb" else "z")]
    return Shown(nothing_but_a_model(path.name, direction), model)


def nothing_but_a_model(name: str, up: list[int]) -> dict[str, Any]:
    """The scene of a model without frames."""
    frames = "seconds stamp pose piece status reason found_by keypoints sigma_m sigma_deg error_m speed ellipsoid"
    edges = "i j solvers solver_words solver verdict rejection reason cycle matches inliers deg m drawn"
    return {
        "name": name,
        "up": up,
        "camera": None,
        "frames": {column: [] for column in frames.split()},
        "edges": {column: [] for column in edges.split()}
        | {"verdicts": ["verified", "weak", "rejected"], "left_out": 0, "packed": ""},
        "truth": None,
        "images": False,
    }
