"""Sensors identified by the size of their images and their focal length, to find the unit of depth.

The ranges contain published factory calibrations of these sensors, with a margin; the unit is that of the makers'
recorders and of the ROS drivers (REP 118).
"""

from __future__ import annotations

from typing import NamedTuple

from miniloop_cli.geometry.camera import Camera

Size = tuple[int, int]


class Sensor(NamedTuple):
    """A sensor whose depth is stored in millimetres: width and height (px) of its images, its range of fx (px)."""

    name: str
    size: Size
    fx_px: tuple[float, float]


# Kinects and Xtions (fx 517 to 590 at 640 x 480) are left out, as TUM's recordings have 5000 units a metre.
MILLIMETRE_SENSORS = (
    Sensor("a RealSense D415 or D435", (640, 480), (598.0, 630.0)),
    Sensor("a RealSense D415 or D435", (848, 480), (598.0, 630.0)),
    Sensor("a RealSense D415 or D435", (1280, 720), (885.0, 945.0)),
    Sensor("a RealSense D455", (640, 480), (375.0, 395.0)),
    Sensor("a RealSense D455", (1280, 720), (630.0, 655.0)),
    Sensor("an Azure Kinect", (1280, 720), (598.0, 618.0)),
    Sensor("an Azure Kinect", (1920, 1080), (895.0, 925.0)),
    Sensor("an Azure Kinect", (2048, 1536), (965.0, 990.0)),
    Sensor("a Kinect v2", (1920, 1080), (1030.0, 1090.0)),
    Sensor("a Kinect v2", (960, 540), (515.0, 545.0)),
)
# Sizes of depth images that no other sensor has, for any camera.
MILLIMETRE_SIZES = {
    (512, 424): "a Kinect v2",
    (640, 576): "an Azure Kinect",
    (320, 288): "an Azure Kinect",
    (256, 192): "a phone with ARKit",
    (192, 256): "a phone with ARKit",
}


def stores_millimetres(camera: Camera, depth_size: Size) -> str | None:
    """Why the depth is probably in millimetres, as a sentence; None if the sensor is unknown.

    `depth_size` is the width and height (px) of the stored depth images, `camera` that of the colour images.
    """
    width, height = depth_size
    if name := MILLIMETRE_SIZES.get(depth_size):
        return f"{width} x {height} is the size of depth images of {name}, which stores millimetres"
    for sensor in MILLIMETRE_SENSORS:
        if sensor.size == (camera.width, camera.height) and sensor.fx_px[0] <= camera.fx <= sensor.fx_px[1]:
            size = f"{camera.width} x {camera.height}"
            return f"fx = {camera.fx:.0f} at {size} is the focal length of {sensor.name}, which stores millimetres"
    return None
