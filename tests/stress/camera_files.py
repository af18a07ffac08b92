"""Random camera files of every known format: `python tests/stress/camera_files.py [FILES] [SEED]`.

A random camera is written in a random format, and the file is then left alone, changed in ways that do not matter
(comments, line ends, order of keys), or damaged (a key misspelt, removed or added, a value replaced, bytes changed).
Untouched files must be read to the last digit. Of the others, each must be refused by a MiniloopError of one line, or
be read as an independent parser reads it (ruamel.yaml, which knows YAML 1.2; json; a regular expression for XML).
Those that are not are printed.
"""

import json
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

sys.path.append(str(Path(__file__).parents[2]))

NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
Numbers = list[float]


class Truth(NamedTuple):
    """A camera: fx fy cx cy width height as written in the file, and the coefficients in the format's order."""

    pinhole: Numbers
    size: Numbers
    lens: Numbers
    fisheye: bool = False


class Kind(NamedTuple):
    """A format: coefficients that it may have, the writer, and the reader of what a parser found."""

    suffix: str
    counts: tuple[int, ...]
    write: Callable[[Truth], str]
    extract: Callable[[Any], Truth]
    shift: float = 0.0  # from the file's principal point to ours


def number(value: float) -> str:
    """A number as some program may write it."""
    return repr(value) if value != int(value) else str(int(value))


def matrix(t: Truth) -> Numbers:
    fx, fy, cx, cy = t.pinhole
    return [fx, 0, cx, 0, fy, cy, 0, 0, 1]


def listed(values: Numbers) -> str:
    return "[" + ", ".join(map(number, values)) + "]"


def own(t: Truth) -> str:
    keys = ("fx", "fy", "cx", "cy", "width", "height")
    lines = [f"{key}: {number(v)}" for key, v in zip(keys, t.pinhole + t.size, strict=True)] + ["depth_scale: 1000"]
    names = ("k1", "k2", "k3", "k4") if t.fisheye else NAMES
    lines += [f"{key}: {number(v)}" for key, v in zip(names, t.lens, strict=False)]
    return "\n".join([*lines, "lens: fisheye" if t.fisheye else "lens: radial-tangential"]) + "\n"


def from_own(d: Any) -> Truth:
    fisheye = d.get("lens") == "fisheye"
    names = ("k1", "k2", "k3", "k4") if fisheye else NAMES
    size = [d["width"], d["height"]]
    return Truth([d[k] for k in ("fx", "fy", "cx", "cy")], size, [d.get(k, 0) for k in names], fisheye)


def orb(t: Truth) -> str:
    keys = ("fx", "fy", "cx", "cy", *(("k1", "k2", "k3", "k4") if t.fisheye else ("k1", "k2", "p1", "p2", "k3")))
    lines = ["%YAML:1.0", "", f'Camera.type: "{"KannalaBrandt8" if t.fisheye else "PinHole"}"']
    lines += [f"Camera1.{key}: {number(v)}" for key, v in zip(keys, t.pinhole + t.lens, strict=False)]
    lines += [f"Camera.width: {number(t.size[0])}", f"Camera.height: {number(t.size[1])}", "Camera.fps: 30.0"]
    return "\n".join([*lines, "RGBD.DepthMapFactor: 1000.0", "ORBextractor.nLevels: 8"]) + "\n"


def from_orb(d: Any) -> Truth:
    fisheye = str(d.get("Camera.type", "pinhole")).lower() == "kannalabrandt8"
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    lens = [d.get(f"Camera1.{k}", 0) for k in names]
    pinhole = [d[f"Camera1.{k}"] for k in ("fx", "fy", "cx", "cy")]
    return Truth(pinhole, [d["Camera.width"], d["Camera.height"]], lens, fisheye)


def opencv_yaml(t: Truth) -> str:
    text = f"%YAML:1.0\n---\nimage_width: {number(t.size[0])}\nimage_height: {number(t.size[1])}\n"
    for key, values, rows in (("camera_matrix", matrix(t), 3), ("distortion_coefficients", t.lens, 1)):
        if values:
            columns = len(values) // rows
            text += (
                f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: {listed(values)}\n"
            )
    return text + "depth_scale: 1000\n"


def opencv_xml(t: Truth) -> str:
    text = f"<image_width>{number(t.size[0])}</image_width>\n<image_height>{number(t.size[1])}</image_height>\n"
    for key, values, rows in (("camera_matrix", matrix(t), 3), ("distortion_coefficients", t.lens, 1)):
        if values:
            data = " ".join(map(number, values))
            body = f"<rows>{rows}</rows><cols>{len(values) // rows}</cols><dt>d</dt><data>{data}</data>"
            text += f'<{key} type_id="opencv-matrix">{body}</{key}>\n'
    return f'<?xml version="1.0"?>\n<opencv_storage>\n{text}<depth_scale>1000</depth_scale>\n</opencv_storage>\n'


def of_matrix(K: Numbers) -> Numbers:
    if [K[1], K[3], K[6], K[7], K[8]] != [0, 0, 0, 0, 1]:
        raise ValueError("no calibration matrix")
    return [K[0], K[4], K[2], K[5]]


def from_opencv(d: Any) -> Truth:
    lens = d["distortion_coefficients"]["data"] if "distortion_coefficients" in d else []
    return Truth(of_matrix(d["camera_matrix"]["data"]), [d["image_width"], d["image_height"]], lens)


def ros(t: Truth) -> str:
    model = "equidistant" if t.fisheye else "rational_polynomial" if len(t.lens) == 8 else "plumb_bob"
    text = f"image_width: {number(t.size[0])}\nimage_height: {number(t.size[1])}\ncamera_name: rgb\n"
    text += f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {listed(matrix(t))}\ndistortion_model: {model}\n"
    return (
        text
        + f"distortion_coefficients:\n  rows: 1\n  cols: {len(t.lens)}\n  data: {listed(t.lens)}\ndepth_scale: 1000\n"
    )


def from_ros(d: Any) -> Truth:
    found = from_opencv(d)
    if "distortion_model" not in d and len(found.lens) == 4:
        raise ValueError("either lens")
    return found._replace(fisheye=d.get("distortion_model") in ("equidistant", "fisheye"))


def kalibr(t: Truth) -> str:
    text = f"cam0:\n  camera_model: pinhole\n  intrinsics: {listed(t.pinhole)}\n  resolution: {listed(t.size)}\n"
    text += f"  distortion_model: {'equidistant' if t.fisheye else 'radtan'}\n  distortion_coeffs: {listed(t.lens)}\n"
    return text + "  rostopic: /cam0/image_raw\ndepth_scale: 1000\n"


def from_kalibr(d: Any) -> Truth:
    d = next(value for key, value in d.items() if re.fullmatch(r"cam\d+", str(key)))
    if d["camera_model"] != "pinhole":
        raise ValueError("no pinhole")
    return Truth(d["intrinsics"], d["resolution"], d["distortion_coeffs"], d["distortion_model"] == "equidistant")


def open3d(t: Truth) -> str:
    columns = np.reshape(matrix(t), (3, 3)).T.ravel().tolist()
    size = {"width": int(t.size[0]), "height": int(t.size[1])}
    return json.dumps(size | {"intrinsic_matrix": columns, "depth_scale": 1000}, indent=1)


def from_open3d(d: Any) -> Truth:
    return Truth(of_matrix(np.reshape(d["intrinsic_matrix"], (3, 3)).T.ravel().tolist()), [d["width"], d["height"]], [])


def colmap(t: Truth) -> str:
    model = "OPENCV_FISHEYE" if t.fisheye else {0: "PINHOLE", 4: "OPENCV", 8: "FULL_OPENCV"}[len(t.lens)]
    values = " ".join(map(number, t.size + t.pinhole + t.lens))
    return f"# Camera list\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {model} {values}\n"


def from_colmap(text: str) -> Truth:
    rows = [line.replace(",", " ").split() for line in text.splitlines() if line.strip() and line.strip()[0] != "#"]
    _, model, *words = rows[0]
    size, values = [float(w) for w in words[:2]], [float(w) for w in words[2:]]
    count = {"PINHOLE": 4, "OPENCV": 8, "FULL_OPENCV": 12, "OPENCV_FISHEYE": 8}[model]
    if len(values) != count or any(row[1:] != rows[0][1:] for row in rows):
        raise ValueError("other parameters")
    return Truth(values[:4], size, values[4:], model == "OPENCV_FISHEYE")


def realsense(t: Truth) -> str:
    keys = ("fx", "fy", "ppx", "ppy", "width", "height")
    data: dict[str, Any] = dict(zip(keys, t.pinhole + [int(v) for v in t.size], strict=True))
    model = "distortion.kannala_brandt4" if t.fisheye else "distortion.brown_conrady"
    return json.dumps(data | {"coeffs": t.lens, "model": model, "depth_scale": 0.001}, indent=1)


def from_realsense(d: Any) -> Truth:
    model = d.get("model", "none")
    if any(d["coeffs"]) and model not in ("distortion.kannala_brandt4", "distortion.brown_conrady", 4, 5):
        raise ValueError("another model")
    fisheye = model in ("distortion.kannala_brandt4", 5)
    return Truth([d[k] for k in ("fx", "fy", "ppx", "ppy")], [d["width"], d["height"]], d["coeffs"], fisheye)


def azure(t: Truth) -> str:
    data = dict(zip(("fx", "fy", "cx", "cy"), t.pinhole, strict=True)) | dict(zip(NAMES, t.lens, strict=False))
    data |= {"codx": 0.0, "cody": 0.0, "metric_radius": 0.0, "width": int(t.size[0]), "height": int(t.size[1])}
    return json.dumps(data | {"depth_scale": 1000}, indent=1)


def from_azure(d: Any) -> Truth:
    if d.get("codx", 0) or d.get("cody", 0):
        raise ValueError("off centre")
    pinhole, size = [d[k] for k in ("fx", "fy", "cx", "cy")], [d["width"], d["height"]]
    return Truth(pinhole, size, [d.get(k, 0) for k in NAMES])


def transforms(t: Truth) -> str:
    data: dict[str, Any] = {"camera_model": "OPENCV_FISHEYE" if t.fisheye else "OPENCV"}
    data |= dict(zip(("fl_x", "fl_y", "cx", "cy"), t.pinhole, strict=True))
    names = ("k1", "k2", "k3", "k4") if t.fisheye else ("k1", "k2", "p1", "p2", "k3")
    data |= dict(zip(names, t.lens, strict=False)) | {"w": int(t.size[0]), "h": int(t.size[1])}
    return json.dumps(data | {"depth_unit_scale_factor": 0.001, "frames": []}, indent=1)


def from_transforms(d: Any) -> Truth:
    fisheye = str(d.get("camera_model", "OPENCV")).upper() == "OPENCV_FISHEYE"
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    if not fisheye and d.get("k4", 0):
        raise ValueError("k4")
    lens = [d.get(k, 0) for k in names]
    return Truth([d[k] for k in ("fl_x", "fl_y", "cx", "cy")], [d["w"], d["h"]], lens, fisheye)


KINDS = {
    "own": Kind(".yaml", (5, 8, -4), own, from_own),
    "orb-slam": Kind(".yaml", (4, 5, -4), orb, from_orb),
    "opencv yaml": Kind(".yml", (0, 4, 5, 8), opencv_yaml, from_opencv),
    "opencv xml": Kind(".xml", (0, 4, 5, 8), opencv_xml, from_opencv),
    "ros": Kind(".yaml", (5, 8, -4), ros, from_ros),
    "kalibr": Kind(".yaml", (4, -4), kalibr, from_kalibr),
    "open3d": Kind(".json", (0,), open3d, from_open3d),
    "colmap": Kind(".txt", (0, 4, 8, -4), colmap, from_colmap, -0.5),
    "realsense": Kind(".json", (5, -4), realsense, from_realsense),
    "azure": Kind(".json", (8,), azure, from_azure),
    "nerfstudio": Kind(".json", (5, -4), transforms, from_transforms, -0.5),
}


def random_truth(kind: Kind, rng: Generator) -> Truth:
    """A camera whose lens bends little enough not to fold over, and now and then one that may."""
    width, height = rng.integers(64, 2000, 2).tolist()
    f = max(width, height) * rng.uniform(0.6, 2)
    digits = int(rng.integers(0, 12))
    pinhole = [f, f * rng.uniform(0.95, 1.05), width * rng.uniform(0.4, 0.6), height * rng.uniform(0.4, 0.6)]
    count = int(rng.choice(kind.counts))
    scale = rng.choice([0.0, 1e-7, 1e-3, 0.02, 0.3])
    lens = (scale * rng.normal(size=abs(count))).tolist()
    return Truth(
        [round(v, digits) for v in pinhole], [float(width), float(height)], [float(f"{v:.6g}") for v in lens], count < 0
    )


def parse(text: str, suffix: str) -> Any:
    """The text as another parser sees it."""
    if suffix == ".json":
        return json.loads(text)
    if suffix == ".txt":
        return text
    if suffix == ".xml":
        found: dict[str, Any] = {}
        for key in ("image_width", "image_height"):
            found[key] = float(re.findall(f"<{key}>(.*?)</{key}>", text)[-1])
        for key in ("camera_matrix", "distortion_coefficients"):
            if blocks := re.findall(f"<{key}[ >].*?<data>(.*?)</data>.*?</{key}>", text, re.DOTALL):
                found[key] = {"data": [float(word) for word in blocks[-1].split()]}
        return found
    from ruamel.yaml import YAML

    loader = YAML(typ="safe", pure=True)
    loader.version = (1, 2)
    plain = re.sub(r"!!opencv-matrix", "", re.sub(r"\A\s*%YAML:[^\n]*", "", text))
    return loader.load(plain.replace("\t", " "))


def harmless(text: str, suffix: str, rng: Generator) -> str:
    """The same file, written in another way."""
    ways = [lambda s: s, lambda s: s.replace("\n", "\r\n"), lambda s: "\ufeff" + s, lambda s: s + "\n\n"]
    if suffix in (".yaml", ".yml"):
        ways += [lambda s: s + "# the end\n", lambda s: s.replace("\n", "  # cm\n", 1) if "%" not in s else s]
    if suffix == ".json":
        ways += [
            lambda s: json.dumps(dict(sorted(json.loads(s).items()))),
            lambda s: json.dumps(json.loads(s), indent=4),
        ]
    return ways[rng.integers(len(ways))](text)


WORDS = (
    "nan",
    ".inf",
    "-1",
    "0",
    "1e400",
    "1e-5",
    "5,3",
    "0640",
    "1_0",
    "1:30",
    "true",
    "null",
    "'5'",
    "x",
    "",
    "[1]",
    "é",
)


def damage(text: str, rng: Generator) -> str:
    """The file with one thing wrong."""
    way = rng.integers(6)
    keys = list(re.finditer(r"[A-Za-z][A-Za-z_0-9.]*", text))
    values = list(re.finditer(r"-?\d+\.?\d*(?:e-?\d+)?", text))
    if way == 0 and keys:  # a letter of a word doubled, dropped or exchanged
        word = keys[rng.integers(len(keys))]
        at = int(rng.integers(word.start(), word.end()))
        middle = ("", text[at] * 2, chr(rng.integers(97, 123)))[rng.integers(3)]
        return text[:at] + middle + text[at + 1 :]
    if way == 1:  # a line left out, or twice
        lines = text.split("\n")
        at = int(rng.integers(len(lines)))
        return "\n".join(lines[:at] + [lines[at]] * int(rng.choice([0, 2])) + lines[at + 1 :])
    if way == 2 and values:  # another value
        found = values[rng.integers(len(values))]
        return text[: found.start()] + WORDS[rng.integers(len(WORDS))] + text[found.end() :]
    if way == 3:  # a key that nobody knows
        at = text.find("\n") + 1
        return text[:at] + ('"extra": 1,\n' if "{" in text[:3] else "extra: 1\n") + text[at:]
    if way == 4:  # cut short
        return text[: rng.integers(len(text))]
    raw = bytearray(text.encode())
    for _ in range(rng.integers(1, 4)):
        raw[rng.integers(len(raw))] = rng.integers(256)
    return raw.decode("utf-8", "surrogateescape")


def keys(found: Any, before: str = "") -> set[str]:
    """The names of all keys of a mapping, also of those in it."""
    if not isinstance(found, dict):
        return set()
    found = {re.sub(r"^cam\d+$", "cam0", str(key)): value for key, value in found.items()}  # Kalibr's: any will do
    return {f"{before}{key}" for key in found}.union(*(keys(value, f"{before}{key}.") for key, value in found.items()))


def agrees(camera: Any, truth: Truth, shift: float) -> bool:
    """Whether what was read is what the file says."""
    fx, fy, cx, cy = truth.pinhole
    if truth.fisheye:
        lens = camera.lens.model == "fisheye" and list(camera.lens.coefficients) == list(truth.lens)[:4]
    else:
        padded = (list(truth.lens) + [0.0] * 8)[:8]
        lens = camera.lens.model != "fisheye" and (list(camera.lens.coefficients) + [0.0] * 8)[:8] == padded
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height]
    return lens and np.array_equal(numbers, [fx, fy, cx + shift, cy + shift, *truth.size])


def folds(truth: Truth) -> bool:
    """Whether the lens turns back before the farthest corner, by sampling; within a hundredth is undecided: False."""
    fx, fy, cx, cy = truth.pinhole
    corner = np.hypot(max(cx, truth.size[0] - 1 - cx) / fx, max(cy, truth.size[1] - 1 - cy) / fy)
    if truth.fisheye:
        r = np.linspace(0, np.pi / 2, 20001)
        measured = r * np.polyval([*truth.lens[::-1], 1.0], r * r)
    else:
        k1, k2, _, _, k3, k4, k5, k6 = (list(truth.lens) + [0.0] * 8)[:8]
        r = np.linspace(0, 10, 200001)
        with np.errstate(all="ignore"):
            measured = r * np.polyval([k3, k2, k1, 1], r * r) / np.polyval([k6, k5, k4, 1], r * r)
    turn = np.flatnonzero(~(np.diff(measured) > 0))
    return bool(len(turn) and measured[turn[0]] < 1.01 * corner)


def campaign(folder: Path, files: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Read so many files; how each kind ended, and the faults."""
    from miniloop_cli.datasets.camera_files import read_camera_file
    from miniloop_cli.errors import MiniloopError

    rng, ends, faults = np.random.default_rng(seed), Counter[str](), list[str]()
    for k in range(files):
        name = list(KINDS)[k % len(KINDS)]
        kind = KINDS[name]
        truth = random_truth(kind, rng)
        text = kind.write(truth)
        change = ("none", "harmless", "damage")[min(int(rng.integers(6)), 2)]
        if change != "none":
            text = harmless(text, kind.suffix, rng) if change == "harmless" else damage(text, rng)
        path = folder / f"camera{kind.suffix}"
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
        fault = ""
        try:
            camera = read_camera_file(path, depth_scale=1000.0)
            if change == "damage":
                try:
                    found = parse(text.removeprefix("\ufeff"), kind.suffix)
                    # Groups of keys of the SLAM programs are their own; any other key must have been refused.
                    new = keys(found) - keys(parse(kind.write(truth), kind.suffix))
                    new = {key for key in new if name != "orb-slam" or key.lower().startswith(("cam", "rgb", "depth"))}
                    fault = f"read with the unknown key {min(new)}" if new else ""
                    truth = kind.extract(found)
                except Exception as error:
                    fault = f"read, but the other parser says {type(error).__name__}: {error}"
            if not fault and not agrees(camera, truth, kind.shift):
                fault = f"read as {camera}, but the file says {truth}"
            ends[f"{name}, {change}: read"] += 1
        except MiniloopError as error:
            ends[f"{name}, {change}: refused"] += 1
            message = str(error)
            if not message.isprintable() or str(path) not in message:
                fault = f"message {message!r}"
            elif change != "damage" and not ("lens" in message and (folds(truth) or any(truth.lens[2:4]))):
                fault = f"refused: {message}"
        except Exception as error:
            fault = f"{type(error).__name__}: {error}"
        if fault:
            faults.append(f"file {k} ({name}, {change}): {fault}\n{text}")
    return ends, faults


def main() -> None:
    files = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as folder:
        ends, faults = campaign(Path(folder), files, seed)
    for end, count in sorted(ends.items()):
        print(f"{count:7d}  {end}")
    for fault in faults:
        print(f"\nFAULT {fault}")
    print(f"{files} files, {len(faults)} faults")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
