"""Files beside the images that the reader does not use, each reported in a note."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path

from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.stamps import Unit
from miniloop_cli.datasets.stream import Stream, named_stream
from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import Note, NoteKind

CAMERA_FILES = (
    "calib*",
    "cam*.yaml",
    "cam*.yml",
    "cam*.json",
    "cam*.xml",
    "cam*.txt",
    "*camera_info*",
    "*camera_matrix*",
    "*intrinsic*",
    "k.txt",
    "scene_camera.json",
    "transforms*.json",
    "*.pincam",
)
OTHERWISE = ("traj", "pose")  # files with these names hold no camera
CONFIDENCE = ("confidence", "conf")
SHOWN = 3


def unused_cameras(root: Path, used: str, guessed: bool) -> tuple[Note, ...]:
    """A note on files that look like cameras; `used` is the one that was read, if any.

    If the camera is `guessed`, the note has a kind that is always shown.
    """
    found = [path for path in sorted(root.iterdir()) if path.name != used and _looks_like_camera(path)]
    if not found:
        return ()
    some = shown(", ".join(path.name + "/" * path.is_dir() for path in found[:SHOWN]) + ", ..." * (len(found) > SHOWN))
    text = (
        f"{some} seem{'s' * (len(found) == 1)} to describe the camera and {'is' if len(found) == 1 else 'are'} not read"
    )
    if guessed:
        return (Note(NoteKind.ASSUMED, f"{text}, while the camera used is a guess; give the right one with --camera"),)
    return (Note(NoteKind.UNUSED, f"{text}; to use it, give it with --camera"),)


def _looks_like_camera(path: Path) -> bool:
    name = path.name.lower()
    if not any(fnmatch(name, pattern) for pattern in CAMERA_FILES) or any(word in name for word in OTHERWISE):
        return False
    inside = path.iterdir() if path.is_dir() else ()
    return path.is_file() or any(child.suffix.lower() in (".yaml", ".yml", ".json", ".txt") for child in inside)


def confidence_maps(
    root: Path, depth: Stream, where: str = ".", unit: Unit | None = None
) -> tuple[dict[ImageSource, ImageSource], str, tuple[Note, ...]]:
    """Confidence images by the depth image of equal number or time, the name of their folder, and notes."""
    folder = next((name for name in CONFIDENCE if (root / where / name).is_dir()), None)
    if folder is None:
        return {}, "", ()
    inside = folder if where == "." else f"{where}/{folder}"
    try:
        maps = named_stream(root, inside, (".png",), unit)
    except InputError as error:
        return {}, "", (Note(NoteKind.UNUSED, f"{inside}/ is not used, depth of low confidence is kept: {error}"),)
    known = dict(zip(_keys(maps), maps.sources, strict=True))
    keys = zip(_keys(depth), depth.sources, strict=True)
    return {image: known[key] for key, image in keys if key in known}, f"{inside}/", maps.notes


def _keys(stream: Stream) -> list[float]:
    keys = stream.numbers if stream.numbers is not None else stream.times
    return [] if keys is None else [float(key) for key in keys.tolist()]


def unused_confidence(root: Path) -> tuple[Note, ...]:
    """A note on a folder of confidence images of an unsupported kind."""
    folder = next((name for name in CONFIDENCE if (root / name).is_dir()), None)
    if folder is None:
        return ()
    return (Note(NoteKind.UNUSED, f"{folder}/ is not used: depth of low confidence is kept"),)


def unused_associations(names: list[str]) -> tuple[Note, ...]:
    """A note on association files that are not used, as both tables exist."""
    if not names:
        return ()
    return (Note(NoteKind.UNUSED, f"{shown(names[0])} is not used: rgb.txt and depth.txt name all images"),)
