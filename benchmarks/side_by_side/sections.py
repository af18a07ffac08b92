"""The tables of BENCHMARK.md: each a head and rows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.figures.store import cell_text

Json = dict[str, Any]
Table = tuple[list[str], list[list[Any]]]


def edge_list(sequence: Path) -> Path:
    """The list of edges that relative errors are measured on."""
    return Path(__file__).parents[1] / "edges" / f"{sequence.name}.txt"


def scores(trajectory: Path, sequence: Path, alignment: str = "SE3") -> Json:
    """ate_cm, edge_deg, edge_cm, registered of a trajectory; {} without one."""
    from miniloop_cli.evaluation.evaluate import Protocol, evaluate
    from miniloop_cli.results.evaluation_inputs import read_inputs

    if not trajectory.is_file():
        return {}
    edges = edge_list(sequence)
    protocol = Protocol(alignment=alignment, association="nearest")
    found = evaluate(*read_inputs(trajectory, sequence, edges if edges.is_file() else None, protocol)).numbers
    relative = found["rpe"]["edges" if edges.is_file() else "seconds"]
    return {
        "registered": found["poses"],
        "ate_cm": 100 * found["ate_rmse_m"],
        "edge_deg": relative["rot_deg_mean"],
        "edge_cm": 100 * relative["trans_m_mean"],
    }


def whole_runs(runs: dict[str, Json], trajectories: dict[str, Path], sequence: Path) -> Table:
    """Accuracy beside time, a row a method."""
    head = ["", "frames", "ATE cm", "edges deg", "edges cm", "edges", "wall s", "CPU s", "of miniloop's", "peak MB"]
    rows, ours = [], runs.get("miniloop", {}).get("usage", {}).get("cpu")
    for name, run in runs.items():
        score = scores(trajectories[name], sequence, "Sim3" if "colour only" in name else "SE3")
        usage = run["usage"]
        times = usage["cpu"] / ours if ours and not name.startswith("miniloop") else None
        rows.append(
            [name, f"{score.get('registered', 0)} of {run['frames']}"]
            + [score.get(key) for key in ("ate_cm", "edge_deg", "edge_cm")]
            + [run["edges"], usage["wall"], usage["cpu"], times and round(times, 1), round(usage["peak_mb"])]
        )
    return head, rows


def stages(runs: dict[str, Json]) -> Table:
    """Wall and CPU seconds of every stage, a row a method."""
    names = list(dict.fromkeys(stage for run in runs.values() for stage in run["stages"]))
    rows = []
    for name, run in runs.items():
        cells = [run["stages"].get(stage) for stage in names]
        rows.append([name] + [f"{cell_text(c['wall'])} / {cell_text(c['cpu'])}" if c else "" for c in cells])
    return ["stage: wall / CPU s", *names], rows


def again(found: Json, runs: dict[str, Json]) -> Table:
    """A run, and the same run with one setting changed, beside Open3D's multiway registration."""
    rows, whole = [], next(iter(found["stages"].values()))["wall"]
    multiway = next((run["usage"]["wall"] for name, run in runs.items() if name.startswith("Open3D")), None)
    for changed, spent in found["stages"].items():
        shares = [f"{100 * spent['wall'] / other:.1f} %" if other else None for other in (whole, multiway)]
        rows.append([changed, spent["wall"], spent["cpu"], *shares])
    return ["changed", "wall s", "CPU s", "of the run from nothing", "of Open3D multiway's wall s"], rows


def same_poses(found: Json, folder: Path, sequence: Path) -> Table:
    """Averaging and pose graphs on the same relative poses."""
    rows = []
    for row in found["rows"]:
        score = scores(folder / row["trajectory"], sequence)
        position = [score.get("ate_cm"), score.get("edge_cm")] if row["poses"] else [None, None]
        rows.append([row["method"], position[0], score.get("edge_deg"), position[1], row["wall"], row["cpu"]])
    return ["", "ATE cm", "edges deg", "edges cm", "wall s", "CPU s"], rows


def matching(found: dict[str, Json]) -> Table:
    """Matchers side by side, milliseconds a pair."""
    rows = []
    for sequence, data in found.items():
        for row in data.get("rows", []):
            size = f"{row['features']}, {row['mean_count']:.0f} a scan"
            rows.append([sequence, size, row["matcher"], row["ms"], row["matches"], f"{100 * row['also_ours']:.1f} %"])
    return ["recording", "features", "", "CPU ms a pair", "matches a pair", "same"], rows


def averaging(found: Sequence[Json]) -> Table:
    """View graphs with known poses."""
    head = [
        "graph",
        "",
        "seconds",
        "of these rotations",
        "rotation deg, median",
        "mean",
        "position m, median",
        "peak MB",
    ]
    keys = ("seconds", "rotation_seconds", "rot_err_deg_median", "rot_err_deg_mean", "trans_err_median")
    rows = []
    for row in found:
        graph = f"{row['kind']}, {row['scans']} scans, {row['edges']} edges, {100 * row['outliers']:g} % outliers"
        peak = round(row["peak_mb"]) if row["method"] == "miniloop" else None
        rows.append([graph, row["method"], *(row[key] for key in keys), peak])
    return head, rows


def averaging_scale(found: Sequence[Json]) -> Table:
    """View graphs of growing size: what miniloop takes for them."""
    head = ["graph", "CPU s", "wall s", "rotation deg, median", "mean", "position m, median", "peak MB"]
    keys = ("cpu_seconds", "seconds", "rot_err_deg_median", "rot_err_deg_mean", "trans_err_median")
    rows = []
    for row in found:
        graph = f"{row['kind']}, {row['scans']} scans, {row['edges']} edges, {100 * row['outliers']:g} % outliers"
        rows.append([graph, *(row[key] for key in keys), round(row["peak_mb"])])
    return head, rows


def certificates(found: Sequence[Json]) -> Table:
    """What the proof of the optimum takes on view graphs."""
    rows = []
    for row in found:
        graph = f"{row['kind']}, {row['scans']:,} scans, {row['proof_edges']:,} edges"
        gap = row["relative_gap"]
        said = "not examined" if gap is None else f"within {100 * gap:.1g} % of the lowest cost"
        answer = f"certified, {said}" if row["certified"] else said
        rows.append([graph, round(row["proof_cpu_seconds"], 1), answer])
    return ["graph", "CPU s of all of it", "answer"], rows


def ablation(found: Json) -> Table:
    """What each step is worth."""
    keys = {
        "registered": "frames", "edges": "edges", "wrong_share": "wrong", "ate_cm": "ATE cm", "edge_deg": "edges deg",
        "edge_cm": "edges cm",
        "matching_s": "matching s", "edges_s": "edges s", "averaging_s": "averaging s", "refinement_s": "refinement s",
        "seconds": "wall s", "cpu_s": "CPU s",
    }  # fmt: skip
    return ["", *keys.values()], [[row["variant"], *(row.get(key) for key in keys)] for row in found["rows"]]


def scaling(runs: dict[int, Json], found: dict[int, Json]) -> Table:
    """Accuracy, seconds a stage and memory over the number of frames."""
    names = list(dict.fromkeys(stage for run in runs.values() for stage in run["stages"]))
    rows: list[list[Any]] = []
    for frames, run in runs.items():
        wall = [run["stages"][name]["wall"] for name in names]
        usage, score = run["usage"], found[frames]
        start = [frames, score.get("registered", 0), score.get("ate_cm")]
        rows.append([*start, *wall, usage["wall"], usage["cpu"], round(usage["peak_mb"])])
    head = ["frames", "registered", "ATE cm", *(f"{name} s" for name in names), "wall s", "CPU s", "peak MB"]
    return head, rows


def whole_recordings(rows: Sequence[Json]) -> Table:
    """Whole recordings: miniloop beside others."""
    keys = {
        "poses": "poses", "ate_cm": "ATE cm", "rpe_deg": "frame to frame deg", "rpe_cm": "cm", "cpu_s": "CPU s",
        "wall_s": "wall s", "peak_mb": "peak MB",
    }  # fmt: skip
    named = [f"{row['sequence']}, {row['frames']} frames: {row['program']}" for row in rows]
    return ["", *keys.values()], [[name, *_cells(row, keys)] for name, row in zip(named, rows, strict=True)]


def growth(rows: Sequence[Json]) -> Table:
    """Recordings of growing length."""
    keys = {
        "frames": "frames", "rooms": "rooms", "poses": "poses", "ate_cm": "ATE cm", "cpu_ms": "CPU ms a frame",
        "wall_ms": "wall ms a frame", "peak_mb": "peak MB", "loops": "loops", "found_share": "found",
        "between": "between rooms", "between_share": "found",
    }  # fmt: skip
    return [*keys.values()], [_cells(row, keys) for row in rows]


def _cells(row: Json, keys: dict[str, str]) -> list[Any]:
    whole = {"peak_mb": round, "found_share": "{:.0%}".format, "between_share": "{:.0%}".format}
    return [whole[key](row[key]) if key in whole and row.get(key) is not None else row.get(key) for key in keys]


def camera_parts(rows: Sequence[Json]) -> Table:
    """Models of the camera, and what each leaves of the error."""
    keys = {"ate_cm": "ATE cm", "scaled_cm": "scale aligned, cm", "fx": "fx px", "cpu_s": "CPU s of refinement"}
    named = [[f"{row['sequence']}, {row['camera']}", row["model"]] for row in rows]
    return ["recording, camera", "free", *keys.values()], [
        [*name, *_cells(row, keys)] for name, row in zip(named, rows, strict=True)
    ]
