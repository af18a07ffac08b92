"""Whether a recording is in a map already, by its images."""

from __future__ import annotations

from collections.abc import Sequence as Many

from miniloop_cli.errors import InputError
from miniloop_cli.scene.scene_map import MapPart
from miniloop_cli.scene.sequence import Sequence

SAME_IMAGES = 0.5  # share of keyframes with images of another recording for the same recording


def refuse_known(part: MapPart, others: Many[MapPart]) -> None:
    """Raise InputError for a recording with mostly images of another one."""
    for other in others:
        same = len(set(part.images) & set(other.images))
        if same >= SAME_IMAGES * min(len(part), len(other)):
            raise InputError(
                f"{part.source} is in the map already: '{other.name}' has {same} of its {len(part)} images"
            )


def refuse_images(sequence: Sequence, parts: Many[MapPart]) -> None:
    """As `refuse_known`, before any work: compares the images with the keyframes. Raises InputError."""
    images = {frame.color.fingerprint()[:16] for frame in sequence.frames}
    for part in parts:
        same = len(images & set(part.images))
        if same >= SAME_IMAGES * len(part):
            raise InputError(
                f"{sequence.root} is in the map already: it has {same} of the {len(part)} keyframes of '{part.name}'"
            )
