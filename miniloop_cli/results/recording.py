"""The recording of a results folder, opened again."""

from __future__ import annotations

from pathlib import Path

from miniloop_cli.datasets import open_sequence
from miniloop_cli.errors import MiniloopError
from miniloop_cli.results.folder import Results
from miniloop_cli.scene.sequence import Sequence


def reopened(
    results: Results, layout: str | None = None, camera: Path | None = None, follow_links: bool = False
) -> tuple[Sequence | None, str]:
    """The recording named by summary.json, with the camera of the run unless another one is given.

    None and the reason if it cannot be opened, as it was moved or is damaged; None and "" if none is named.
    """
    if camera is None and results.camera:
        camera = results.root / "camera.yaml"
    summary = results.summary
    if not summary.get("recording"):
        return None, ""
    layout = layout or summary.get("layout")
    try:
        topics = str(summary.get("topics", ""))
        recorded = str(summary["recording"])
        return open_sequence(recorded, layout, camera, follow_links=follow_links, topics=topics), ""
    except (MiniloopError, TypeError) as error:
        return None, str(error)
