"""Keyframes of several recordings as one set of scans, for the stages that compare scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.mapping.common_camera import features_in, pinhole, view_in
from miniloop_cli.runtime.artifact_store import Arrays, content_fingerprint, fingerprint
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import MapPart, first_keyframes
from miniloop_cli.scene.sequence import Sequence as Recording
from miniloop_cli.stages.artifacts import REPETITION
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Ints
from miniloop_cli.verification.photometric_check import PhotometricCheck
from miniloop_cli.verification.repetition import pattern_steps_m


def common_scans(parts: Sequence[MapPart], chosen: Ints | None = None) -> ScanSet:
    """All keyframes as one set of scans, in the pinhole camera of the first recording.

    `chosen`: ascending numbers (k,) of some of them, counted through the recordings.
    """
    common, first = pinhole(parts[0].camera), first_keyframes(parts)
    rows = np.arange(first[-1]) if chosen is None else chosen
    extracted, keys = [], []
    for r, part in enumerate(parts):
        own = rows[(rows >= first[r]) & (rows < first[r + 1])] - first[r]
        keys.append(part_key(part, own))
        extracted += [
            ExtractedScan(
                features_in(part.features[k], part.camera, common),
                view_in(part.views[k], part.camera, common),
                np.nan,
                np.nan,
                "",
            )
            for k in own.tolist()
        ]
    recording = Recording("map", Path(), common, ())
    return ScanSet(recording, extracted, parts[0].feature_type, fingerprint(keys))


def part_key(part: MapPart, rows: Ints) -> str:
    """A cache key for the views of the keyframes rows (k,) of a recording."""
    features = [part.features[k] for k in rows.tolist()]
    own = [array for f in features for array in (f.px_ideal, f.z_m, f.descriptors)]
    return fingerprint(part.feature_type, replace(part.camera, source=""), content_fingerprint(own))


def photometric_check(
    parts: Sequence[MapPart], scans: ScanSet, settings: Settings, run: Run, chosen: Ints | None = None
) -> PhotometricCheck:
    """The photometric check of the keyframes (`chosen` (k,) as in `common_scans`).

    Their repetition is cached by recording.
    """
    steps = []
    for part in parts:

        def make(part: MapPart = part) -> Arrays:
            alone = common_scans([part])
            return {
                "step_m": np.array(pattern_steps_m(alone, settings.ransac, settings.verification.chi2, run.workers))
            }

        key = (part_key(part, np.arange(len(part))), settings.ransac, settings.verification.chi2)
        steps.append(run.store.cached(REPETITION, key, make)["step_m"])
    step_m = np.concatenate(steps)
    outline = [features.outline for features in scans.features]
    return PhotometricCheck(
        scans.thumbnails, scans.points, outline, step_m if chosen is None else step_m[chosen], scans.camera
    )
