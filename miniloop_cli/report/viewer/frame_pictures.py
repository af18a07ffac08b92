"""Small colour images of the frames, embedded in a page.

Frames with edges have larger ones, on which matches are drawn. The others have thumbnails, which were made by tracking,
or are made here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from miniloop_cli.datasets import read_color
from miniloop_cli.datasets.thumbnails import small_jpeg, thumbnail
from miniloop_cli.errors import InputError
from miniloop_cli.report.spacing import evenly_spaced
from miniloop_cli.report.viewer import packing
from miniloop_cli.results.columns import ReportData
from miniloop_cli.results.thumbnails import read_thumbnails
from miniloop_cli.runtime.artifact_store import Arrays, Artifact, Store
from miniloop_cli.scene.sequence import Sequence as Recording
from miniloop_cli.typing import Bytes, Ints

FRAME_PICTURES = Artifact("frame_pictures", 2)
WIDTH_PX, QUALITY = 320, 50
MOST_LARGE = 200  # some 10 kB each
MOST_SMALL = 1200  # some 3 kB each
MOST_READ = 600  # images that are decoded only for the page


@dataclass(frozen=True)
class FramePictures:
    """JPEG files by frame: `large` ones WIDTH_PX wide, thumbnails of others."""

    large: Mapping[int, Bytes]
    small: Mapping[int, Bytes]

    @staticmethod
    def of_several(recordings: Sequence[FramePictures], first: Sequence[int]) -> FramePictures:
        """The pictures of several recordings, whose frames are numbered from first[r] on."""
        numbered = list(zip(recordings, first, strict=False))
        large = {k + begin: file for one, begin in numbered for k, file in one.large.items()}
        return FramePictures(large, {k + begin: file for one, begin in numbered for k, file in one.small.items()})

    def values(self) -> list[dict[str, object]]:
        """For JSON: for each size the common beginning of all files and the rest of each, as joinable base64."""
        return [_shared({k: file.tobytes() for k, file in files.items()}) for files in (self.large, self.small)]


def frame_pictures(data: ReportData, store: Store, share: int = 1) -> FramePictures:
    """Pictures of the frames of a run; unavailable ones are left out. Raises InputError for a damaged file.

    `share`: runs that the page shows together. A power of two is taken, so that a map which grows by a recording mostly
    finds its pictures in the cache.
    """
    share = 1 << (share - 1).bit_length()
    kept = read_thumbnails(data.results.root / "thumbnails.npz")
    n = len(data.frames)
    large: dict[int, Bytes] = {}
    if data.sequence:
        shown = np.unique(np.concatenate([data.edges.i, data.edges.j]))
        shown = shown[shown < len(data.sequence.frames)]
        large = _read(data.sequence, shown[evenly_spaced(len(shown), MOST_LARGE // share)], WIDTH_PX, QUALITY, store)
    rest = np.setdiff1d(sorted(k for k in kept if k < n) if kept else np.arange(n), sorted(large))
    if kept:
        return FramePictures(large, {int(k): kept[int(k)] for k in rest[evenly_spaced(len(rest), MOST_SMALL // share)]})
    if data.sequence is None:
        return FramePictures(large, {})
    rest = rest[rest < len(data.sequence.frames)]
    return FramePictures(large, _read(data.sequence, rest[evenly_spaced(len(rest), MOST_READ // share)], 0, 0, store))


def _read(sequence: Recording, numbers: Ints, width: int, quality: int, store: Store) -> dict[int, Bytes]:
    """JPEG files of these frames of a recording, thumbnails for width 0."""

    def drawn() -> Arrays:
        made = {}
        for k in numbers.tolist():
            try:
                color = read_color(sequence.frames[k].color)
            except InputError:
                continue
            made[str(k)] = small_jpeg(color, width, quality) if width else thumbnail(color)
        return made

    inputs = (width, quality, [(k, sequence.frames[k].color.fingerprint()) for k in numbers.tolist()])
    return {int(name): picture for name, picture in store.cached(FRAME_PICTURES, inputs, drawn).items()}


def _shared(files: Mapping[int, bytes]) -> dict[str, object]:
    """The common beginning of all files, at a length where base64 can be cut, and the rest of each."""
    first, last = (min(files.values()), max(files.values())) if len(files) > 1 else (b"", b"")
    same = next((k for k, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), min(len(first), len(last)))
    head = first[: same // 3 * 3]
    rest = {str(k): packing.text(file[len(head) :]) for k, file in files.items()}
    return {"head": packing.text(head), "files": rest}
