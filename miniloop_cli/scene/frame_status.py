"""The status of a frame."""

from __future__ import annotations

from enum import StrEnum


class FrameStatus(StrEnum):
    """Of every frame in frames.csv: registered, or why not."""

    REGISTERED = "registered"
    UNREADABLE = "unreadable"
    OTHER_PIECE = "other_piece"  # joined to other frames, but to none of the trajectory
    FEW_FEATURES = "few_features"
    NO_MATCHES = "no_matches"  # no other frame has enough matches with it
    NOT_VERIFIED = "not_verified"  # none of its overlaps was verified
