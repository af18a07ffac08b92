"""A robot's recordings as they leave it, in one zip file, which is read frame by frame and never unpacked."""

import hashlib
import io
import zipfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.datasets.images import decode, read_header
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import RATE_HZ, frame_number, pair_by_number
from miniloop_cli.datasets.trajectory import from_rows
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Sequence

KEYS = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale")


@dataclass(frozen=True)
class Member:
    """The image source of a file inside a zip file."""

    archive: Path
    inside: str

    @property
    def name(self):
        return f"{self.archive}/{self.inside}"

    def data(self):
        try:
            return opened(self.archive).read(self.inside)
        except (KeyError, OSError, zipfile.BadZipFile) as error:
            raise InputError(f"cannot be read from the archive: {error}") from error

    def header(self):
        return read_header(io.BytesIO(self.data()))

    def read(self):
        return decode(self.data())

    def fingerprint(self):
        return hashlib.sha256(self.data()).hexdigest()


@cache
def opened(path):
    """The archive, kept open; once a process, as sources go to others by their names."""
    return zipfile.ZipFile(path)


class ZippedRobot:
    """image-N.png, range-N.png (16-bit), lens.txt (seven numbers), path.txt (N tx ty tz qx qy qz qw), zipped."""

    def matches(self, root):
        """By the names in the archive."""
        return root.suffix == ".zip" and root.is_file() and "lens.txt" in opened(root).namelist()

    def open(self, root, camera_path):
        """The recording in the archive. Raises InputError."""
        names = opened(root).namelist()
        color, depth = (
            {frame_number(name): Member(root, name) for name in names if name.startswith(kind)}
            for kind in ("image-", "range-")
        )
        frames, notes, available = pair_by_number(root, color, depth)
        values = dict(zip(KEYS, map(float, opened(root).read("lens.txt").split()), strict=True))
        camera = read_camera_file(camera_path) if camera_path else make_camera(values, str(root), "lens.txt")
        return Sequence(root.stem, root, camera, frames, root, notes, available)

    def ground_truth(self, sequence):
        """What the robot's arm measured."""
        rows = [list(map(float, line.split())) for line in opened(sequence.root).read("path.txt").splitlines()]
        return from_rows({number / RATE_HZ: tuple(values) for number, *values in rows})
