"""Features of one scan and the properties of its frame for the report."""

from __future__ import annotations

from dataclasses import dataclass

from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.thumbnail import View


@dataclass(frozen=True)
class ExtractedScan:
    """Features of one scan, its view, and the properties of its frame for the report.

    `problem`: why it cannot be used, or ""; with a problem there is no `view`.
    """

    features: ScanFeatures
    view: View | None
    depth_valid_share: float
    median_depth_m: float
    key: str
    problem: str = ""
