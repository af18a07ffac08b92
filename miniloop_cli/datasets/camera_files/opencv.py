"""OpenCV's FileStorage (YAML, XML, JSON) and ROS' CameraInfo (YAML of camera_calibration, or a message as text)."""

from __future__ import annotations

from miniloop_cli.datasets.camera_files.fields import (
    Fields,
    Reading,
    Values,
    depth_scale,
    fisheye_lens,
    opencv_lens,
    pinhole,
)

MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "mtx")
DISTORTION = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "d", "dist")
SIZES = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
ROS_LENSES = {"plumb_bob": opencv_lens, "rational_polynomial": opencv_lens}
ROS_LENSES |= {"radtan": opencv_lens, "equidistant": fisheye_lens, "fisheye": fisheye_lens}
# Further keys of OpenCV's calibration sample and of ROS.
IGNORED = tuple(
    """
    calibration_time nframes nr_of_frames nrOfFrames board_width board_height board_Width board_Height
    square_size square_Size FixAspectRatio aspectRatio flags flagValue avg_reprojection_error
    Avg_Reprojection_Error per_view_reprojection_errors image_points Per_View_Reprojection_Errors
    Image_points grid_points extrinsic_parameters marker_size Extrinsic_Parameters calibration_Time
    calibration_flags nr_of_views rms RMS error camera_name rectification_matrix projection_matrix
    header R P r p format
    """.split()
)
FULL_FRAME = ("binning_x", "binning_y", "roi")


def matches(data: dict) -> bool:
    """By a calibration matrix."""
    return any(key in data for key in MATRIX)


def matches_ros(data: dict) -> bool:
    """By a calibration matrix and the name of a lens model."""
    return matches(data) and "distortion_model" in data


def read(fields: Fields) -> Reading:
    """OpenCV's: the lens by the number of coefficients, or a stated fisheye. Raises ConfigError."""
    sizes = [key for pair in SIZES for key in pair]
    fields.known(
        (*MATRIX, *DISTORTION, *sizes, "image_size", "fisheye_model", "depth_scale", "DepthMapFactor"), IGNORED
    )
    key = _only(fields, DISTORTION)
    k = fields.numbers(key, range(15)) if key else []
    if len(k) == 4 and "fisheye_model" not in fields and not _of_file_storage(fields.data[key]):
        raise fields.fault("4 coefficients may be of either lens; add distortion_model: plumb_bob or equidistant")
    is_fisheye = "fisheye_model" in fields and fields.number("fisheye_model") != 0
    lens = fisheye_lens(fields, k) if is_fisheye else opencv_lens(fields, k)
    values = _matrix(fields) | _size(fields) | lens | depth_scale(fields, "depth_scale", "DepthMapFactor")
    return Reading(values, "" if key else "it states no distortion")


def read_ros(fields: Fields) -> Reading:
    """ROS': the lens by `distortion_model`. Raises ConfigError, also for a part of the image or a binned one."""
    sizes = [key for pair in SIZES for key in pair]
    fields.known((*MATRIX, *DISTORTION, *sizes, "distortion_model", "depth_scale", *FULL_FRAME), IGNORED)
    for name in ("binning_x", "binning_y"):
        if name in fields and fields.number(name) > 1:
            raise fields.fault(f"{name} is {fields.number(name):g}; give the intrinsics of the binned image")
    if "roi" in fields and any(value for key, value in fields.section("roi").data.items() if key != "do_rectify"):
        raise fields.fault("roi is a part of the image; give the intrinsics of that part")
    model, key = fields.text("distortion_model"), _only(fields, DISTORTION)
    k = fields.numbers(key, range(15)) if key else []
    if model not in ROS_LENSES and (k or model not in ("", "none")):
        raise fields.fault(f"distortion_model is '{model}'; supported are {', '.join(ROS_LENSES)}")
    if model == "plumb_bob" and any(k[5:]):
        raise fields.fault("more than 5 coefficients; those of distortion_model: rational_polynomial are 8")
    lens = ROS_LENSES.get(model, opencv_lens)(fields, k)
    return Reading(_matrix(fields) | _size(fields) | lens | depth_scale(fields, "depth_scale"))


def _of_file_storage(value: object) -> bool:
    """Whether OpenCV wrote a matrix, by the type of its numbers."""
    return isinstance(value, dict) and "dt" in value


def _matrix(fields: Fields) -> Values:
    key = _only(fields, MATRIX) or MATRIX[0]
    return pinhole(fields, fields.numbers(key, (9,)), key)


def _size(fields: Fields) -> Values:
    if "image_size" in fields:
        return dict(zip(("width", "height"), fields.numbers("image_size", (2,)), strict=True))
    return fields.size(*SIZES)


def _only(fields: Fields, keys: tuple[str, ...]) -> str | None:
    """The one of several alternative keys that exists."""
    there = [key for key in keys if key in fields]
    if len(there) > 1:
        raise fields.fault(f"both {there[0]} and {there[1]} are given; keep one")
    return there[0] if there else None
