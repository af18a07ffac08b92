"""The numbers of an inspection in words, a line a subject."""

from __future__ import annotations

from collections.abc import Iterator

from miniloop_cli.inspection.findings import Numbers, interval


def describe(numbers: Numbers) -> Iterator[tuple[str, str]]:
    """(subject, text) lines, for the numbers that could be measured."""
    timing, camera = numbers["timing"], numbers["camera"]
    yield "recording", f"{numbers['sequence']}, {numbers['layout']} layout, {numbers['frames']} frames"
    model = camera["lens"]["model"]
    lens = {"pinhole": "no distortion", "radial-tangential": "with distortion"}.get(model, f"{model} lens")
    pinhole = " ".join(f"{camera[key]:.1f}" for key in ("fx", "fy", "cx", "cy"))
    yield (
        "camera",
        f"{pinhole}, {camera['width']} x {camera['height']}, {lens}, {camera['depth_scale']:g} units a metre",
    )
    yield "", camera["source"]
    paired = f"{numbers['frames']} pairs of {timing['color_images']} colour and {timing['depth_images']} depth images"
    delay = timing["depth_delay_ms"]
    late = "" if delay is None else f"; depth {abs(delay):.0f} ms {'after' if delay > 0 else 'before'} colour"
    yield "time", f"{paired} over {timing['duration_s']:.1f} s{late}; {len(timing['gaps'])} gaps"
    for note in numbers["notes"]:
        yield "", note
    if "images" in numbers:
        images = numbers["images"]
        near, middle, far = images["depth_m"]
        yield "depth", f"{near:.2f} to {far:.2f} m, median {middle:.2f} m; {_percent(images['holes'])} without reading"
        yield (
            "images",
            f"mean grey level {images['brightness']:.0f}, {_percent(images['saturated'])} white, "
            f"{_percent(images['blurred'])} of the frames blurred",
        )
    if "features" in numbers:
        features, pairs = numbers["features"], numbers["pairs"]
        yield "features", f"{features['median']:.0f} a frame (at most 1500), {features['with_depth']:.0f} with depth"
        yield (
            "overlap",
            f"{_percent(pairs['neighbours'])} of the sampled frames match a later one; {pairs['count']} pairs of "
            f"{pairs['matches']:.0f} matches, {pairs['flow_px']:.0f} px apart",
        )
    yield from _geometry(numbers)


def _geometry(numbers: Numbers) -> Iterator[tuple[str, str]]:
    found = numbers.get("registration")
    if found:
        x, y = found["shift_px"]
        words = {
            "registered": "depth is registered to colour",
            "shifted": f"depth fits the colour image when moved by ({x}, {y}) px",
            "enlarged": f"depth fits the colour image when scaled by {found['factor']:.2f}",
            "mirrored": "depth is a mirror image of colour",
            "late": f"depth fits the colour image {found['frames']:+d} frames away",
            "foreign": "depth fits no colour image nearby",
            "unknown": "cannot be seen",
        }
        yield "registration", words[found["kind"]]
    if (explained := numbers.get("explained", {}).get("median")) is not None:
        yield "motion", f"depth explains {_percent(explained)} of the matches"
    if "focal" in numbers:
        focal = numbers["focal"]
        yield "focal length", f"the scans fit {focal['px']:.0f} px{interval(focal)}"
    scales = []
    if numbers.get("truth", {}).get("pairs"):
        scales.append(f"{numbers['truth']['factor']:.2f} of the ground truth ({numbers['truth']['pairs']} pairs)")
    if numbers.get("disparity", {}).get("clarity", 0) > 0.5:
        scales.append(f"{numbers['disparity']['factor']:.2f} of a Kinect's, from the steps of its depth")
    if scales:
        yield "depth scale", "; ".join(scales)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
