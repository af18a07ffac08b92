"""Colour images for `miniloop view`, read on demand: of one recording, or of the recordings of a map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Lock

from miniloop_cli.report.images import frame_image, jpeg
from miniloop_cli.results.columns import ReportData
from miniloop_cli.results.thumbnails import read_thumbnails
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.typing import Bytes

WIDTH_PX = 640


@dataclass(frozen=True)
class RecordingImages:
    """Images of `count` frames: from the recording, else its stored thumbnails."""

    count: int
    sequence: Sequence | None
    thumbnails: Mapping[int, Bytes]

    @staticmethod
    def of(data: ReportData) -> RecordingImages:
        """The images of a run. Raises InputError if its thumbnails are damaged."""
        return RecordingImages(len(data.frames), data.sequence, read_thumbnails(data.results.root / "thumbnails.npz"))

    def jpeg(self, frame: int) -> bytes | None:
        """The JPEG file; None if there is none, or it cannot be read."""
        if self.sequence and frame < len(self.sequence.frames):
            found = frame_image(self.sequence, frame, WIDTH_PX)
            if found:
                return jpeg(found[0]).tobytes()
        return self.thumbnails[frame].tobytes() if frame in self.thumbnails else None


@dataclass(frozen=True)
class FrameImages:
    """Recordings one after the other, with frames counted through all of them."""

    recordings: tuple[RecordingImages, ...] = ()
    one_at_a_time: Lock = field(default_factory=Lock)  # recordings are read by one thread at a time

    @property
    def any(self) -> bool:
        """Whether there may be images."""
        return any(recording.sequence or recording.thumbnails for recording in self.recordings)

    def jpeg(self, frame: int) -> bytes | None:
        """The image of a frame as the bytes of a JPEG file, WIDTH_PX wide if the recording can be opened."""
        for recording in self.recordings:
            if frame < recording.count:
                with self.one_at_a_time:
                    return recording.jpeg(frame)
            frame -= recording.count
        return None
