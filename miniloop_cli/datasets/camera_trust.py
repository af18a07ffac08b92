"""How well a recording's camera is known, by its values and its layout."""

from __future__ import annotations

from dataclasses import replace

from miniloop_cli.geometry.camera import Camera, Trust

# Default focal lengths of drivers for uncalibrated devices: Kinect, Xtion, PrimeSense, at 640 x 480.
DRIVER_FOCALS = (525.0, 528.0, 570.3422, 570.3422241210938, 575.8157, 575.8157348632812, 585.0)
CENTRES = ((319.5, 239.5), (320.0, 240.0), (314.5, 235.5))
# Layouts of devices that write their factory calibration.
FACTORY_LAYOUTS = (
    "arkitscenes", "azure-kinect", "openloris", "polycam", "realsense", "record3d", "record3d-file", "ros",
    "scannet", "scannet-sens", "stray-scanner",
)  # fmt: skip


def is_driver_default(camera: Camera) -> bool:
    """Whether the values are the defaults of a driver for all devices of a kind."""
    at_default = camera.fx == camera.fy and any(abs(camera.fx - focal) < 1e-3 for focal in DRIVER_FOCALS)
    return (
        at_default
        and camera.lens.ideal
        and (camera.width, camera.height) == (640, 480)
        and (camera.cx, camera.cy) in CENTRES
    )


def with_trust(camera: Camera, layout: str, given: bool) -> Camera:
    """The camera of a recording of this layout; `given`: its user named a file. A guess stays one.

    Defaults of a driver are a guess in any file except a camera.yaml in the recording.
    """
    if (given or layout in FACTORY_LAYOUTS) and is_driver_default(camera):
        return replace(camera, trust=Trust.GUESS)
    if not given and layout in FACTORY_LAYOUTS and camera.trust == Trust.CALIBRATED:
        return replace(camera, trust=Trust.FACTORY)
    return camera
