"""All scans of a recording, with their features."""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.points import ScanPoints, scan_points
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.typing import Floats, Ints


@dataclass(frozen=True)
class ScanSet:
    """n scans of one sequence; `feature_type` of their descriptors; `key`: hash of all their inputs."""

    sequence: Sequence
    extracted: Many[ExtractedScan]
    feature_type: str
    key: str

    def __len__(self) -> int:
        return len(self.extracted)

    @property
    def camera(self) -> Camera:
        """The camera of all scans."""
        return self.sequence.camera

    @cached_property
    def features(self) -> list[ScanFeatures]:
        """Features of each scan."""
        return [scan.features for scan in self.extracted]

    @cached_property
    def first_feature(self) -> Ints:
        """(n + 1,) number of the first feature of each scan, counted through all of them; the last is their total."""
        return np.cumsum([0, *(len(features) for features in self.features)])

    @cached_property
    def points(self) -> list[ScanPoints]:
        """Features with depth of each scan, in space."""
        return [scan_points(features, self.camera) for features in self.features]

    @property
    def thumbnails(self) -> list[View | None]:
        """The view of each scan; None for unreadable ones."""
        return [scan.view for scan in self.extracted]

    @property
    def stamps_s(self) -> Floats:
        """(n,) colour stamps."""
        return self.sequence.stamps_s

    @property
    def depth_stamps_s(self) -> Floats:
        """(n,) depth stamps; those of colour if depth has none."""
        return self.sequence.depth_stamps_s
