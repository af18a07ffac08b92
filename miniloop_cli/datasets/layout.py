"""The protocol of a layout of recordings, built in or a plug-in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

from miniloop_cli.scene.sequence import Sequence, Trajectory


@runtime_checkable
class Layout(Protocol):
    """How one tool writes its recordings; a class without arguments, named by an entry of `registry`.

    Opening lists the frames and decodes nothing: a Frame holds image sources, which are read one at a time later on.
    `ImageFile` is the source for image files; a layout with frames inside a container (an archive, a video, a bag)
    defines its own source, and its recording is never unpacked.
    """

    def matches(self, root: Path) -> bool:
        """Whether the folder or file has this layout, by names or by a file's first bytes."""

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The recording at `root`, with the camera of the YAML file `camera_path`, if given.

        Raises InputError that names what is missing and what to do.
        """

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The reference poses that came with it, camera to world; None if there are none. Raises InputError."""


@runtime_checkable
class TopicLayout(Protocol):
    """A layout whose recordings hold several streams: `topics` (color, depth, info, depth_info) chooses among them."""

    topics: Mapping[str, str]
