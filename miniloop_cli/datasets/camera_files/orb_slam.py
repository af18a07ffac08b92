"""ORB-SLAM2 and 3 (OpenCV's YAML with keys like Camera.fx, Camera1.fx) and stella_vslam, with the same keys."""

from __future__ import annotations

from difflib import get_close_matches

from miniloop_cli.datasets.camera_files.fields import Fields, Reading, depth_scale, fisheye_lens, opencv_lens

PINHOLE = ("pinhole", "rectified", "perspective")
FISHEYE = ("kannalabrandt8", "fisheye")
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4")
IMAGE = ("width", "height", "cols", "rows", "type", "model")
# Rates, baselines and orders of colours do not concern the camera, nor do other groups of keys (Viewer, IMU).
IGNORED = tuple(
    """
    fps RGB bf b name setup color_order focal_x_baseline depth_threshold imageScale newWidth newHeight
    overlappingBegin overlappingEnd lappingBegin lappingEnd ThDepth
    """.split()
)
DEPTH = ("DepthMapFactor", "RGBD.DepthMapFactor", "Camera.depthmap_factor", "depthmap_factor", "depth_scale")

OWN_GROUPS = ("Camera", "Camera1", "RGBD")
NEAR = ("camera", "camera1", "rgbd", "depthmapfactor", "depthmap_factor", "depth_scale")


def matches(data: dict) -> bool:
    """By its keys."""
    return any(str(key).startswith(("Camera.", "Camera1.")) for key in data) or isinstance(data.get("Camera"), dict)


def read(fields: Fields) -> Reading:
    """The camera, the first of two. Raises ConfigError."""
    data = dict(fields.data)
    group = data.pop("Camera", None)
    if isinstance(group, dict):
        data |= {f"Camera.{key}": value for key, value in group.items()}
    fields = Fields(data, fields.where, fields.image_size)
    # ORB-SLAM3 puts intrinsics under Camera1 and the rest under Camera.
    own = "Camera1" if any(str(key).startswith("Camera1.") for key in data) else "Camera"
    _check_keys(fields, own)
    model = fields.text("Camera.type", fields.text("Camera.model", "pinhole"))
    if model not in PINHOLE + FISHEYE:
        raise fields.fault(f"Camera.type is {model}; supported are PinHole, Rectified and KannalaBrandt8")
    values = {key: fields.number(f"{own}.{key}") for key in ("fx", "fy", "cx", "cy")}
    size = fields.size(("Camera.width", "Camera.height"), ("Camera.cols", "Camera.rows"))
    names = ("k1", "k2", "k3", "k4") if model in FISHEYE else ("k1", "k2", "p1", "p2", "k3")
    k = [fields.number(f"{own}.{name}") if f"{own}.{name}" in fields else 0.0 for name in names]
    if model not in FISHEYE and f"{own}.k4" in fields and fields.number(f"{own}.k4"):
        raise fields.fault(f"{own}.k4 is of a fisheye lens (Camera.type: KannalaBrandt8); this is {model}")
    if model == "rectified" and any(k):
        raise fields.fault(f"Camera.type is Rectified, but there are coefficients of a lens under {own}")
    lens = fisheye_lens(fields, k) if model in FISHEYE else opencv_lens(fields, k)
    return Reading(values | size | lens | depth_scale(fields, *DEPTH), "" if own == "Camera" else f"its {own}")


def _check_keys(fields: Fields, own: str) -> None:
    """Of the camera's group every key must be known. Other groups (Viewer, IMU) and flat keys are the program's.

    Raises ConfigError, also for a group or flat key that is similar to one of ours. Camera2 is the second of a pair.
    """
    used = [*(f"{own}.{name}" for name in LENS), *(f"Camera.{name}" for name in IMAGE), *DEPTH]
    ignored = [f"{group}.{name}" for group in OWN_GROUPS for name in IGNORED] + list(IGNORED)
    for key in map(str, fields.data):
        group = key.lower().split(".")[0]
        ours = group.startswith(("camera", "rgbd")) or get_close_matches(group, NEAR, n=1, cutoff=0.75)
        if group == "camera2" or not ours:
            ignored.append(key)
    fields.known(used, ignored)
