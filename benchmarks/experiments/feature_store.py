"""A cache of features alone, for experiments that time what follows them."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from miniloop_cli.runtime.artifact_store import Arrays, Artifact, Store
from miniloop_cli.stages.artifacts import FEATURES


class FeatureStore(Store):
    """Features come from disk and are kept there; all else is made in every run, so that its seconds are measured."""

    def load(self, artifact: Artifact, key: str) -> dict[str, NDArray[Any]] | None:
        """As Store.load."""
        return super().load(artifact, key) if artifact == FEATURES else None

    def save(self, artifact: Artifact, key: str, arrays: Arrays) -> None:
        """As Store.save."""
        if artifact == FEATURES:
            super().save(artifact, key, arrays)
