"""The recordings of a map and their relative poses, as compact arrays and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry.camera import Camera, DepthNoise, Trust
from miniloop_cli.geometry.depth_model import DepthModel
from miniloop_cli.geometry.lens import Lens
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.scene_map import Joined, MapPart, MapPoints, Retrieval
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats, Pair

Arrays = dict[str, NDArray[Any]]
UPPER = np.triu_indices(6)
MM = 1000.0  # depths of views are stored in millimetres
DERIVED = ("covariance",)  # of an edge: the inverse of its information


def part_header(part: MapPart) -> dict[str, Any]:
    """The entry of a recording in a map's manifest."""
    return {
        "name": part.name,
        "source": part.source,
        "layout": part.layout,
        "frames": part.total,
        "registered": len(part.frame),
        "keyframes": len(part),
        "features": part.feature_type,
        "camera": asdict(part.camera),
        "timing": asdict(part.timing),
    }


def part_arrays(part: MapPart) -> Arrays:
    """The arrays of a recording, its features one keyframe after the other."""
    features = part.features
    seen = [view is not None for view in part.views]
    views = [view for view in part.views if view is not None]
    arrays: Arrays = {
        "frame": part.frame.astype(np.int64),
        "stamps_s": part.stamps_s,
        "T_world_cam": part.T_world_cam[:, :3],
        "covariance": part.covariance[:, *UPPER].astype(np.float32),
        "keyframe": part.keyframe.astype(np.int64),
        "images": np.array(part.images, "<U16"),
        "features": np.array([len(scan) for scan in features], np.int64),
        "px_ideal": _stacked([scan.px_ideal for scan in features], np.float32, 2),
        "z_m": _stacked([scan.z_m for scan in features], np.float32),
        "outline": _stacked([scan.outline for scan in features], np.bool_),
        "descriptors": _descriptors([scan.descriptors for scan in features]),
        "seen": np.array(seen, bool),
        "gray": _stacked([np.rint(view.gray)[None] for view in views], np.uint8),
    }
    for name in ("z_m", "low_m", "high_m"):
        depths = [np.minimum(np.rint(MM * getattr(view, name)), 65535)[None] for view in views]
        arrays[f"view_{name}"] = _stacked(depths, np.uint16)
    return arrays | _edge_arrays(part.edges, "edge_")


def part_from(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> MapPart:
    """The recording from a header and arrays (...). Raises KeyError, TypeError or ValueError for malformed ones."""
    ends = np.cumsum(arrays["features"])[:-1]
    px, z, outline = (np.split(arrays[name], ends) for name in ("px_ideal", "z_m", "outline"))
    stored = arrays["descriptors"]
    descriptors = np.split(stored.astype(np.float32) if stored.dtype == np.float16 else stored, ends)
    features = tuple(
        ScanFeatures(p.astype(float), p.astype(float), depth.astype(float), np.zeros((len(p), 2)), jumps, found)
        for p, depth, jumps, found in zip(px, z, outline, descriptors, strict=True)
    )
    pictures = zip(
        arrays["gray"].astype(np.float32),
        *(arrays[f"view_{name}"].astype(np.float32) / np.float32(MM) for name in ("z_m", "low_m", "high_m")),
        strict=True,
    )
    views = tuple(View(*next(pictures)) if seen else None for seen in arrays["seen"])
    name = str(header["name"])
    if Path(name).name != name or name in ("", ".", ".."):
        raise ValueError(f"'{name}' names no folder")
    return MapPart(
        name,
        str(header["source"]),
        str(header["layout"]),
        int(header["frames"]),
        camera_from(header["camera"]),
        str(header["features"]),
        Timing(**header["timing"]),
        arrays["frame"],
        arrays["stamps_s"],
        _poses(arrays["T_world_cam"]),
        _symmetric(arrays["covariance"]),
        arrays["keyframe"],
        tuple(arrays["images"].tolist()),
        features,
        views,
        _edges_from(arrays, "edge_"),
    )


def camera_from(values: Mapping[str, Any]) -> Camera:
    """The camera from the values of `dataclasses.asdict`."""
    lens = Lens(str(values["lens"]["model"]), tuple(map(float, values["lens"]["coefficients"])))
    own = {"lens": lens, "noise": DepthNoise(**values["noise"])}
    own |= {"depth_model": DepthModel(**values["depth_model"]), "trust": Trust(values["trust"])}
    return Camera(**{**values, **own})


def joined_arrays(joined: Joined) -> Arrays:
    """The arrays of the relative poses of recordings."""
    arrays: Arrays = {
        "T_world_cam": joined.T_world_cam[:, :3],
        "covariance": joined.covariance[:, *UPPER].astype(np.float32),
        "piece": joined.piece,
        "pairs": np.array(list(joined.solved), np.int64).reshape(-1, 2),
        "points_m": joined.landmarks.points_m.astype(np.float32),
        "points_covariance": joined.landmarks.covariances_m2[:, *np.triu_indices(3)].astype(np.float32),
        "of_feature": joined.landmarks.of_feature.astype(np.int32),
        "words": joined.retrieval.words,
        "vectors": joined.retrieval.vectors.astype(np.float16),
        "doubts": np.array(joined.doubts, np.str_),
        "notes": np.array(joined.notes, np.str_),
        "proof": np.array([joined.certified, joined.relative_gap], float),
    }
    for a, b in joined.solved:
        arrays |= _edge_arrays(joined.solved[a, b], f"solved_{a}_{b}_")
    return arrays | _edge_arrays(joined.edges, "edge_")


def joined_from(arrays: Mapping[str, NDArray[Any]]) -> Joined:
    """The relative poses of recordings from arrays (...). Raises KeyError, TypeError or ValueError for others."""
    pairs: list[Pair] = [(int(a), int(b)) for a, b in arrays["pairs"]]
    return Joined(
        _poses(arrays["T_world_cam"]),
        _symmetric(arrays["covariance"]),
        arrays["piece"],
        {(a, b): _edges_from(arrays, f"solved_{a}_{b}_") for a, b in pairs},
        _edges_from(arrays, "edge_"),
        MapPoints(
            arrays["points_m"].astype(float), _symmetric(arrays["points_covariance"]), arrays["of_feature"].astype(int)
        ),
        Retrieval(arrays["words"], arrays["vectors"].astype(np.float32)),
        tuple(arrays["doubts"].tolist()),
        tuple(arrays["notes"].tolist()) if "notes" in arrays else (),  # earlier maps have none
        bool(arrays["proof"][0]),
        float(arrays["proof"][1]),
    )


def _edge_arrays(edges: EdgeTable, prefix: str) -> Arrays:
    arrays: Arrays = {name: column for name, column in edges.arrays().items() if name not in DERIVED}
    arrays["information"] = edges.information[:, *UPPER].astype(np.float32)
    arrays["matches"] = edges.matches.astype(np.uint16)
    return {prefix + name: column for name, column in arrays.items()}


def _edges_from(arrays: Mapping[str, NDArray[Any]], prefix: str) -> EdgeTable:
    own = {name.removeprefix(prefix): column for name, column in arrays.items() if name.startswith(prefix)}
    own["information"] = _symmetric(own["information"])
    own["covariance"] = np.linalg.pinv(own["information"], hermitian=True) if len(own["i"]) else own["information"]
    own["matches"] = own["matches"].astype(np.int64)
    return EdgeTable.from_arrays(own)


def _symmetric(upper: NDArray[Any]) -> Floats:
    """(n, 21) or (n, 6) upper triangles to (n, 6, 6) or (n, 3, 3) symmetric matrices."""
    size = 6 if upper.shape[1] == 21 else 3
    i, j = np.triu_indices(size)
    full = np.zeros((len(upper), size, size))
    full[:, i, j] = full[:, j, i] = upper
    return full


def _poses(rows: Floats) -> Floats:
    """(n, 3, 4) upper rows to (n, 4, 4) poses."""
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = rows
    return T


def _stacked(parts: Sequence[NDArray[Any]], dtype: Any, *width: int) -> NDArray[Any]:
    """The parts one after the other; without any, an empty array."""
    return np.concatenate([part.astype(dtype) for part in parts]) if parts else np.zeros((0, *width), dtype)


def _descriptors(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Descriptors of bytes as they are, those of real numbers with 16 bits each."""
    parts = [part for part in parts if len(part)] or [np.zeros((0, 1), np.uint8)]
    return _stacked(parts, np.uint8 if parts[0].dtype == np.uint8 else np.float16)
