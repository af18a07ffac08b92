"""Recordings of other tools that no layout reads yet: what each is, and how to convert it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from miniloop_cli.datasets.paths import shown

ARCHIVE = "an archive: unpack it, then give the folder"
ROS = (
    "extract its colour images, its depth images registered to colour and their stamps to rgb/ and depth/ "
    "(named by time, as 1305031102.175304.png), and give the camera with --camera"
)
FILES = {
    ".sens": "a ScanNet .sens file: export color/, depth/, pose/ and intrinsic/ with ScanNet's SensReader",
    ".bag": f"a ROS 1 or RealSense bag: {ROS}",
    ".db3": f"a ROS 2 bag: {ROS}",
    ".mcap": f"an MCAP recording: {ROS}",
    ".mkv": "an Azure Kinect recording, or a video: Open3D's azure_kinect_mkv_reader.py writes color/, depth/ "
    "(registered) and intrinsic.json of it",
    ".klg": "a Kintinuous or ElasticFusion log: write its frames to rgb/ and depth/ (16-bit PNG, named by time)",
    ".oni": "an OpenNI recording: write its frames to rgb/ and depth/ (16-bit PNG, registered, named by time)",
    ".r3d": "a Record3D file with compressed depth: export it from the app as images, or unpack it as a ZIP, and store "
    "depth/ as 16-bit PNG in millimetres beside rgb/ and metadata.json",
    ".mp4": "a video, which holds no depth: give the folder with the depth images",
    ".mov": "a video, which holds no depth: give the folder with the depth images",
    ".ply": "a model, not a recording",
    ".pcd": "a model, not a recording",
    ".zip": ARCHIVE,
    ".tar": ARCHIVE,
    ".tgz": ARCHIVE,
    ".gz": ARCHIVE,
    ".bz2": ARCHIVE,
    ".xz": ARCHIVE,
    ".7z": ARCHIVE,
}
RECORDINGS = (".sens", ".bag", ".db3", ".mcap", ".mkv", ".klg", ".oni", ".r3d")

# What a folder must hold, and what it then is.
FOLDERS: tuple[tuple[Collection[str], str], ...] = (
    (
        ("lowres_wide", "lowres_depth"),
        "an ARKitScenes scan: rename lowres_wide/ to color/ and lowres_depth/ to depth/, and give the camera of "
        "lowres_wide_intrinsics/*.pincam (width height fx fy cx cy) with --camera",
    ),
    (
        ("rgb.mp4", "depth", "camera_matrix.csv"),
        "a Stray Scanner recording: write the frames of rgb.mp4, scaled to the size of the depth images, to color/ "
        "(ffmpeg -i rgb.mp4 -vf scale=256:192 -start_number 0 color/%06d.png), and give camera_matrix.csv, scaled "
        "alike, with --camera",
    ),
    (
        ("depth.bin", "pose_intrinsic_imu.json"),
        "an iPhone recording of ScanNet++: extract its frames with the toolbox of that data set first",
    ),
    (("iphone", "dslr"), "a scene of ScanNet++: extract the frames of iphone/ with the toolbox of that data set first"),
    (("mav0",), "a EuRoC recording, which has no depth images"),
    (
        ("rgbd", "metadata"),
        "an unpacked Record3D file: rename metadata to metadata.json, rgbd/*.jpg to rgb/, and store rgbd/*.depth "
        "(LZFSE, 32-bit float metres) in depth/ as 16-bit PNG in millimetres",
    ),
)
REPLICA = (
    "a Replica rendering: move results/frame*.jpg to color/ and results/depth*.png to depth/, and give its camera with "
    "--camera (NICE-SLAM's: 600 600 599.5 339.5, 1200 x 680, depth_scale 6553.5)"
)


def what_it_is(root: Path, children: list[Path]) -> str | None:
    """One line on a known file or folder of another tool, with what to do; None for what is not known."""
    if not root.is_dir():
        said = FILES.get(root.suffix.lower())
        return f"{shown(root)} is {said}" if said else None
    names = {child.name for child in children}
    for needed, said in FOLDERS:
        if names.issuperset(needed):
            return f"{shown(root)} is {said}"
    results = root / "results"
    if results.is_dir() and any(results.glob("frame*.*")) and any(results.glob("depth*.png")):
        return f"{shown(root)} is {REPLICA}"
    held = next((child for child in children if child.suffix.lower() in RECORDINGS and child.is_file()), None)
    return f"{shown(root)} holds {shown(held.name)}, {FILES[held.suffix.lower()]}" if held else None
