"""Single images to locate in a map: files, folders of them, recordings; their cameras by EXIF."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.open import open_sequence, recognise
from miniloop_cli.datasets.paths import IMAGE_SUFFIXES, shown
from miniloop_cli.datasets.read import read_color, read_depth, read_scan
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Scan

FULL_FRAME_MM = 36.0  # width of the film that EXIF's equivalent focal lengths refer to
USUAL_FOCAL = 0.8  # of the longer side; between phones (0.75) and depth cameras (0.82 to 0.95)
FOCAL_35MM, EXIF = 0xA405, 0x8769


@dataclass(frozen=True)
class SingleImage:
    """One image: its `name` in messages, its file, its depth, and its camera, if known."""

    name: str
    path: Path
    depth: Path | None = None


def listed_images(paths: Sequence[Path], depth: Path | None) -> list[SingleImage]:
    """The images of files and folders, in the given order, those of a folder by name.

    `depth`: a file for a single image, or a folder whose files have the names of the images (except the suffix).
    Raises InputError for missing paths, a folder without images, an image without its depth.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
            if not inside:
                raise InputError(f"{shown(path)} holds no images ({', '.join(IMAGE_SUFFIXES)})")
            found += inside
        elif path.is_file():
            found.append(path)
        else:
            raise InputError(f"{shown(path)} does not exist")
    if depth is None:
        return [SingleImage(str(path), path) for path in found]
    if depth.is_file():
        if len(found) != 1:
            raise InputError(f"{shown(depth)} is the depth of one image, and {len(found)} are given; give a folder")
        return [SingleImage(str(found[0]), found[0], depth)]
    if not depth.is_dir():
        raise InputError(f"{shown(depth)} does not exist")
    partners = {file.stem: file for file in depth.iterdir()}
    for path in found:
        if path.stem not in partners:
            raise InputError(f"{shown(depth)} has no file {shown(path.stem)}.* for {shown(path)}")
    return [SingleImage(str(path), path, partners[path.stem]) for path in found]


def is_recording(path: Path) -> bool:
    """Whether a folder or file is a recording."""
    return recognise(path) is not None


def recorded_images(path: Path, camera: Path | None) -> tuple[Camera, Iterator[tuple[str, Scan | InputError]]]:
    """The camera of a recording, and its frames with depth one after the other; errors for unreadable ones."""
    sequence = open_sequence(path, None, camera)

    def frames() -> Iterator[tuple[str, Scan | InputError]]:
        for k, frame in enumerate(sequence.frames):
            try:
                yield frame.color.name, read_scan(sequence, k)
            except InputError as error:
                yield frame.color.name, error

    return sequence.camera, frames()


def read_single(image: SingleImage, depth_scale: float) -> Scan:
    """Colour, turned upright, and depth in metres, 0 without. Raises InputError naming the file."""
    where = image.path
    try:
        color = read_color(ImageFile(image.path, upright=True))
        depth_m = np.zeros(color.shape[:2], np.float32)
        if image.depth:
            where = image.depth
            depth_m = read_depth(ImageFile(image.depth)).astype(np.float32) / np.float32(depth_scale)
            if depth_m.shape != color.shape[:2]:
                raise InputError(f"depth has {depth_m.shape} pixels, colour {color.shape[:2]}; it must be registered")
    except InputError as error:
        raise InputError(f"{shown(where)}: {error}") from None
    return Scan(color, depth_m)


def guessed_camera(path: Path, width: int, height: int) -> Camera:
    """A pinhole with a rough focal length: from the EXIF data of an image file, else the usual one."""
    focal_35mm = _focal_35mm(path)
    longer = max(width, height)
    focal = longer * (focal_35mm / FULL_FRAME_MM if focal_35mm else USUAL_FOCAL)
    source = f"EXIF: {focal_35mm:g} mm on 35 mm film" if focal_35mm else "guessed, as no file states the focal length"
    return Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height, source=source)


def _focal_35mm(path: Path) -> float | None:
    """The focal length equivalent to 35 mm film, from EXIF; None without it, or if it cannot be read."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            value = image.getexif().get_ifd(EXIF).get(FOCAL_35MM)
    except Exception:
        return None  # damaged EXIF data are ignored
    return float(value) if isinstance(value, int) and 5 <= value <= 500 else None
