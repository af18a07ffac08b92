"""Stage: points are tracked through a recording whose frames follow each other closely."""

from __future__ import annotations

import logging
from itertools import pairwise
from typing import Any

import numpy as np

from miniloop_cli.config import Depth, Tracking
from miniloop_cli.runtime.artifact_store import Arrays
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.scene.tracked import Tracked, TrackedPart, TrackStatus
from miniloop_cli.stages.artifacts import PROBED, TRACKED
from miniloop_cli.stages.run import Run
from miniloop_cli.tracking.frames import may_be_keyframe
from miniloop_cli.tracking.front_end import track_part

LOG = logging.getLogger("miniloop")
PART = 96  # frames an artefact, at most lost by a killed run
MIN_FRAMES = 150  # fewer are all matched with each other
MAX_STEP_S = 0.12  # median time between frames
PROBES, PROBE_LENGTH = 10, 4  # places that are tried, and frames at each
MIN_FOLLOWED_SHARE = 0.5  # of the frames there that are not blank
How = tuple[Sequence, Depth, Tracking]


def track(sequence: Sequence, depth: Depth, settings: Tracking, run: Run) -> Tracked | None:
    """Tracking of all frames of a recording; None if every frame is a scan.

    The frames include colour images without depth, as in `Sequence.with_color_only`.
    """
    if len(sequence.frames) < 3 or settings.enabled is False:
        return None
    if settings.enabled == "auto" and not _close((sequence, depth, settings), run):
        return None
    sequence, _ = sequence.with_color_only()
    n, how = len(sequence.frames), (sequence, depth, settings)
    parts = list(pairwise(_ends(sequence)))
    keys = [run.store.key(TRACKED, _inputs(how, part)) for part in parts]
    found = {part: run.store.load(TRACKED, key) for part, key in zip(parts, keys, strict=True)}
    missing = [part for part in parts if found[part] is None]
    made = run.workers.spread(track_arrays, how, missing, "following points", len(missing))
    for part, arrays in zip(missing, made, strict=True):
        found[part] = dict(arrays)
        run.store.save(TRACKED, keys[parts.index(part)], arrays)
    tracked = Tracked.of([TrackedPart.from_arrays(arrays) for arrays in found.values() if arrays is not None])
    if len(tracked.keyframes) < 2:  # nearly no frame is usable: as scans, each gets its reason
        return None
    LOG.info("%d frames follow each other closely: %d are keyframes", n, len(tracked.keyframes))
    return tracked


def _ends(sequence: Sequence) -> list[int]:
    """Frames at which the recording is cut into parts: a keyframe of both."""
    last = len(sequence.frames) - 1
    even = np.round(np.linspace(0, last, int(np.ceil(last / PART)) + 1)).astype(int).tolist()
    inner = [next((f for f in range(a, b) if may_be_keyframe(sequence, f)), a) for a, b in pairwise(even[1:])]
    return [0, *inner, last]


def _close(how: How, run: Run) -> bool:
    """Whether points can be followed from frame to frame, tried at a few places of the recording."""
    frames = how[0].frames
    steps_s = np.diff([frame.timestamp_s for frame in frames])
    if len(frames) < MIN_FRAMES or np.median(steps_s) > MAX_STEP_S:
        return False
    starts = np.linspace(0, len(frames) - PROBE_LENGTH, PROBES).astype(int).tolist()
    probes = [(start, start + PROBE_LENGTH - 1) for start in starts]

    def tried() -> Arrays:
        parts = run.workers.map(lambda probe: track_part(*how, *probe), probes, "looking how frames follow", PROBES)
        return {"inner": np.concatenate([part.status[1:-1] for part in parts])}

    inner = run.store.cached(PROBED, [_inputs(how, probe) for probe in probes], tried)["inner"]
    shown = np.isin(inner, (TrackStatus.FOLLOWED, TrackStatus.KEYFRAME))
    return bool((inner == TrackStatus.FOLLOWED).sum() >= max(MIN_FOLLOWED_SHARE * shown.sum(), 1))


def track_arrays(how: How, part: tuple[int, int]) -> Arrays:
    """The arrays of one part for the cache."""
    return track_part(*how, *part).arrays()


def _inputs(how: How, part: tuple[int, int]) -> Any:
    """All inputs of the result for the frames first..last."""
    sequence, depth, settings = how
    frames = sequence.frames[part[0] : part[1] + 1]
    files = [[source.fingerprint() for source in (f.color, f.depth, f.mask) if source] for f in frames]
    stamps_s = [frame.timestamp_s for frame in frames]
    cameras = (sequence.camera, [frame.camera for frame in frames])
    chosen = settings.model_dump(exclude={"enabled"})  # the result does not depend on it
    own = (sequence.depth_camera,) if sequence.depth_camera else ()
    return files, stamps_s, depth, chosen, cameras, sequence.depth_format, part, *own
