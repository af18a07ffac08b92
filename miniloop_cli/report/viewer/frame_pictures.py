"""Small colour images of the frames for a page that carries them, and the inlier matches on them."""

from __future__ import annotations

import numpy as np

from miniloop_cli.report.images import frame_image, jpeg
from miniloop_cli.runtime.artifact_store import Arrays, Artifact, Store
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.typing import Bytes, Ints

FRAME_PICTURES = Artifact("frame_pictures", 1)
WIDTH_PX = 320
MOST_PICTURES = 600  # some 10 kB each


def pictured(count: int) -> Ints:
    """The frames (k,) of `count` whose images a page carries: all, or evenly spaced ones."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_PICTURES)).round().astype(np.int64)) if count else _NONE


_NONE = np.zeros(0, np.int64)


def frame_pictures(sequence: Sequence, store: Store) -> dict[int, Bytes]:
    """JPEG files (n,) of `pictured` frames, WIDTH_PX wide, by frame, without images that cannot be read."""
    numbers = pictured(len(sequence.frames))

    def drawn() -> Arrays:
        made = {}
        for k in numbers.tolist():
            found = frame_image(sequence, k, WIDTH_PX)
            if found:
                made[str(k)] = jpeg(found[0])
        return made

    inputs = ("small", WIDTH_PX, [(k, sequence.frames[k].color.fingerprint()) for k in numbers.tolist()])
    return {int(name): picture for name, picture in store.cached(FRAME_PICTURES, inputs, drawn).items()}
