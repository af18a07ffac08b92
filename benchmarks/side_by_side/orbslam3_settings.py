"""The settings file that ORB-SLAM3 wants of a recording, in its RGB-D mode."""

from __future__ import annotations

from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera

# ORB-SLAM3's own for Kinects: baseline times focal length (px m), and the closeness of a point in baselines.
BASELINE_FOCAL_PX_M, CLOSE = 40.0, 40.0
ORB = {"nFeatures": 1000, "scaleFactor": 1.2, "nLevels": 8, "iniThFAST": 20, "minThFAST": 7}
# A viewer is never opened, but its numbers are asked for.
VIEWER = {
    "KeyFrameSize": 0.05,
    "KeyFrameLineWidth": 1.0,
    "GraphLineWidth": 0.9,
    "PointSize": 2.0,
    "CameraSize": 0.08,
    "CameraLineWidth": 3.0,
    "ViewpointX": 0.0,
    "ViewpointY": -0.7,
    "ViewpointZ": -1.8,
    "ViewpointF": 500.0,
}
LENS = ("k1", "k2", "p1", "p2", "k3")


def settings_text(camera: Camera, rate_hz: float) -> str:
    """Text of the file for a camera, its lens and depth scale included.

    Raises InputError for lenses that ORB-SLAM3 has no RGB-D model of (fisheye, rational).
    """
    lens = camera.lens.coefficients
    if not camera.lens.ideal and (camera.lens.model != "radial-tangential" or len(lens) > len(LENS)):
        raise InputError(f"ORB-SLAM3 has no RGB-D mode for the lens {camera.lens}; undistort the images first")
    values: dict[str, float | int | str] = {"File.version": '"1.0"', "Camera.type": '"PinHole"'}
    values |= {f"Camera1.{name}": float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    values |= {f"Camera1.{name}": float(value) for name, value in zip(LENS, (*lens, *[0.0] * 5), strict=False)}
    values |= {"Camera.width": camera.width, "Camera.height": camera.height}
    values |= {"Camera.fps": max(round(rate_hz), 1), "Camera.RGB": 1}
    values |= {"Stereo.ThDepth": CLOSE, "Stereo.b": BASELINE_FOCAL_PX_M / camera.fx}
    values |= {"RGBD.DepthMapFactor": float(camera.depth_scale)}
    values |= {f"ORBextractor.{name}": value for name, value in ORB.items()}
    values |= {f"Viewer.{name}": value for name, value in VIEWER.items()}
    return "%YAML:1.0\n" + "".join(f"{name}: {value}\n" for name, value in values.items())
