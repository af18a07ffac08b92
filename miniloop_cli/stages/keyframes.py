"""Keyframes of several recordings as one set of scans, for the stages that compare scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from miniloop_cli.mapping.common_camera import features_in, pinhole, view_in
from miniloop_cli.runtime.artifact_store import fingerprint
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import MapPart, first_keyframes
from miniloop_cli.scene.sequence import Sequence as Recording
from miniloop_cli.typing import Ints


def common_scans(parts: Sequence[MapPart], chosen: Ints | None = None) -> ScanSet:
    """All keyframes as one set of scans, in the pinhole camera of the first recording.

    `chosen`: ascending numbers (k,) of some of them, counted through the recordings.
    """
    common, first = pinhole(parts[0].camera), first_keyframes(parts)
    rows = np.arange(first[-1]) if chosen is None else chosen
    extracted, keys = [], []
    for r, part in enumerate(parts):
        own = rows[(rows >= first[r]) & (rows < first[r + 1])] - first[r]
        keys.append((part.feature_type, replace(part.camera, source=""), [part.contents[k] for k in own.tolist()]))
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
