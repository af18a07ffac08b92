"""Stage: the features and the view of every scan; an unreadable scan is empty and has the reason."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from miniloop_cli.config import Depth, Features
from miniloop_cli.datasets import read_scan
from miniloop_cli.errors import InputError
from miniloop_cli.feature_types import FEATURE_TYPES
from miniloop_cli.features.keypoints3d import scan_features
from miniloop_cli.features.thumbnail import make_view
from miniloop_cli.geometry.camera import Trust
from miniloop_cli.runtime.artifact_store import Arrays, fingerprint
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.features import NO_FEATURES, ScanFeatures
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.stages.artifacts import FEATURES
from miniloop_cli.stages.run import Run

FEATURE_COLUMNS, VIEW_COLUMNS = ([column.name for column in fields(kind)] for kind in (ScanFeatures, View))
How = tuple[Sequence, Features, Depth]


def extract(sequence: Sequence, features: Features, depth: Depth, run: Run) -> ScanSet:
    """All scans of a sequence, in order."""
    how, numbers = (sequence, features, depth), range(len(sequence.frames))
    made = _made_by_cluster(how, run) if run.workers.cluster else {}

    def one(index: int) -> ExtractedScan:
        return _extract_scan(how, index, run, made.pop(index, None))

    found = list(run.workers.map(one, numbers, "detecting features", len(numbers)))
    return ScanSet(sequence, found, features.type, fingerprint([scan.key for scan in found]))


def _made_by_cluster(how: How, run: Run) -> dict[int, Arrays | str]:
    """The results of the cluster for frames that are not in the cache."""
    keys = [_key(how, index, run) for index in range(len(how[0].frames))]
    missing = [index for index, key in enumerate(keys) if run.store.load(FEATURES, key) is None]
    found = run.workers.spread(extract_arrays, how, missing, "detecting features", len(missing))
    return dict(zip(missing, found, strict=True))


def _extract_scan(how: How, index: int, run: Run, made: Arrays | str | None) -> ExtractedScan:
    """Features of frame `index`: from the cache, else those `made` already, else computed."""
    key = _key(how, index, run)
    kept: Arrays | str | None = run.store.load(FEATURES, key) if made is None else made
    if kept is None or made is not None:
        kept = extract_arrays(how, index) if kept is None else kept
        if not isinstance(kept, str):
            run.store.save(FEATURES, key, kept)
    if isinstance(kept, str):
        return ExtractedScan(NO_FEATURES, None, 0.0, 0.0, key, kept)
    features = ScanFeatures(*(kept[name] for name in FEATURE_COLUMNS))
    view = View(*(kept[f"view_{name}"] for name in VIEW_COLUMNS))
    return ExtractedScan(features, view, float(kept["depth"][0]), float(kept["depth"][1]), key)


def extract_arrays(how: How, index: int) -> Arrays | str:
    """The arrays of frame `index` for the cache; the reason if it cannot be read."""
    sequence, features, depth = how
    try:
        scan = read_scan(sequence, index)
    except InputError as error:
        return str(error)
    found = scan_features(scan, sequence.camera, features, depth)
    readings = scan.depth_m[scan.depth_m > 0]
    valid = np.array([len(readings) / scan.depth_m.size, np.median(readings) if len(readings) else 0.0])
    view = make_view(scan, sequence.camera, depth)
    arrays = {name: getattr(found, name) for name in FEATURE_COLUMNS} | {"depth": valid}
    return arrays | {f"view_{name}": getattr(view, name) for name in VIEW_COLUMNS}


def _key(how: How, index: int, run: Run) -> str:
    sequence, features, depth = how
    frame = sequence.frames[index]
    files = [source.fingerprint() for source in (frame.color, frame.depth, frame.mask) if source]
    # Features do not depend on the source of the camera.
    own = frame.camera and replace(frame.camera, source="", trust=Trust.CALIBRATED)
    camera = (replace(sequence.camera, source="", trust=Trust.CALIBRATED), own)
    version = FEATURE_TYPES[features.type].version
    other = (sequence.depth_camera,) if sequence.depth_camera else ()
    return run.store.key(FEATURES, (files, features, version, depth, camera, sequence.depth_format, *other))
