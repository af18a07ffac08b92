"""Measure a recording: the numbers for the findings, from a sample of frames and pairs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from miniloop_cli.datasets import read_ground_truth, read_scan
from miniloop_cli.datasets.depth_values import sample_depth
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.read import check_headers
from miniloop_cli.datasets.sensor_steps import KINECT_STEP_PER_M, disparity_step, too_large_by
from miniloop_cli.errors import InputError
from miniloop_cli.inspection import findings
from miniloop_cli.inspection.findings import Finding
from miniloop_cli.inspection.images import frame_numbers
from miniloop_cli.inspection.pairs import FeatureCache, MatchedPair, match_frames, matched_pairs, resection
from miniloop_cli.inspection.registration import Reader, registration_of, sampled
from miniloop_cli.inspection.scale import fit_focal, scale_against_truth
from miniloop_cli.inspection.timing import timing
from miniloop_cli.scene.sequence import Scan, Sequence

ANCHORS, MAX_FITTED = 16, 30
ODD = 0.2  # a frame is odd if its depth explains less than that of the others by so much


@dataclass(frozen=True)
class Inspection:
    """The measurements (JSON-able) and the findings, most severe first."""

    numbers: dict[str, Any]
    findings: tuple[Finding, ...]

    def as_json(self) -> dict[str, Any]:
        """Numbers and findings in one object."""
        return self.numbers | {"findings": [asdict(finding) for finding in self.findings]}


def inspect(sequence: Sequence, rng: Generator, read: Reader = read_scan) -> Inspection:
    """Inspect a recording: all stamps and image headers, a sample of about 24 frames and 30 pairs."""
    numbers: dict[str, Any] = {
        "sequence": shown(sequence.name),
        "layout": sequence.layout,
        "frames": len(sequence.frames),
        "camera": asdict(sequence.camera)
        | {"lens": {"model": sequence.camera.lens.model} | sequence.camera.lens.named},
        "notes": [str(note) for note in sequence.notes],
        "timing": timing(sequence),
        "no_reading": _no_reading(sequence),
    }
    broken = _broken_headers(sequence)
    sample: dict[int, Scan] = {}
    for index in sampled(sequence):
        try:
            sample[index] = read(sequence, index)
        except InputError as error:
            broken[index] = str(error)
    numbers["broken"] = [{"frame": index, "reason": reason} for index, reason in sorted(broken.items())]
    numbers["sampled"] = len(sample)
    if sample:
        numbers["images"] = _images(sample)
        numbers["registration"] = _registration(sequence, sample, read)
        numbers |= _geometry(sequence, sample, rng, read)
    return Inspection(numbers, findings.all_findings(numbers))


def _no_reading(sequence: Sequence) -> list[dict[str, float]]:
    """Stored values that mean "no reading", in metres, and the share of the pixels with them."""
    if not sequence.depth_format.no_reading_found:
        return []
    sample = sample_depth(sequence)
    pixels = sum(stored.size for stored in sample)
    return [
        {
            "value": value,
            "m": value / sequence.camera.depth_scale,
            "share": sum(int((stored == np.asarray(value, stored.dtype)).sum()) for stored in sample) / pixels,
        }
        for value in sequence.depth_format.no_reading
    ]


def _broken_headers(sequence: Sequence) -> dict[int, str]:
    """Frames whose images are missing, of the wrong kind or of the wrong size, from the headers of all of them."""
    broken = {}
    for index in range(len(sequence.frames)):
        try:
            check_headers(sequence, index)
        except InputError as error:
            broken[index] = str(error)
    return broken


def _images(sample: dict[int, Scan]) -> dict[str, Any]:
    each = [frame_numbers(scan) for scan in sample.values()]
    sharpness = np.array([frame.sharpness for frame in each])
    return {
        "holes": float(np.median([frame.holes for frame in each])),
        "depth_m": np.median([frame.depth_m for frame in each], axis=0).tolist(),
        "blurred": float((sharpness < 0.5 * np.quantile(sharpness, 0.75)).mean()),
        "brightness": float(np.median([frame.brightness for frame in each])),
        "saturated": float(np.median([frame.saturated for frame in each])),
        "dark": float(np.median([frame.dark for frame in each])),
    }


def _registration(sequence: Sequence, sample: dict[int, Scan], read: Reader) -> dict[str, Any]:
    verdict = registration_of(sequence, sample, read)
    return asdict(verdict.agreement) | {
        "kind": verdict.kind,
        "shift_px": list(verdict.shift_px),
        "factor": verdict.factor,
        "frames": verdict.frames,
        "sentence": verdict.sentence(),
    }


def _geometry(sequence: Sequence, sample: dict[int, Scan], rng: Generator, read: Reader) -> dict[str, Any]:
    camera = sequence.camera
    cache = FeatureCache(lambda index: sample[index] if index in sample else read(sequence, index), camera)
    anchors = 2 * ANCHORS if len(sequence.frames) <= 3 * ANCHORS else ANCHORS
    pairs = matched_pairs(cache, len(sequence.frames), anchors)
    found = [features for features in cache.found.values() if features]
    numbers: dict[str, Any] = {
        "features": {
            "median": float(np.median([len(f) for f, _ in found])) if found else 0.0,
            "with_depth": float(np.median([f.with_depth for f, _ in found])) if found else 0.0,
        },
        "pairs": {
            "count": len(pairs),
            "matches": float(np.median([len(p.px_i) for p in pairs])) if pairs else 0.0,
            "flow_px": float(np.median([p.flow_px for p in pairs])) if pairs else 0.0,
            "neighbours": len({pair.i for pair in pairs}) / max(min(anchors, len(sequence.frames) - 1), 1),
        },
        "explained": _explained(sequence, cache, pairs),
    }
    moving = [pair for pair in pairs if pair.flow_px > 0.02 * camera.width]
    focal = fit_focal(moving[:: len(moving) // MAX_FITTED + 1], camera, rng)
    if focal:
        px = camera.fx * np.array([focal.factor, focal.low, focal.high])
        numbers["focal"] = {"factor": focal.factor, "gain": focal.gain, "contradicts": focal.contradicts}
        numbers["focal"]["beyond"] = focal.beyond
        numbers["focal"] |= dict(zip(("px", "low_px", "high_px"), px.tolist(), strict=True))
    step, clarity = disparity_step([scan.depth_m for scan in sample.values()])
    numbers["disparity"] = {"step_per_m": step, "clarity": clarity, "factor": KINECT_STEP_PER_M / step if step else 0.0}
    numbers["disparity"]["too_large_by"] = too_large_by(step, clarity)
    try:
        truth = read_ground_truth(sequence) if focal else None
    except InputError as error:
        numbers["truth"] = {"problem": str(error)}
        return numbers
    if truth and focal:
        stamps = [frame.timestamp_s for frame in sequence.frames]
        low, middle, high, count = scale_against_truth(focal, stamps, truth)
        if count:
            numbers["truth"] = {"factor": middle, "low": low, "high": high, "pairs": count}
    return numbers


def _explained(sequence: Sequence, cache: FeatureCache, pairs: list[MatchedPair]) -> dict[str, Any]:
    """The share of the matches of one colour motion that the depth of a frame explains, and the frames where it is low.

    A frame with a low share is compared with more neighbours before it is reported. Blur and fast motion affect both
    frames of a pair; the depth is wrong only if the depth of the other frame explains the same matches.
    """
    shares: dict[int, list[float]] = {}
    behind: dict[int, list[float]] = {}  # share explained by the depth of the other frame minus that of the frame

    def add(pair: MatchedPair | None) -> None:
        if pair is None:
            return
        one, other = (resection(p, sequence.camera)[1] for p in (pair, pair.reversed()))
        for index, share, gap in ((pair.i, one, other - one), (pair.j, other, one - other)):
            if np.isfinite(share):
                shares.setdefault(index, []).append(share)
            if np.isfinite(gap):
                behind.setdefault(index, []).append(gap)

    for pair in pairs:
        add(pair)
    if not shares:
        return {"median": None, "odd_frames": []}
    each = np.array([np.median(values) for values in shares.values()])
    middle = float(np.median(each))
    limit = middle - max(ODD, 5 * float(np.median(np.abs(each - middle))))
    for index in [index for index, values in shares.items() if np.median(values) < limit]:
        for other in (index - 2, index - 1, index + 1, index + 2):
            if 0 <= other < len(sequence.frames):
                add(match_frames(cache, index, other))
    odd = [
        index
        for index, values in sorted(shares.items())
        if len(values) > 1 and np.median(values) < limit and np.median(behind.get(index, [0.0])) > ODD
    ]
    return {"median": middle, "odd_frames": odd}
