"""ROS 1 bags, ROS 2 bags and MCAP files: images, cameras and transforms by the types of their messages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.archive_path import ArchivePath
from miniloop_cli.datasets.bags.bag import Bag
from miniloop_cli.datasets.bags.cameras import camera_of, find_info, transform_between
from miniloop_cli.datasets.bags.source import looks_like_bag, open_bag
from miniloop_cli.datasets.bags.streams import damage_notes, stamped_streams
from miniloop_cli.datasets.bags.topics import ImageTopic, choose_topics, image_topics
from miniloop_cli.datasets.bags.wire import CameraInfo
from miniloop_cli.datasets.numbered import given_camera
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import DepthCamera, Note, NoteKind, Sequence, Trajectory

DEPTH_SCALE = 1000.0  # REP 118: 16-bit depth is in millimetres
SAME_K = 0.01


class RosBag:
    """ROS bags (.bag, .db3, .mcap, a folder of these): topics found by type and encoding, or named by --topics."""

    topics: Mapping[str, str] = {}

    def matches(self, root: Path) -> bool:
        """By the suffix of the file, or of the files in the folder."""
        return not isinstance(root, ArchivePath) and looks_like_bag(root)

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in the bag. Raises InputError naming what is missing, and the choices for --topics."""
        bag = open_bag(root)
        found, problem = image_topics(root, bag)
        color, depth = choose_topics(root, found, self.topics, bag, problem)
        pairs = pair(root, *stamped_streams(root, color.topic, depth.topic))
        color_info = find_info(root, bag, color, self.topics.get("info"))
        depth_info = find_info(root, bag, depth, self.topics.get("depth_info"))
        camera = given_camera(root, camera_path, pairs.frames, DEPTH_SCALE) or _camera(root, color, color_info)
        depth_camera, said = _depth_camera(root, bag, (color, depth), (color_info, depth_info), camera)
        used = {color.name, depth.name}
        notes = (*damage_notes(root, bag), *pairs.notes, said, *_unused(used, found))
        name = root.name if root.is_dir() else root.stem
        return Sequence(
            name,
            root,
            camera,
            pairs.frames,
            notes=notes,
            available=pairs.available,
            depth_camera=depth_camera,
            color_only=pairs.color_only,
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """None, as a bag does not state which of its poses are the camera's."""
        return None


def _camera(root: Path, color: ImageTopic, info: tuple[str, CameraInfo] | None) -> Camera:
    if info is None:
        raise InputError(
            f"{shown(root)} has no CameraInfo for {color.name}: name its topic (--topics info=NAME) or give --camera"
        )
    return _camera_of_info(root, color, info)


def _camera_of_info(root: Path, image: ImageTopic, info: tuple[str, CameraInfo]) -> Camera:
    rectified = "rect" in image.base.rpartition("/")[2] and any(info[1].P)
    return camera_of(info[1], f"{shown(root)}{info[0]}", f"the bag's own {info[0]}", DEPTH_SCALE, rectified)


def _depth_camera(
    root: Path,
    bag: Bag,
    topics: tuple[ImageTopic, ImageTopic],
    infos: tuple[tuple[str, CameraInfo] | None, tuple[str, CameraInfo] | None],
    camera: Camera,
) -> tuple[DepthCamera | None, Note]:
    """The depth camera if depth is not registered to colour, and a note."""
    color, depth = topics
    info = infos[1]
    chosen = f"colour from {color.name}, depth from {depth.name}"
    one_frame = color.head.frame.lstrip("/") == depth.head.frame.lstrip("/") and color.head.frame != ""
    if depth.registered or (one_frame and (info is None or _same(info[1], camera))):
        why = "by its name" if depth.registered else "as both have the same frame and camera"
        return None, Note(NoteKind.PAIRED, f"{chosen}, which is registered to colour {why}")
    T = np.eye(4) if one_frame else transform_between(bag, color.head.frame, depth.head.frame)
    missing = []
    if info is None:
        missing.append("the CameraInfo of depth (--topics depth_info=NAME)")
    if T is None:
        missing.append(
            f"a static transform from {depth.head.frame or '(no name)'} to {color.head.frame or '(no name)'}"
        )
    if info is None or T is None:
        raise InputError(
            f"{shown(root)}: {depth.name} is not registered to {color.name}, and the bag lacks "
            f"{' and '.join(missing)}; record registered depth, such as "
            "aligned_depth_to_color, or choose another topic with --topics"
        )
    own = _camera_of_info(root, depth, info)
    text = f"{chosen}; it is registered to colour by {info[0]} and tf ({1000 * np.linalg.norm(T[:3, 3]):.1f} mm apart)"
    return DepthCamera(own, tuple(T.ravel().tolist())), Note(NoteKind.CONVERTED, text)


def _same(info: CameraInfo, camera: Camera) -> bool:
    """Whether two cameras have the same size and, within 1 %, the same intrinsics."""
    ours = np.array([camera.fx, camera.cx, camera.fy, camera.cy])
    theirs = np.array([info.K[0], info.K[2], info.K[4], info.K[5]])
    same_size = (info.width, info.height) == (camera.width, camera.height)
    return same_size and bool((np.abs(ours - theirs) <= SAME_K * camera.fx).all())


def _unused(used: set[str], found: list[ImageTopic]) -> tuple[Note, ...]:
    left = sorted(f"{topic.name} ({len(topic.topic.places)})" for topic in found if topic.name not in used)
    if not left:
        return ()
    return (Note(NoteKind.UNUSED, f"other topics of images are not used: {shown(', '.join(left))}"),)
