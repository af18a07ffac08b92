"""Recordings in one file, written by other programs than the readers: PyAV for Matroska, struct and zlib for logs."""

import json
import struct
import zlib
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

# Of one colour and one depth camera, with round numbers: shares of the sensor's size, in the order of the SDK.
COLOR_MODEL = [0.5, 0.51, 0.48, 0.64, 0.1, -0.2, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.001, -0.002]
DEPTH_MODEL = [0.51, 0.5, 0.49, 0.49, 0.2, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
ROTATION = [0.99875026, -0.04997917, 0.0, 0.04997917, 0.99875026, 0.0, 0.0, 0.0, 1.0]
TRANSLATION_M = [-0.032, -0.002, 0.004]


def calibration(**changed: object) -> dict:
    """calibration.json as the SDK attaches it."""

    def camera(location: str, model: list, R: list, t: list, width: int, height: int) -> dict:
        kind = "CALIBRATION_LensDistortionModelBrownConrady"
        return {
            "Intrinsics": {"ModelParameterCount": 14, "ModelParameters": model, "ModelType": kind},
            "Location": f"CALIBRATION_CameraLocation{location}",
            "Rt": {"Rotation": R, "Translation": t},
            "SensorHeight": height,
            "SensorWidth": width,
        }

    identity = np.eye(3).ravel().tolist()
    cameras = [
        camera("D0", DEPTH_MODEL, identity, [0, 0, 0], 1024, 1024),
        camera("PV0", COLOR_MODEL, ROTATION, TRANSLATION_M, 4096, 3072),
    ]
    return {"CalibrationInformation": {"Cameras": cameras}} | changed


def jpeg(rgb: np.ndarray) -> bytes:
    done, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
    assert done
    return data.tobytes()


def png(image: np.ndarray) -> bytes:
    done, data = cv2.imencode(".png", image if image.ndim == 2 else image[..., ::-1])
    assert done
    return data.tobytes()


def write_azure(
    path: Path,
    frames: list[tuple[float, np.ndarray, np.ndarray]],
    attached: dict | bytes | None = None,
    names: tuple[str, str] = ("COLOR", "DEPTH"),
    options: dict | None = None,
) -> Path:
    """Stamp (s), RGB and depth (mm) of frames as k4arecorder lays them out; the JPEGs are OpenCV's."""
    with av.open(str(path), "w", format="matroska", options={"allow_raw_vfw": "1"} | (options or {})) as container:
        attached = calibration() if attached is None else attached
        content = attached if isinstance(attached, bytes) else json.dumps(attached).encode() + b"\0"
        if content:
            container.add_attachment("calibration.json", "application/octet-stream", content)
        color = container.add_stream("mjpeg", rate=30)
        depth = container.add_stream("rawvideo", rate=30)
        color.height, color.width = frames[0][1].shape[:2]
        depth.height, depth.width = frames[0][2].shape
        color.pix_fmt, depth.pix_fmt = "yuvj420p", "gray16be"
        for stream, name in ((color, names[0]), (depth, names[1])):
            stream.time_base = Fraction(1, 1_000_000)
            stream.metadata["title"] = name
        for stamp, rgb, mm in frames:
            for stream, data in ((color, jpeg(rgb)), (depth, mm.astype(">u2").tobytes())):
                packet = av.Packet(data)
                packet.stream, packet.time_base = stream, Fraction(1, 1_000_000)
                packet.pts = packet.dts = round(stamp * 1e6)
                packet.is_keyframe = True
                container.mux(packet)
    # ffmpeg has no code for such a track; in the BITMAPINFOHEADER that describes it, 16 bytes in, it is 0.
    data = path.read_bytes()
    at = data.index(struct.pack("<ii", 40, frames[0][2].shape[1]), data.index(b"V_MS/VFW/FOURCC"))
    path.write_bytes(data[: at + 16] + b"b16g" + data[at + 20 :])
    return path


def write_klg(
    path: Path, frames: list[tuple[int, np.ndarray, np.ndarray]], zipped: bool = True, as_jpeg: bool = True
) -> Path:
    """Stamp (us), RGB and depth (mm), 640 x 480, as ElasticFusion's loggers write them."""
    parts = [struct.pack("<i", len(frames))]
    for stamp, rgb, mm in frames:
        depth = mm.astype("<u2").tobytes()
        depth = zlib.compress(depth) if zipped else depth
        color = jpeg(rgb) if as_jpeg else rgb.tobytes()
        parts += [struct.pack("<qii", stamp, len(depth), len(color)), depth, color]
    path.write_bytes(b"".join(parts))
    return path
