"""Recordings of the Azure Kinect (k4arecorder): Matroska with colour, unregistered depth, and calibration.json."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.archive_path import ArchivePath
from miniloop_cli.datasets.block_source import FileBlock
from miniloop_cli.datasets.camera_files import azure_kinect
from miniloop_cli.datasets.camera_files.fields import Fields
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.matroska import MAGIC, Matroska, Track, read_matroska
from miniloop_cli.datasets.numbered import given_camera
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.stream import Stream
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import radial_tangential_lens
from miniloop_cli.scene.sequence import DepthCamera, Note, NoteKind, Sequence, Trajectory

DEPTH_SCALE = 1000.0
CALIBRATION = "calibration.json"
COLOR_KINDS = {"MJPG": "", "NV12": "nv12", "YUY2": "yuy2"}
DEPTH_KINDS = {"B16G": "b16g"}


class AzureKinect:
    """Azure Kinect .mkv: tracks COLOR and DEPTH, calibration.json; depth is registered to colour as it is read."""

    def matches(self, root: Path) -> bool:
        """By the suffix and the first bytes of a file."""
        if isinstance(root, ArchivePath) or root.suffix.lower() != ".mkv" or not root.is_file():
            return False
        with root.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in the file; nothing is decoded. Raises InputError naming what it lacks."""
        where = shown(root)
        try:
            video = read_matroska(root)
        except OSError as error:
            raise InputError(f"cannot read {where}: {error.strerror or error}") from error
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        color, depth = _track(where, video, "COLOR", COLOR_KINDS), _track(where, video, "DEPTH", DEPTH_KINDS)
        streams = _stream(root, video, color, COLOR_KINDS), _stream(root, video, depth, DEPTH_KINDS)
        pairs = pair(root, *streams)
        own, depth_camera = _cameras(where, video, color, depth)
        camera = given_camera(root, camera_path, pairs.frames, DEPTH_SCALE) or own
        T = depth_camera.T_color_depth
        text = f"depth is registered to colour by {CALIBRATION} ({1000 * np.linalg.norm(T[:3, 3]):.1f} mm apart)"
        notes = [*pairs.notes, Note(NoteKind.CONVERTED, text)]
        if video.cut_at is not None:
            text = f"{shown(root.name)} was cut off or is damaged at byte {video.cut_at}: the rest is not read"
            notes.insert(0, Note(NoteKind.DROPPED, text))
        return Sequence(
            root.stem,
            root,
            camera,
            pairs.frames,
            notes=tuple(notes),
            available=pairs.available,
            depth_camera=depth_camera,
            color_only=pairs.color_only,
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """None."""
        return None


def _track(where: str, video: Matroska, name: str, kinds: dict[str, str]) -> Track:
    found = [track for track in video.tracks if track.name.upper() == name]
    if len(found) != 1:
        names = ", ".join(f"{track.name or 'without name'} ({track.fourcc})" for track in video.tracks) or "none"
        raise InputError(
            f"{where} has no track {name}, as recordings of the Azure Kinect do; its tracks: {shown(names)}"
        )
    track = found[0]
    if track.fourcc not in kinds or track.encoded:
        what = f"compressed ({shown(track.fourcc)})" if track.encoded else shown(track.fourcc)
        raise InputError(
            f"{where}: track {name} is {what}; supported are {', '.join(kinds)}: give the file that k4arecorder wrote"
        )
    return track


def _stream(root: Path, video: Matroska, track: Track, kinds: dict[str, str]) -> Stream:
    blocks = [block for block in video.blocks if block.track == track.number]
    if not blocks:
        raise InputError(f"{shown(root)}: track {track.name} is empty")
    name = track.name.upper()
    sources = tuple(
        FileBlock(
            root, f"{name}/{block.time_ns}", block.offset, block.size, kinds[track.fourcc], track.width, track.height
        )
        for block in blocks
    )
    times = np.array([block.time_ns for block in blocks], float) / 1e9
    places = tuple(f"{name} at {t:.6f} s" for t in times.tolist())
    return Stream(f"track {name}", sources, places, times=times)


def _cameras(where: str, video: Matroska, color: Track, depth: Track) -> tuple[Camera, DepthCamera]:
    """The colour camera, and the depth camera with its pose. Raises InputError for missing entries."""
    data = video.attachments.get(video.tags.get("K4A_CALIBRATION_FILE", CALIBRATION)) or video.attachments.get(
        CALIBRATION
    )
    if not data:
        raise InputError(f"{where} has no {CALIBRATION} attached: the depth camera and its pose are not known")
    try:
        values = json.loads(data.rstrip(b"\0").decode("utf-8-sig"))
    except (ValueError, RecursionError):
        raise InputError(f"{where}: {CALIBRATION} is not JSON") from None
    if not isinstance(values, dict) or not azure_kinect.matches_raw(values):
        raise InputError(f"{where}: {CALIBRATION} has no CalibrationInformation")
    inside, size = f"{where}/{CALIBRATION}", (color.width, color.height)
    try:
        reading = azure_kinect.read_raw(Fields(values, inside, size))
        colored = make_camera(reading.values | {"depth_scale": DEPTH_SCALE}, inside, f"the recording's {CALIBRATION}")
        measured, T = azure_kinect.read_raw_depth(Fields(values, inside, (depth.width, depth.height)))
    except MiniloopError as error:
        raise InputError(str(error)) from None
    fx, fy, cx, cy = (float(measured[key]) for key in ("fx", "fy", "cx", "cy"))
    lens = radial_tangential_lens(*(measured[key] for key in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")))
    # Its lens may be invalid in the corners, where a wide field of view has no readings.
    camera = Camera(
        fx, fy, cx, cy, depth.width, depth.height, DEPTH_SCALE, lens, source=f"the recording's {CALIBRATION}"
    )
    return colored, DepthCamera(camera, tuple(T.ravel().tolist()))
