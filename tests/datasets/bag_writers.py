"""Bags written by rosbags, which is independent of the readers here; messages by its type stores."""

from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

K = (52.5, 0.0, 31.5, 0.0, 52.5, 23.5, 0.0, 0.0, 1.0)
SIZE = (64, 48)
COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
OPTICAL = "camera_color_optical_frame"


class BagWriter:
    """A bag of ROS 1 or 2, written message by message; the wire, names of fields and stamps are the store's."""

    def __init__(self, path: Path, kind: str = "ros1", compression: str = "") -> None:
        self.ros1 = kind == "ros1"
        self.path, self.kind = path, kind
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            self.store.register(
                get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
            )
            self.writer = Ros1Writer(path)
            if compression:
                self.writer.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
        else:
            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            self.writer = Ros2Writer(path, version=8, storage_plugin=plugin)
            if compression:
                mode = {"storage": "STORAGE", "message": "MESSAGE", "file": "FILE"}[compression]
                self.writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
        self.connections = {}
        self.writer.open()

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    @property
    def file(self) -> Path:
        """The bag's one file."""
        if self.ros1:
            return self.path
        return next(p for p in self.path.iterdir() if p.suffix in (".mcap", ".db3"))

    def type(self, name: str):
        return self.store.types[name]

    def header(self, stamp_s: float, frame: str = OPTICAL):
        stamp = round(stamp_s * 1e9)
        time = self.type("builtin_interfaces/msg/Time")(sec=stamp // 10**9, nanosec=stamp % 10**9)
        extra = {"seq": 0} if self.ros1 else {}
        return self.type("std_msgs/msg/Header")(**extra, stamp=time, frame_id=frame)

    def write(self, topic: str, message, received_s: float) -> None:
        name = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, name, typestore=self.store)
        raw = self.store.serialize_ros1(message, name) if self.ros1 else self.store.serialize_cdr(message, name)
        self.writer.write(self.connections[topic], round(received_s * 1e9), raw)

    def image(
        self,
        topic: str,
        pixels: np.ndarray,
        encoding: str,
        stamp_s: float,
        frame: str = OPTICAL,
        pad: int = 0,
        received_s: float | None = None,
    ):
        rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)
        rows = np.pad(rows, ((0, 0), (0, pad)))
        message = self.type("sensor_msgs/msg/Image")(
            header=self.header(stamp_s, frame),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=int(pixels.dtype.byteorder == ">"),
            step=rows.shape[1],
            data=rows.ravel(),
        )
        self.write(topic, message, stamp_s + 0.5 if received_s is None else received_s)

    def compressed(self, topic: str, data: bytes, form: str, stamp_s: float, frame: str = OPTICAL):
        message = self.type("sensor_msgs/msg/CompressedImage")(
            header=self.header(stamp_s, frame), format=form, data=np.frombuffer(data, np.uint8)
        )
        self.write(topic, message, stamp_s + 0.5)

    def info(self, topic: str, stamp_s: float, size=SIZE, K=K, D=(), model="plumb_bob", frame: str = OPTICAL):
        K = np.array(K, float)
        P = np.zeros((3, 4))
        P[:, :3] = K.reshape(3, 3)
        names = "DKRP" if self.ros1 else "dkrp"
        values = (np.array(D, float), K, np.eye(3).ravel(), P.ravel())
        roi = self.type("sensor_msgs/msg/RegionOfInterest")(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        message = self.type("sensor_msgs/msg/CameraInfo")(
            header=self.header(stamp_s, frame),
            height=size[1],
            width=size[0],
            distortion_model=model,
            **dict(zip(names, values, strict=True)),
            binning_x=0,
            binning_y=0,
            roi=roi,
        )
        self.write(topic, message, stamp_s + 0.5)

    def transform_of(self, T: np.ndarray):
        q = cv2.Rodrigues(T[:3, :3])[0].ravel()
        angle = np.linalg.norm(q)
        axis = q / angle if angle else np.zeros(3)
        x, y, z = axis * np.sin(angle / 2)
        vector, quaternion = self.type("geometry_msgs/msg/Vector3"), self.type("geometry_msgs/msg/Quaternion")
        return self.type("geometry_msgs/msg/Transform")(
            translation=vector(*map(float, T[:3, 3])),
            rotation=quaternion(float(x), float(y), float(z), float(np.cos(angle / 2))),
        )

    def tf(self, links: list[tuple[str, str, np.ndarray]], stamp_s: float, topic: str = "/tf_static") -> None:
        kind = self.type("geometry_msgs/msg/TransformStamped")
        parts = [
            kind(header=self.header(stamp_s, parent), child_frame_id=child, transform=self.transform_of(T))
            for parent, child, T in links
        ]
        self.write(topic, self.type("tf2_msgs/msg/TFMessage")(transforms=parts), stamp_s)


def noise(seed: int = 0, frames: int = 5, size=SIZE) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Stamp (s), RGB and depth (mm) of some frames."""
    rng = np.random.default_rng(seed)
    shape = size[::-1]
    return [
        (
            1305031100.0 + k / 10,
            rng.integers(0, 256, (*shape, 3), np.uint8),
            rng.integers(600, 4000, shape).astype(np.uint16),
        )
        for k in range(frames)
    ]


def write_rgbd(path: Path, kind: str = "ros1", compression: str = "", frames=None, **size) -> Path:
    """Colour and registered depth 3 ms later; the path that opens it."""
    with BagWriter(path, kind, compression) as bag:
        for stamp, color, depth in frames or noise():
            bag.image(COLOR, color, "rgb8", stamp)
            bag.image(DEPTH, depth, "16UC1", stamp + 0.003)
            bag.info("/camera/color/camera_info", stamp, **size)
    return path
