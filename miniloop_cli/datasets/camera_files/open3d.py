"""Open3D's JSON: PinholeCameraIntrinsic, the parameters and trajectories that hold one, metadata of its recorders.

The matrix is stored by columns, as Eigen has it.
"""

from __future__ import annotations

from miniloop_cli.datasets.camera_files.fields import Fields, Reading, Values, depth_scale, pinhole

IGNORED = tuple(
    """
    class_name version_major version_minor extrinsic color_mode depth_mode serial_number_ serial_number
    stream_length_usec color_format depth_format device_name fps name
    """.split()
)


def matches(data: dict) -> bool:
    """By the matrix, or by its parent."""
    return "intrinsic_matrix" in data or str(data.get("class_name", "")).startswith("PinholeCamera")


def read(fields: Fields) -> Reading:
    """The camera; of a trajectory, the one that all its images share. Raises ConfigError."""
    if "parameters" not in fields:
        return Reading(_intrinsic(fields) | depth_scale(fields, "depth_scale"))
    fields.known(("parameters", "depth_scale"), IGNORED)
    entries = fields.data["parameters"]
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise fields.fault("parameters must be a list of cameras")
    cameras = [_intrinsic(Fields(entry, fields.where, fields.image_size, "parameters")) for entry in entries]
    if any(camera != cameras[0] for camera in cameras):
        raise fields.fault("the images have cameras of their own; one for all is needed")
    return Reading(cameras[0] | depth_scale(fields, "depth_scale"))


def _intrinsic(fields: Fields) -> Values:
    fields.known(("intrinsic_matrix", "intrinsic", "width", "height", "depth_scale"), IGNORED)
    inner = fields.section("intrinsic") if "intrinsic" in fields else fields
    inner.known(("intrinsic_matrix", "width", "height", "depth_scale"), IGNORED)
    matrix = inner.numbers("intrinsic_matrix", (9,))
    columns = [matrix[3 * column + row] for row in range(3) for column in range(3)]
    by_rows = matrix[6:] == [0, 0, 1] and columns[6:] != [0, 0, 1]
    if by_rows:
        raise inner.fault("intrinsic_matrix is stored by rows; Open3D has it by columns: fx 0 0 0 fy 0 cx cy 1")
    return pinhole(inner, columns, "intrinsic_matrix") | inner.size(("width", "height")) | {"lens": "pinhole"}
