"""Findings from the numbers of an inspection, each with advice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from miniloop_cli.geometry.camera import Trust

FEW_FEATURES = 150  # features with depth a frame
LEVELS = ("problem", "warning", "note")
Numbers = dict[str, Any]


@dataclass(frozen=True)
class Finding:
    """`problem`: poses may be wrong or missing; `warning`: results may be worse; `note`: for information."""

    level: str
    code: str
    message: str
    advice: str


def all_findings(numbers: Numbers) -> tuple[Finding, ...]:
    """Every finding, most severe first. Numbers that could not be measured give none."""
    found = [finding for check in CHECKS for finding in check(numbers)]
    return tuple(sorted(found, key=lambda finding: LEVELS.index(finding.level)))


def _broken(numbers: Numbers) -> Iterator[Finding]:
    broken = numbers["broken"]
    if broken:
        share = len(broken) / numbers["frames"]
        first = f"frame {broken[0]['frame']}: {broken[0]['reason']}"
        yield Finding(
            "problem" if share > 0.2 else "warning",
            "broken-frames",
            f"{len(broken)} of {numbers['frames']} frames cannot be used, the first: {first}",
            "copy or convert them again; they are skipped and the rest is used",
        )


def _timing(numbers: Numbers) -> Iterator[Finding]:
    timing = numbers["timing"]
    if timing["paired"] < 0.9:
        yield Finding(
            "warning",
            "association",
            f"only {100 * timing['paired']:.0f} % of the images have a partner within 20 ms, or with their number "
            f"({timing['color_images']} colour, {timing['depth_images']} depth)",
            "check that both tables are of this recording and use one clock; remove a constant offset",
        )
    if timing["gaps"]:
        longest = timing["gaps"][0]
        yield Finding(
            "warning",
            "gaps",
            f"{len(timing['gaps'])} gap(s) in time, the longest {longest['length_s']:.1f} s after frame "
            f"{longest['after_frame']}",
            "the parts are joined only if they see the same place; otherwise register each one separately",
        )


def _images(numbers: Numbers) -> Iterator[Finding]:
    images = numbers.get("images")
    if not images:
        return
    if images["holes"] > 0.6:
        yield Finding(
            "problem" if images["holes"] > 0.9 else "warning",
            "holes",
            f"{100 * images['holes']:.0f} % of the pixels have no depth",
            "stay within the range of the sensor; avoid sunlight, glass and black or shiny surfaces",
        )
    if images["saturated"] > 0.25 or images["brightness"] > 220:
        yield Finding(
            "warning", "over-exposed", f"{100 * images['saturated']:.0f} % of the pixels are white",
            "lower the exposure, or fix it before recording",
        )  # fmt: skip
    if images["brightness"] < 35 or images["dark"] > 0.6:
        yield Finding(
            "warning", "dark", f"the images are dark (mean grey level {images['brightness']:.0f} of 255)",
            "add light or raise the exposure; try --set features.contrast=0.01",
        )  # fmt: skip
    if (
        images["blurred"] > 0.3 and numbers.get("features", {}).get("with_depth", 0) >= FEW_FEATURES
    ):  # else the difference is noise
        yield Finding(
            "warning", "blur", f"{100 * images['blurred']:.0f} % of the frames are much less sharp than the others",
            "move more slowly or shorten the exposure",
        )  # fmt: skip
    near, middle, _ = images["depth_m"]
    if middle > 12 or 0 < middle < 0.35:
        yield Finding(
            "warning",
            "depth-range",
            f"the median depth is {middle:.2f} m (from {near:.2f} m on), unusual for such sensors",
            f"check depth_scale, now {numbers['camera']['depth_scale']:g} units a metre (TUM 5000, millimetres 1000)",
        )


def _no_reading(numbers: Numbers) -> Iterator[Finding]:
    for found in numbers.get("no_reading", ()):
        yield Finding(
            "warning",
            "no-reading",
            f"{100 * found['share']:.2g} % of the pixels hold the depth {found['value']:g} ({found['m']:.2f} m), far "
            "from all other depths: this value is read as missing depth",
            "do nothing if the sensor marks missing depth by this value; if a surface is there, store 0 for missing "
            "depth",
        )


def _features(numbers: Numbers) -> Iterator[Finding]:
    if "features" in numbers and numbers["features"]["with_depth"] < FEW_FEATURES:
        yield Finding(
            "problem" if numbers["features"]["with_depth"] < 40 else "warning",
            "few-features",
            f"only {numbers['features']['with_depth']:.0f} features a frame have depth",
            "give the scene texture (posters, newspapers) or light; try --set features.contrast=0.005",
        )
    pairs = numbers.get("pairs")
    if pairs and numbers["frames"] > 1 and pairs["neighbours"] < 0.7:
        yield Finding(
            "problem" if pairs["neighbours"] < 0.3 else "warning",
            "little-overlap",
            f"{100 * (1 - pairs['neighbours']):.0f} % of the sampled frames do not match the frame after them",
            "record more slowly or keep more frames; neighbouring frames should share half of their view",
        )
    if pairs and pairs["count"] and pairs["flow_px"] < 2:
        yield Finding(
            "note", "still", f"the camera hardly moves ({pairs['flow_px']:.1f} px between the compared frames)",
            "depth scale, focal length and registration of the depth cannot be checked without motion",
        )  # fmt: skip


def _registration(numbers: Numbers) -> Iterator[Finding]:
    found = numbers.get("registration")
    if not found:
        return
    explained = (numbers.get("explained") or {}).get("median")
    kind, sentence = found["kind"], found["sentence"]
    register = (
        "register depth to colour first, with the calibration of both cameras (most drivers and Open3D can); without "
        "one, name a depth camera in camera.yaml, and `miniloop register` estimates it (docs/calibration.md)"
    )
    if kind in ("shifted", "enlarged"):
        yield Finding("problem", "unregistered-depth", sentence, register)
    elif kind == "mirrored":
        yield Finding(
            "problem", "mirrored-depth", sentence, "flip the depth images (or the colour images) before use"
        )  # fmt: skip
    elif kind == "late":
        yield Finding("problem", "swapped-depth", sentence, "correct the stamps of one of the tables by that time")
    elif kind == "foreign":
        certain = explained is None or explained < 0.7
        yield Finding(
            "problem" if certain else "warning", "swapped-depth",
            sentence
            + (f", and depth explains {100 * explained:.0f} % of the motion" if explained is not None else ""),
            "check that the tables pair the right images, that no files are swapped or mirrored, and that depth is "
            "registered to colour",
        )  # fmt: skip
    elif kind == "unknown":
        yield Finding(
            "note", "registration-unknown", "these images do not show whether depth is registered to colour",
            "do nothing, or record a scene with objects in front of others, which shows it",
        )  # fmt: skip
    odd = (numbers.get("explained") or {}).get("odd_frames") or []
    if kind in ("registered", "unknown") and explained is not None:
        if odd and explained > 0.6 and not numbers.get("focal", {}).get("contradicts"):
            some = ", ".join(map(str, odd[:8])) + (", ..." if len(odd) > 8 else "")
            yield Finding(
                "warning", "swapped-depth", f"the depth of some frames does not fit their colour: {some}",
                "look at these frames: their depth images may be those of other frames",
            )  # fmt: skip
        elif explained < 0.5 and not numbers.get("focal", {}).get("contradicts"):
            yield Finding(
                "problem", "inconsistent-depth",
                f"depth explains only {100 * explained:.0f} % of the motion that colour shows",
                "check that depth belongs to these images and is registered to them, and that little moves except "
                "the camera",
            )  # fmt: skip


def _camera(numbers: Numbers) -> Iterator[Finding]:
    if numbers["camera"]["trust"] == Trust.GUESS:
        yield Finding(
            "warning", "camera-unknown", f"the camera is a guess: {numbers['camera']['source']}",
            "`miniloop register` estimates the camera from the recording; `miniloop calibrate` writes it to a file "
            "for other recordings of this device (docs/calibration.md); a calibration with a board is more accurate",
        )  # fmt: skip
    sound = numbers.get("registration", {}).get("kind") in ("registered", "unknown")
    focal = numbers.get("focal", {})
    if sound and focal.get("contradicts"):
        yield Finding(
            "problem", "wrong-camera",
            f"the scans fit a focal length of {focal['px']:.0f} px{interval(focal)}, "
            f"not {numbers['camera']['fx']:.0f} px",
            "use the calibration of this camera at this image size (--camera FILE), then inspect again",
        )  # fmt: skip


def interval(focal: Numbers) -> str:
    """The 90 % interval in words, or that the search ended before the focal length was bracketed."""
    return focal["beyond"] or f" ({focal['low_px']:.0f} to {focal['high_px']:.0f})"


def _depth_scale(numbers: Numbers) -> Iterator[Finding]:
    scale = numbers["camera"]["depth_scale"]
    truth, disparity = numbers.get("truth", {}), numbers.get("disparity", {})
    if "problem" in truth:
        yield Finding(
            "warning", "ground-truth", f"the ground truth cannot be read: {truth['problem']}",
            "`miniloop register` does not need it; `miniloop eval` does",
        )  # fmt: skip
    if numbers.get("focal", {}).get("contradicts"):
        return  # a wrong focal length also changes distances, so it is reported first
    if truth.get("pairs", 0) >= 5:
        registered = numbers.get("registration", {}).get("kind") in ("registered", "unknown")
        if registered and _off(truth["factor"]) and (truth["low"] > 1.04 or truth["high"] < 0.96):
            yield Finding(
                "problem", "depth-scale",
                f"distances are {truth['factor']:.2f} times those of the ground truth ({truth['pairs']} pairs)",
                f"depth_scale should be about {scale * truth['factor']:.0f} instead of {scale:g} units a metre",
            )  # fmt: skip
    elif factor := disparity.get("too_large_by"):
        yield Finding(
            "problem" if not 1 / 1.7 < factor < 1.7 else "warning", "depth-scale",
            f"depth seems {factor:.2f} times too large: its steps are those of a Kinect or Xtion at another scale",
            f"if it is such a sensor, depth_scale should be about {scale * factor:.0f} instead of {scale:g}",
        )  # fmt: skip


def _off(factor: float) -> bool:
    return not 1 / 1.1 < factor < 1.1


CHECKS = (_broken, _timing, _images, _no_reading, _features, _registration, _camera, _depth_scale)
