"""Record3D exports: rgb/, depth/ (16-bit PNG, millimetres, lower resolution) and metadata.json with ARKit's poses."""

from __future__ import annotations

from pathlib import Path

from miniloop_cli.datasets.beside import confidence_maps
from miniloop_cli.datasets.confidence import with_confidence
from miniloop_cli.datasets.numbered import given_camera, read_json
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import DEPTH_SUFFIXES, IMAGE_SUFFIXES, shown
from miniloop_cli.datasets.record3d import cameras, clock, poses_of, timed, too_few_times
from miniloop_cli.datasets.stream import named_stream
from miniloop_cli.scene.sequence import DepthFormat, Note, Sequence, Trajectory


class Record3D:
    """Record3D: rgb/, depth/ (16-bit PNG, millimetres), metadata.json."""

    def matches(self, root: Path) -> bool:
        """By the names of its files and folders."""
        return all((root / name).exists() for name in ("rgb", "depth", "metadata.json"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`. Raises InputError."""
        color, depth = named_stream(root, "rgb", IMAGE_SUFFIXES), named_stream(root, "depth", DEPTH_SUFFIXES)
        path = root / "metadata.json"
        data = read_json(path) if path.exists() else {}
        rate_hz, times_s = clock(data, shown(path))
        notes: tuple[Note, ...] = ()
        maps, where, beside = confidence_maps(root, depth)
        if times_s is not None:
            color, depth, notes = timed(color, times_s), timed(depth, times_s), too_few_times(color, times_s)
        found = pair(root, color, depth, rate_hz=rate_hz)
        frames = found.frames
        camera = given_camera(root, camera_path, frames)
        if camera is None:
            camera, own = cameras(data, shown(path), color, path.name)
            frames, said = with_own_cameras(frames, own, camera)
            notes = (*notes, *said)
        frames, trusted = with_confidence(frames, maps, where)
        notes = (*found.notes, *notes, *trusted, *beside)
        form, truth = DepthFormat(resample=True), path if path.exists() else None
        return Sequence(root.name, root, camera, frames, truth, notes, found.available, form)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's poses: a reference, not the truth."""
        path = sequence.ground_truth_path
        return None if path is None else poses_of(read_json(path), shown(path))
