"""nerfstudio's transforms.json (also Instant-NGP's): one camera at the top, or the same in every frame.

Its principal point counts from the corner of the first pixel, half a pixel more than ours.
"""

from __future__ import annotations

from miniloop_cli.datasets.camera_files.fields import Fields, Reading, Values, fisheye_lens, opencv_lens

PINHOLE = ("fl_x", "fl_y", "cx", "cy")
LENS = ("camera_model", "k1", "k2", "k3", "k4", "p1", "p2", "is_fisheye")
USED = (*PINHOLE, *LENS, "w", "h", "depth_unit_scale_factor", "frames")
IGNORED = tuple(
    """
    note applied_transform applied_scale ply_file_path camera_angle_x camera_angle_y offset aabb_scale
    scale aabb train_filenames val_filenames test_filenames orientation_override
    auto_scale_poses_override fps up white_transparent sharpness integer_depth_scale
    """.split()
)


def matches(data: dict) -> bool:
    """By the focal length's name, at the top or in the frames."""
    frames = data.get("frames")
    return "fl_x" in data or (isinstance(frames, list) and any(isinstance(f, dict) for f in frames))


def read(fields: Fields) -> Reading:
    """The camera. Raises ConfigError, also if frames have different ones."""
    fields.known(USED, IGNORED)
    frames = fields.data.get("frames", [])
    own = (*PINHOLE, *LENS, "w", "h")
    entries = [frame for frame in frames if isinstance(frame, dict)] if isinstance(frames, list) else []
    per_frame = [{key: frame[key] for key in own if key in frame} for frame in entries]
    if any(camera != per_frame[0] for camera in per_frame):
        raise fields.fault("the frames have cameras of their own; one for all is needed")
    shared = per_frame[0] if per_frame else {}
    if twice := [key for key in shared if key in fields and fields.data[key] != shared[key]]:
        raise fields.fault(f"{twice[0]} differs between the top and the frames")
    fields = Fields(fields.data | shared, fields.where, fields.image_size)
    values = {ours: fields.number(key) for ours, key in zip(("fx", "fy", "cx", "cy"), PINHOLE, strict=True)}
    values |= {"cx": values["cx"] - 0.5, "cy": values["cy"] - 0.5} | fields.size(("w", "h"))
    return Reading(values | _lens(fields) | _depth(fields), "the camera of every frame" if shared else "")


def _lens(fields: Fields) -> Values:
    model = fields.text("camera_model", "opencv").upper()
    k = {key: fields.number(key) if key in fields else 0.0 for key in ("k1", "k2", "p1", "p2", "k3", "k4")}
    if model == "OPENCV_FISHEYE" or fields.data.get("is_fisheye") is True:
        if k["p1"] or k["p2"]:
            raise fields.fault("a fisheye lens has no p1 and p2")
        return fisheye_lens(fields, [k["k1"], k["k2"], k["k3"], k["k4"]])
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE"):
        raise fields.fault(f"camera_model is {model}; supported are OPENCV, OPENCV_FISHEYE and PINHOLE")
    if model != "OPENCV" and any(k.values()):
        raise fields.fault(f"camera_model is {model}, but there are coefficients of a lens")
    if k.pop("k4"):
        raise fields.fault("k4 of an OPENCV lens (the term r^8) is not supported")
    return opencv_lens(fields, list(k.values()))


def _depth(fields: Fields) -> Values:
    """Units a metre, from the metres a unit in the file."""
    if "depth_unit_scale_factor" not in fields:
        return {}
    metres = fields.number("depth_unit_scale_factor")
    if not metres > 0:
        raise fields.fault("depth_unit_scale_factor must be greater than 0")
    return {"depth_scale": 1 / metres}
