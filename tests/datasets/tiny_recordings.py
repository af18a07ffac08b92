"""Tiny recordings: images of noise in TUM's layout, 64 x 48 pixels."""

from pathlib import Path

import cv2
import numpy as np
import OpenEXR

CAMERA = "fx: 52.5\nfy: 52.5\ncx: 31.5\ncy: 23.5\nwidth: 64\nheight: 48\ndepth_scale: 5000\n"


class Tiny:
    """A folder that tests fill and break."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.rng = np.random.default_rng(0)
        root.mkdir(parents=True, exist_ok=True)

    def color(self, name: str, width: int = 64, height: int = 48) -> np.ndarray:
        image = self.rng.integers(0, 256, (height, width, 3), np.uint8)
        self.put(name, image[..., ::-1])
        return image

    def depth(self, name: str, width: int = 64, height: int = 48) -> np.ndarray:
        image = self.rng.integers(3000, 20000, (height, width)).astype(np.uint16)
        self.put(name, image)
        return image

    def put(self, name: str, image: np.ndarray) -> Path:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        done, data = cv2.imencode(path.suffix, np.ascontiguousarray(image))
        assert done
        path.write_bytes(data)
        return path

    def text(self, name: str, text: str) -> Path:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
        return path


def fill_tum(tiny: Tiny, frames: int = 5, tables: bool = True) -> Tiny:
    """Frames 0.1 s apart, depth 5 ms after colour, camera.yaml."""
    rows = {"rgb": [], "depth": []}
    for k in range(frames):
        for kind, stamp in (("rgb", 10 + k / 10), ("depth", 10.005 + k / 10)):
            name = f"{kind}/{stamp:.6f}.png"
            rows[kind].append(f"{stamp:.6f} {name}")
            (tiny.color if kind == "rgb" else tiny.depth)(name)
    if tables:
        for kind, lines in rows.items():
            tiny.text(f"{kind}.txt", "# header\n" + "\n".join(lines) + "\n")
    tiny.text("camera.yaml", CAMERA)
    return tiny


def write_exr(path: Path, **channels: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    how = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(how, dict(channels)).write(str(path))
    return path
