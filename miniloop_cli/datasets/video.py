"""Frames of a video as images: decoded in order by FFmpeg's libraries (PyAV), a decoder kept open once a process.

Frames are used as stored; rotations and omissions for display are ignored, as depth has none.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.damage import damage
from miniloop_cli.datasets.images import MAX_PIXELS
from miniloop_cli.datasets.optional_wheel import optional_wheel
from miniloop_cli.datasets.paths import open_file, shown
from miniloop_cli.errors import InputError
from miniloop_cli.runtime.artifact_store import file_fingerprint
from miniloop_cli.runtime.kept_open import KeptOpen
from miniloop_cli.scene.image_source import ImageHeader
from miniloop_cli.typing import Floats

MAX_VIDEO_BYTES = 64 << 30
MAX_FRAMES = 2_000_000
AHEAD_S = 2.0  # up to a frame no further ahead, the decoder continues without a seek
BACK_S = (0.0, 1.0, 10.0, 100.0, 1e6)
UNDECODABLE = "the video is damaged here: this frame cannot be decoded"
RECENT = 4  # decoded frames that are kept, as threads read neighbours in any order
MATROSKA = b"\x1a\x45\xdf\xa3"
MP4_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide")
# Every stored frame, none repeated or left out for display; no other file or address is opened.
OPTIONS = {"ignore_editlist": "1", "enable_drefs": "0", "protocol_whitelist": "file"}


@dataclass(frozen=True)
class VideoFrame:
    """The image source of one frame of a video, named by its number in order of time and its presentation stamp."""

    path: Path
    number: int
    pts: int

    @property
    def name(self) -> str:
        return f"{os.fspath(self.path)}/{self.number:06d}"

    def header(self) -> ImageHeader:
        return _opened(self.path).header

    def read(self) -> NDArray[Any]:
        return _opened(self.path).read(self.pts)

    def fingerprint(self) -> str:
        try:
            return f"{_FINGERPRINTS.get(self.path)}:{self.pts}"
        except OSError:
            return "unreadable"


def video_frames(path: Path) -> tuple[tuple[VideoFrame, ...], Floats]:
    """The frames of a video in order of time, and their times (s) by the video's own clock; nothing is decoded.

    Raises InputError naming the file for one that is missing, damaged or without a usable index.
    """
    try:
        stamps, seconds_a_tick = _opened(path).stamps()
    except InputError as error:
        text = str(error)
        raise InputError(text if shown(path) in text else f"{shown(path)}: {text}") from error
    frames = tuple(VideoFrame(path, k, pts) for k, pts in enumerate(stamps))
    return frames, np.array(stamps, float) * seconds_a_tick


class _Video:
    """A video that is open, with its decoder; threads take turns."""

    def __init__(self, path: Path) -> None:
        av = optional_wheel("av", "av", "phones")
        av.logging.set_level(av.logging.PANIC)
        self._lock = threading.RLock()
        self._path, self._recent = path, deque[Any](maxlen=RECENT)
        self._at: int | None = None
        self._stamps: list[int] = []
        self._frames: Iterator[Any] = iter(())
        with open_file(path, MAX_VIDEO_BYTES) as file:
            kind = _kind(file.read(8))
        plain = type(path) is type(Path())
        with damage(_reason):
            self._container = av.open(os.fspath(path) if plain else path.open("rb"), format=kind, options=OPTIONS)
            if not self._container.streams.video:
                raise InputError("it holds no video")
            self._stream = self._container.streams.video[0]
            codec = self._stream.codec_context
            if codec is None:
                raise InputError("the encoding of its frames is not supported")
            codec.thread_count = 1  # frames are decoded in many processes already
            if codec.width * codec.height > MAX_PIXELS or not codec.width * codec.height:
                raise InputError(f"frames of {codec.width} x {codec.height} pixels")
            self.header = ImageHeader(codec.width, codec.height, 8, 3, f"{codec.name} video frame")
            self._tick_s = float(self._stream.time_base or 0)
        if not self._tick_s > 0:
            raise InputError("the video does not state the unit of its times")

    def stamps(self) -> tuple[list[int], float]:
        """The presentation stamps of all frames, sorted, and seconds a tick; packets are read but not decoded."""
        if self._stamps:
            return self._stamps, self._tick_s
        found = set()
        with self._lock, damage(_reason):
            self._at = None  # the decoder does not get the packets read here
            for packet in self._container.demux(self._stream):
                if packet.pts is not None and packet.size:
                    found.add(int(packet.pts))
                if len(found) > MAX_FRAMES:
                    raise InputError(f"a video of more than {MAX_FRAMES} frames")
        if not found:
            raise InputError("the video holds no frames")
        self._stamps = sorted(found)
        return self._stamps, self._tick_s

    def read(self, pts: int) -> NDArray[Any]:
        """(h, w, 3) uint8 RGB of the frame with this stamp. Raises InputError (reason only)."""
        with self._lock, damage(_reason):
            for kept in self._recent:
                if kept.pts == pts:
                    return self._pixels(kept)
            if self._at is None or not 0 < (pts - self._at) * self._tick_s <= AHEAD_S:
                self._start(pts)
            try:
                return self._pixels(self._decode_to(pts))
            except BaseException:
                self._at = None  # the state of the decoder is unknown now
                raise

    def _start(self, pts: int) -> None:
        """Seek to a position at or before the frame `pts`; the decoder's next frame is the first there.

        A container seeks in the order of decoding, in which a later frame may come first; then the seek goes further
        back.
        """
        for back_s in BACK_S:
            self._at = None
            self._container.seek(pts - round(back_s / self._tick_s), stream=self._stream, backward=True)
            frames = self._container.decode(self._stream)
            first = next((frame for frame in frames if frame.pts is not None), None)
            if first is not None and first.pts <= pts:
                self._frames = chain([first], frames)
                return
        raise InputError(UNDECODABLE)

    def _decode_to(self, pts: int) -> Any:
        for frame in self._frames:
            if frame.pts is None:
                continue
            self._at = int(frame.pts)
            self._recent.append(frame)
            if self._at >= pts:
                break
        if self._at != pts:
            raise InputError(UNDECODABLE)
        return frame

    def _pixels(self, frame: Any) -> NDArray[Any]:
        if (frame.width, frame.height) != (self.header.width, self.header.height):
            raise InputError(f"this frame is {frame.width} x {frame.height}, the video {self.header}")
        return np.asarray(frame.to_ndarray(format="rgb24"))


def _kind(start: bytes) -> str:
    """The container by its first bytes, as FFmpeg's own detection accepts playlists, which open other files."""
    if start.startswith(MATROSKA):
        return "matroska"
    if start[4:8] in MP4_BOXES:
        return "mp4"
    raise InputError("not an MP4, MOV or Matroska video")


def _reason(error: Exception) -> str:
    """FFmpeg's reason for a damaged video."""
    said = getattr(error, "strerror", None) or type(error).__name__
    return f"the video is damaged, cut off or without an index ({said})"


def _opened(path: Path) -> _Video:
    try:
        return _OPEN.get(path)
    except OSError as error:
        raise InputError(f"cannot read {shown(path)}: {error.strerror or error}") from error


_OPEN: KeptOpen[_Video] = KeptOpen(_Video)
_FINGERPRINTS: KeptOpen[str] = KeptOpen(file_fingerprint)
