"""A cache of features alone, for experiments that time what follows them."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from miniloop_cli.runtime.artifact_store import Arrays, Store


class FeatureStore(Store):
    """Features come from disk and are kept there; all else is made in every run, so that its seconds are measured."""

    def load(self, kind: str, key: str) -> dict[str, NDArray[Any]] | None:
        """As Store.load."""
        return super().load(kind, key) if kind == "features" else None

    def save(self, kind: str, key: str, arrays: Arrays) -> None:
        """As Store.save."""
        if kind == "features":
            super().save(kind, key, arrays)
