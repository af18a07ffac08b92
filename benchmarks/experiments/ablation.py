"""What each step is worth: the same recording registered with one thing changed at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments.feature_store import FeatureStore
from benchmarks.experiments.own_inliers import judged_by_inliers
from miniloop_cli.bench import Row
from miniloop_cli.bench.known_overlaps import right
from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.config import Settings
from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.intrinsics import default_camera
from miniloop_cli.errors import ConfigError
from miniloop_cli.evaluation.evaluate import Protocol, evaluate
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import PINHOLE
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.results.folder import read_edge_list
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.registration import Registration, RegistrationError
from miniloop_cli.scene.sequence import Sequence as Recording
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats, Ints

STAGES = ("matching", "edges", "averaging", "refinement")
PROTOCOL = Protocol(association="nearest")  # as evo and the TUM scripts


@dataclass(frozen=True)
class Variant:
    """One row: changes (`key=value` ...) on top of a preset; `ros_camera`: TUM's ROS default instead of the camera."""

    step: str
    changes: tuple[str, ...] = ()
    preset: str = "default"
    ros_camera: bool = False

    @property
    def settings(self) -> str:
        """How to get it: preset and changes in a line."""
        return " ".join([self.preset, *self.changes, *(["(with TUM's ROS camera)"] if self.ros_camera else [])])


VARIANTS: dict[str, Variant] = {
    "default": Variant(""),
    "ROS camera": Variant("camera", ros_camera=True),
    "sift": Variant("features", ("features.type=sift",)),
    "orb": Variant("features", ("features.type=orb",)),
    "surf": Variant("features", ("features.type=surf",)),
    "half the features": Variant("features", ("features.count=1500", "matching.count=600")),
    "more features": Variant("features", ("features.count=5000", "matching.count=3000")),
    "exhaustive pairs": Variant("matching", ("matching.pairs=exhaustive",)),
    "pairwise only": Variant("cycles", ("cycles.longest=2",)),
    "3-cycles": Variant("cycles", ("cycles.longest=3",)),
    "4-cycles": Variant("cycles", ("cycles.longest=4",)),
    "dfs decomposition": Variant("cycles", ("cycles.decomposition=dfs",)),
    "tight RANSAC (2 cm)": Variant("edges", ("ransac.threshold_m=0.02",)),
    "no local optimization": Variant("edges", ("ransac.local_optimization=false",)),
    "believed unseen": Variant("averaging", ("averaging.min_photo_consistency=0", "averaging.min_bridge_inliers=0")),
    "no second round": Variant("averaging", ("verification.guided_matching=false",)),
    "plain rotations": Variant("averaging", ("averaging.rotations=plain",)),
    "plain translations": Variant("averaging", ("averaging.translations=plain",)),
    "averaging only": Variant("refinement", ("refine=none",)),
    "plain averaging only": Variant(
        "refinement", ("refine=none", "averaging.rotations=plain", "averaging.translations=plain")
    ),
    "pose graph": Variant("refinement", ("refine=posegraph",)),
    "bundle without timing": Variant("refinement", ("bundle.timing=false",)),
    "motion by the path": Variant("refinement", ("bundle.motion=false",)),
    "depth sigma x 1": Variant("refinement", ("bundle.depth_sigma_factor=1",)),
    "depth sigma x 4": Variant("refinement", ("bundle.depth_sigma_factor=4",)),
    "preset fast": Variant("presets", preset="fast"),
    "preset accurate": Variant("presets", preset="accurate"),
    "preset paper": Variant("presets", preset="paper"),
}


def ablation_rows(
    sequences: Sequence[Path],
    only: Sequence[str] = (),
    edge_files: Sequence[Path] = (),
    seed: int = 0,
    workers: Workers | None = None,
) -> Iterator[Row]:
    """Rows of each recording and each of VARIANTS, or `only` of those named; "default" always comes first.

    Edge errors are over a list of edges that all rows of a recording share: that of `edge_files` (one a recording,
    lines "i j"), else the default's verified edges; beside them stand the errors of the edges' own estimates.
    Features are taken from the cache where they are; the seconds are those of all later stages, computed again in every
    run, with everything compiled.
    Raises InputError for a recording without ground truth, ConfigError for an unknown name.
    """
    if unknown := [name for name in only if name not in VARIANTS]:
        raise ConfigError(f"no variant '{unknown[0]}'; known are: {', '.join(VARIANTS)}")
    if edge_files and len(edge_files) != len(sequences):
        raise ConfigError(f"{len(edge_files)} edge lists for {len(sequences)} recordings: give one for each, in order")
    workers = workers or Workers()
    chosen = {name: variant for name, variant in VARIANTS.items() if not only or name in {"default", *only}}
    settings = {name: load_settings(variant.preset, variant.changes) for name, variant in chosen.items()}
    recordings, store = [open_with_truth(folder) for folder in sequences], FeatureStore(default_folder())
    _warm_up(sequences[0], store, workers)
    for k, (recording, truth) in enumerate(recordings):
        stamps = np.array([frame.timestamp_s for frame in recording.frames])
        edges = read_edge_list(edge_files[k], stamps) if edge_files else np.empty((0, 2))
        for name, variant in chosen.items():
            sequence = replace(recording, camera=_ros_camera(recording.camera)) if variant.ros_camera else recording
            if variant.ros_camera and _same(sequence.camera, recording.camera):
                continue
            run, problem = _register(sequence, settings[name], store, workers, seed)
            if not edge_files and name == "default":
                edges = stamps[_verified(run)]
            row: Row = {"sequence": recording.name, "step": variant.step, "variant": name}
            row |= _scores(run, stamps, truth, edges) | _estimates(run, stamps, truth) | _seconds(run)
            yield row | {"settings": variant.settings, "problem": problem}


def _warm_up(folder: Path, store: Store, workers: Workers) -> None:
    """Compile, or load what is compiled, on a few frames."""
    few = open_sequence(folder, max_frames=8)
    for name in ("default", "orb"):
        settings = load_settings(overrides=VARIANTS[name].changes)
        _register(few, settings, store, Workers(workers.jobs, quiet=True), 0)


def _register(
    sequence: Recording, settings: Settings, store: Store, workers: Workers, seed: int
) -> tuple[Registration | None, str]:
    """The run, or as far as it came, and why no farther."""
    try:
        return register(sequence, settings, store, workers, seed), ""
    except RegistrationError as error:
        return error.run, str(error)


def _ros_camera(camera: Camera) -> Camera:
    """TUM's ROS default, for images of its size; other cameras just lose their distortion."""
    plain = default_camera()
    if (camera.width, camera.height) != (plain.width, plain.height):
        return replace(camera, lens=PINHOLE)
    return replace(plain, depth_scale=camera.depth_scale, noise=camera.noise)


def _same(a: Camera, b: Camera) -> bool:
    return replace(a, source="") == replace(b, source="")


def _verified(run: Registration | None) -> Ints:
    """(e, 2) frames of the verified edges."""
    return run.edges.pairs[run.edges.verified] if run else np.zeros((0, 2), np.int64)


def _scores(run: Registration | None, stamps: Floats, truth: Trajectory, edges: Floats) -> Row:
    """Accuracy of a run; None where there is nothing to measure."""
    registered = run.poses.registered if run else np.empty(0, np.int64)
    row: Row = {"frames": len(stamps), "registered": len(registered), "edges": len(_verified(run))}
    row |= dict.fromkeys(("ate_cm", "edge_deg", "edge_cm", "edges_scored"))
    if run is None or len(registered) < 3:
        return row
    found = evaluate(Trajectory(stamps[registered], run.poses.T_world_cam[registered]), truth, edges, PROTOCOL)
    relative = found.numbers["rpe"]["edges"]
    row |= {"ate_cm": _rounded(found.numbers["ate_rmse_m"], 100), "edge_deg": _rounded(relative["rot_deg_mean"])}
    return row | {"edge_cm": _rounded(relative["trans_m_mean"], 100), "edges_scored": relative["pairs"]}


def _estimates(run: Registration | None, stamps: Floats, truth: Trajectory) -> Row:
    """The edges as they were estimated, before averaging: median errors, and the share that is wrong."""
    none = dict.fromkeys(("estimate_deg", "estimate_cm", "wrong_share"))
    if run is None:
        return none
    T_true, known = associate(stamps, truth, PROTOCOL.association, PROTOCOL.max_diff_s)
    judged = judged_by_inliers(run.edges, run.settings.verification)
    found = judged.subset(judged.verified & known[judged.i] & known[judged.j])
    if not len(found):
        return none
    E = se3.inverse(T_true[found.i]) @ T_true[found.j] @ found.T_j_i
    deg, metres = se3.rotation_angle_deg(E[:, :3, :3]), np.linalg.norm(E[:, :3, 3], axis=1)
    row = {"estimate_deg": float(np.median(deg)), "estimate_cm": 100 * float(np.median(metres))}
    row |= {"wrong_share": float((~right(deg, metres)).mean())}
    return {key: _rounded(value) for key, value in row.items()}


def _seconds(run: Registration | None) -> Row:
    """Seconds of each of STAGES (None where the run did not get so far), and of all of them."""
    wall, cpu = (run.timings_s, run.cpu_timings_s) if run else ({}, {})
    row: Row = {f"{stage}_s": wall.get(stage) for stage in STAGES}
    total_s, total_cpu_s = (sum(spent.get(stage, 0.0) for stage in STAGES) for spent in (wall, cpu))
    return row | {"seconds": round(total_s, 3), "cpu_s": round(total_cpu_s, 3)}


def _rounded(value: float | None, factor: float = 1.0) -> float | None:
    return None if value is None else round(factor * value, 4)


def draw(rows: Sequence[Row]) -> Figure:
    """Each variant's errors and CPU seconds beside the default's: four panels, a colour a recording."""
    names = list(dict.fromkeys(row["variant"] for row in rows))
    panels = {
        "ate_cm": "ATE rmse [cm]",
        "edge_cm": "edges, mean [cm]",
        "edge_deg": "edges, mean [deg]",
        "cpu_s": "CPU [s]",
    }
    figure = Figure(figsize=(12, 1.2 + 0.28 * len(names)), layout="constrained")
    for axes, (key, label) in zip(figure.subplots(1, len(panels), sharey=True), panels.items(), strict=True):
        for colour, sequence in enumerate(dict.fromkeys(row["sequence"] for row in rows)):
            mine = [row for row in rows if row["sequence"] == sequence and row[key] is not None]
            places = [names.index(row["variant"]) for row in mine]
            axes.plot([row[key] for row in mine], places, "o", color=f"C{colour}", label=sequence)
            for row in mine[:1]:
                axes.axvline(row[key], color=f"C{colour}", linewidth=0.8, linestyle=":")
        axes.set(xlabel=label, xscale="log", ylim=(len(names) - 0.5, -0.5))
        axes.grid(axis="y", alpha=0.3)
        axes.set_yticks(range(len(names)), names)
    figure.axes[0].legend(fontsize="x-small")
    return figure
