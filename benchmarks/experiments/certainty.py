"""How often "it worked" is wrong: recordings of places that look alike, turntables, jumps, with exact truth.

Some are two recordings, registered to one map: of one room, or of two rooms.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from miniloop_cli.bench import Row
from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry import se3
from miniloop_cli.maps import register_many
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.results.assessment import Level, assess_run
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.registration import RegistrationError
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence
from miniloop_cli.typing import Floats

OFF_DEG, OFF_M = 8.0, 0.2  # a frame farther from the truth than this, as most others have it, stands elsewhere
TABLE = {"scene": "turntable", "depth_limit_m": 1.3, "frames": 36}
CASES: dict[str, dict[str, Any]] = {
    "room": {},
    "turntable": TABLE,
    "turntable, alike from behind": TABLE | {"alike": "half-turn"},
    "room, alike when half turned": {"alike": "half-turn", "frames": 30},
    "rooms alike": {"alike": "rooms", "rooms": 2, "frames": 60, "rate_hz": 3.0},
    "cuts": {"cuts": 2, "frames": 30},
    "cuts, a walk": {"cuts": 3, "frames": 30, "path": "random-walk"},
    "cut, room alike when half turned": {"cuts": 1, "frames": 26, "alike": "half-turn", "path_share": 0.66},
}
# Of two recordings: what each is, and whether both are of one room, which follows from the seed.
PAIRS: dict[str, tuple[dict[str, Any], dict[str, Any], bool]] = {
    "map: one room": ({}, {"path": "random-walk"}, True),
    "map: two rooms": ({}, {}, False),
    "map: two rooms, same furniture": ({"alike": "furniture"}, {"alike": "furniture"}, False),
    "map: two rooms, seen close by": (
        {"alike": "furniture", "path": "xyz"},
        {"alike": "furniture", "path": "xyz"},
        False,
    ),
}
OTHER_ROOM = 1000  # is added to the seed of a recording of another room
APART_M = np.array([100.0, 0.0, 0.0])  # from one room to the other, in the truth


def certainty_rows(
    only: Sequence[str] = (), width: int = 240, seeds: int = 5, seed: int = 0, workers: Workers | None = None
) -> Iterator[Row]:
    """One row a case, or `only` of those named, and each of so many `seeds`, from `seed` on.

    Raises ConfigError for an unknown name.
    """
    known = [*CASES, *PAIRS]
    if unknown := [name for name in only if name not in known]:
        raise ConfigError(f"no case '{unknown[0]}'; known are: {', '.join(known)}")
    for each in range(seed, seed + seeds):
        for name in only or known:
            if name in CASES:
                yield certainty_row(name, CASES[name], width, each, workers or Workers())
            else:
                yield map_row(name, width, each, workers or Workers())


def certainty_row(name: str, changes: dict[str, Any], width: int, seed: int, workers: Workers) -> Row:
    """What miniloop says of one recording with default settings, and how many frames stand elsewhere than it says."""
    size = size_of(width)
    with tempfile.TemporaryDirectory() as root:
        folder = write_sequence(Path(root) / "recording", SimulationSettings(**(size | changes)), seed)
        sequence, truth = open_with_truth(folder)
        row: Row = {"case": name, "seed": seed, "frames": len(sequence.frames)}
        try:
            run = register(sequence, load_settings(), Store(Path(root) / "cache"), workers, 0)
        except RegistrationError as error:
            none = {"registered": 0, "elsewhere": 0, "level": Level.BAD.value, "certified": None}
            return row | none | {"outcome": "bad", "said": str(error)}
    T_true, _ = associate(sequence.stamps_s, truth)
    posed, found = run.poses.registered, assess_run(run)
    off = elsewhere(run.poses.T_world_cam[posed], T_true[posed])
    row |= {"registered": len(posed), "elsewhere": off, "level": found.level.value}
    row["certified"] = bool(run.certificate and run.certificate.certified)
    return row | {"outcome": outcome(found.level, off), "said": "; ".join(found.reasons)}


def size_of(width: int) -> dict[str, Any]:
    """Settings of all simulations of this width, unless a case has others."""
    return {"frames": 24, "width": width, "height": width * 3 // 4}


def map_row(name: str, width: int, seed: int, workers: Workers) -> Row:
    """As `certainty_row`, of two recordings that are registered to one map.

    Where they are not joined, each has a world of its own, and what stands elsewhere is counted for each.
    """
    *both, one_room = PAIRS[name]
    with tempfile.TemporaryDirectory() as root:
        folders = [
            write_sequence(
                Path(root) / f"{'ab'[k]}",
                SimulationSettings(**(size_of(width) | changes)),
                seed + (0 if one_room else OTHER_ROOM * k),
            )
            for k, changes in enumerate(both)
        ]
        said = register_many(folders, Path(root) / "map", jobs=workers.jobs)
        worlds: dict[int, list[tuple[Floats, Floats]]] = {}
        for recording in said["recordings"]:
            found = read_trajectory(Path(root) / "map" / recording["name"] / "trajectory.txt")
            T_true, _ = associate(found.timestamps_s, open_with_truth(Path(root) / recording["name"])[1])
            if not one_room and recording["name"] == "b":
                T_true[:, :3, 3] += APART_M
            worlds.setdefault(recording["piece"], []).append((found.T_world_cam, T_true))
    off = sum(elsewhere(*(np.concatenate(poses) for poses in zip(*world, strict=True))) for world in worlds.values())
    level, reasons = Level(said["verdict"]["level"]), said["verdict"]["reasons"]
    registered, frames = (sum(recording[key] for recording in said["recordings"]) for key in ("registered", "frames"))
    row: Row = {"case": name, "seed": seed, "frames": frames, "registered": registered, "elsewhere": off}
    row |= {"level": level.value, "certified": said["certificate"]["certified"], "pieces": said["pieces"]}
    return row | {"outcome": outcome(level, off), "said": "; ".join(reasons)}


def outcome(level: Level, off: int) -> str:
    """Whether what is said of a run is right: one of "sure, right", "sure, WRONG", "doubted, wrong", "doubted, right",
    and "bad".
    """
    if level == Level.BAD:
        return "bad"
    if level == Level.GOOD:
        return "sure, WRONG" if off else "sure, right"
    return "doubted, wrong" if off else "doubted, right"


def elsewhere(T: Floats, T_true: Floats) -> int:
    """How many of n poses stand elsewhere than the truth (n, 4, 4), by the alignment that most of them agree with."""
    E = se3.inverse(T_true)[None] @ (T_true @ se3.inverse(T))[:, None] @ T[None]
    off = se3.rotation_angle_deg(E[..., :3, :3]) > OFF_DEG
    return int((off | (np.linalg.norm(E[..., :3, 3], axis=-1) > OFF_M)).sum(axis=1).min())


def draw(rows: Sequence[Row]) -> Figure:
    """Of each case, how often each outcome."""
    figure = Figure(figsize=(9, 1 + 0.4 * len({row["case"] for row in rows})), layout="constrained")
    axes = figure.subplots()
    colors = {
        "sure, right": "tab:green",
        "doubted, wrong": "tab:olive",
        "doubted, right": "tab:orange",
        "bad": "tab:gray",
        "sure, WRONG": "tab:red",
    }
    names = list(dict.fromkeys(row["case"] for row in rows))
    left = np.zeros(len(names))
    for each, color in colors.items():
        counts = Counter(row["case"] for row in rows if row["outcome"] == each)
        width = np.array([counts[name] for name in names], float)
        axes.barh(range(len(names)), width, left=left, color=color, label=each)
        left += width
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel="recordings", ylim=(len(names) - 0.5, -0.5))
    axes.legend(fontsize="x-small")
    return figure
