"""Features of one scan and what the report says of its frame."""

from __future__ import annotations

from dataclasses import dataclass

from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.thumbnail import View


@dataclass(frozen=True)
class ExtractedScan:
    """Features of one scan, its small picture, and what the report says of its frame.

    `problem`: why it could not be used, or ""; then there is no `view`.
    """

    features: ScanFeatures
    view: View | None
    depth_valid_share: float
    median_depth_m: float
    key: str
    problem: str = ""
