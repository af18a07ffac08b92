"""A map in numbers, for `miniloop map info` and for scripts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from miniloop_cli.scene.scene_map import SceneMap
from miniloop_cli.typing import Ints


def map_numbers(scene_map: SceneMap, size: int, manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a map in numbers, JSON-able; `size`: bytes of its data files."""
    joined = scene_map.joined
    sigma = np.sqrt(np.trace(joined.landmarks.covariances_m2, axis1=1, axis2=2))
    names = [part.name for part in scene_map.parts]
    of_part = np.repeat(np.arange(len(names)), np.diff(scene_map.first))
    ends = of_part[joined.edges.pairs]  # sorted: keyframes are numbered by recordings
    return {
        "version": manifest["version"],
        "miniloop": manifest["miniloop"],
        "bytes": size,
        "keyframes": len(joined.T_world_cam),
        "features": int(scene_map.first_feature[-1]),
        "feature_type": scene_map.feature_type,
        "points": len(joined.landmarks.points_m),
        "point_sigma_m": round(float(np.median(sigma)), 5) if len(sigma) else 0.0,
        "notes": list(joined.notes),
        "pieces": int(joined.piece.max(initial=-1)) + 1,
        "recordings": [
            {
                "name": part.name,
                "source": part.source,
                "frames": part.total,
                "registered": len(part.frame),
                "keyframes": len(part),
                "piece": int(piece),
            }
            for part, piece in zip(scene_map.parts, joined.piece, strict=True)
        ],
        "joins": [
            _join(joined.edges.pairs[(ends == pair).all(axis=1)], names, pair) for pair in np.unique(ends, axis=0)
        ],
    }


def _join(pairs: Ints, names: list[str], ends: Ints) -> dict[str, Any]:
    """The joint of two recordings: edges (m, 2) between keyframes, and the number of keyframes of each."""
    a, b = (len(np.unique(side)) for side in pairs.T)
    return {"a": names[ends[0]], "b": names[ends[1]], "edges": len(pairs), "keyframes_a": a, "keyframes_b": b}
