"""The features of every scan of a sequence, kept on disk; a scan that cannot be read is named and left empty."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, fields

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.datasets import read_scan
from miniloop_cli.errors import InputError
from miniloop_cli.feature_types import FEATURE_TYPES
from miniloop_cli.features.keypoints3d import scan_features
from miniloop_cli.features.thumbnail import make_view
from miniloop_cli.runtime.artifact_store import Arrays, Store, fingerprint
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.scene.thumbnail import View

NO_PLACES, NO_NUMBERS = np.zeros((0, 2)), np.zeros(0)
NOTHING = ScanFeatures(NO_PLACES, NO_PLACES, NO_NUMBERS, NO_PLACES, np.zeros(0, bool), np.zeros((0, 128), np.uint8))
COLUMNS, PICTURES = ([column.name for column in fields(kind)] for kind in (ScanFeatures, View))


def extract(sequence: Sequence, settings: Settings, store: Store, workers: Workers) -> Iterator[ExtractedScan]:
    """Features of each frame, in order."""
    made: dict[int, Arrays | str] = {}
    if workers.cluster:
        keys = [_key(sequence, index, settings) for index in range(len(sequence.frames))]
        missing = [index for index, key in enumerate(keys) if store.load("features", key) is None]
        found = workers.spread(make, (sequence, settings), missing, "detecting features", len(missing))
        for index, arrays in zip(missing, found, strict=True):
            made[index] = arrays
            if not isinstance(arrays, str):
                store.save("features", keys[index], arrays)

    def one(index: int) -> ExtractedScan:
        return extract_scan(sequence, index, settings, store, made.pop(index, None))

    return workers.map(one, range(len(sequence.frames)), "detecting features", len(sequence.frames))


def extract_scan(
    sequence: Sequence, index: int, settings: Settings, store: Store, made: Arrays | str | None = None
) -> ExtractedScan:
    """Features of frame `index`: those `made` already, else from the store where they were made before."""
    key = _key(sequence, index, settings)
    kept = store.load("features", key) if made is None else made
    if kept is None:
        kept = make((sequence, settings), index)
        if not isinstance(kept, str):
            store.save("features", key, kept)
    if isinstance(kept, str):
        return ExtractedScan(NOTHING, None, 0.0, 0.0, key, kept)
    found = ScanFeatures(*(kept[name] for name in COLUMNS))
    return ExtractedScan(
        found, View(*(kept[f"view_{name}"] for name in PICTURES)), float(kept["depth"][0]), float(kept["depth"][1]), key
    )


def make(how: tuple[Sequence, Settings], index: int) -> Arrays | str:
    """The arrays that are kept of frame `index`; why there are none where it cannot be read."""
    sequence, settings = how
    try:
        scan = read_scan(sequence, index)
    except InputError as error:
        return str(error)
    found = scan_features(scan, sequence.camera, settings.features, settings.depth)
    readings = scan.depth_m[scan.depth_m > 0]
    depth = np.array([len(readings) / scan.depth_m.size, np.median(readings) if len(readings) else 0.0])
    view = make_view(scan, sequence.camera, settings.depth)
    arrays = {name: getattr(found, name) for name in COLUMNS} | {"depth": depth}
    return arrays | {f"view_{name}": getattr(view, name) for name in PICTURES}


def _key(sequence: Sequence, index: int, settings: Settings) -> str:
    frame = sequence.frames[index]
    files = [source.fingerprint() for source in (frame.color, frame.depth, frame.mask) if source]
    camera = asdict(sequence.camera) | {"source": ""}  # how the camera was found does not change a feature
    version = FEATURE_TYPES[settings.features.type].version
    how = [settings.features.model_dump(), version, settings.depth.model_dump(), camera, asdict(sequence.depth_format)]
    return fingerprint("features", files, how)
