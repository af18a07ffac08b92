"""The verdict of a map of several recordings, from those of its recordings and the checks of their joints."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from miniloop_cli.results.assessment import CONTRADICTING_DEG, CONTRADICTING_M, Level
from miniloop_cli.results.folder import Results
from miniloop_cli.scene.poses import residuals
from miniloop_cli.scene.scene_map import SceneMap

WORST_LAST = tuple(Level)  # good, doubtful, bad


def map_verdict(result: Path, scene_map: SceneMap, failed: Mapping[str, str]) -> dict[str, Any]:
    """{"level", "reasons"} of a map, as in the summary of a recording; `failed`: recordings left out, and why.

    The level is that of the worst recording. It is doubtful at best if a recording is left out, if recordings are not
    joined, if an edge between two of them contradicts the poses, or if the checks of joints raise a doubt
    (stages/joints.py).
    """
    joined, levels, reasons = scene_map.joined, [Level.GOOD], list[str]()
    for part in scene_map.parts:
        verdict = Results(result / part.name).summary.get("verdict")
        if not isinstance(verdict, dict) or verdict.get("level") not in tuple(Level):
            verdict = {"level": "doubtful", "reasons": ["its summary.json has no verdict"]}
        levels.append(Level(verdict["level"]))
        reasons += [f"{part.name}: {reason}" for reason in verdict.get("reasons", [])]
    doubts = [f"{name} could not be registered and is left out: {why}" for name, why in failed.items()]
    if (pieces := int(joined.piece.max(initial=-1)) + 1) > 1:
        doubts.append(f"the recordings form {pieces} pieces, and no edges join the pieces")
    angle_deg, distance_m = residuals(joined.edges, joined.T_world_cam)
    if off := int(((angle_deg > CONTRADICTING_DEG) | (distance_m > CONTRADICTING_M)).sum()):
        doubts.append(f"{off} of {len(joined.edges)} edges between recordings contradict the poses")
    doubts += joined.doubts
    levels += [Level.DOUBTFUL] * bool(doubts)
    return {"level": max(levels, key=WORST_LAST.index).value, "reasons": [*reasons, *doubts]}
