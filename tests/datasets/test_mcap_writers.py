"""MCAP files as the format's own library writes them: with chunks and without, compressed, without index or summary."""

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.typesys import Stores, get_typestore

from miniloop_cli.datasets import open_sequence, read_scan
from tests.datasets.bag_writers import COLOR, DEPTH, BagWriter, noise


class McapWriter(BagWriter):
    """The messages of BagWriter in a file of the library mcap."""

    def __init__(self, path, wire: str, **options) -> None:
        self.ros1, self.wire = wire == "ros1", wire
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        self.file_object = path.open("wb")
        self.writer = Writer(self.file_object, **options)
        self.writer.start(wire, "a test")
        self.schemas, self.channels = {}, {}

    def __exit__(self, *_: object) -> None:
        self.writer.finish()
        self.file_object.close()

    def write(self, topic: str, message, received_s: float) -> None:
        name = message.__msgtype__
        if name not in self.schemas:
            named = name.replace("/msg/", "/") if self.ros1 else name
            self.schemas[name] = self.writer.register_schema(named, "ros1msg" if self.ros1 else "ros2msg", b"")
        if topic not in self.channels:
            self.channels[topic] = self.writer.register_channel(topic, self.wire, self.schemas[name])
        raw = self.store.serialize_ros1(message, name) if self.ros1 else self.store.serialize_cdr(message, name)
        time_ns = round(received_s * 1e9)
        self.writer.add_message(self.channels[topic], time_ns, bytes(raw), time_ns)


BARE = {"index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False, "use_statistics": False}


@pytest.mark.parametrize("wire", ["ros1", "cdr"])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4, "chunk_size": 50_000},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        BARE,
        BARE | {"use_chunking": False},
    ],
)
def test_frames_of_every_kind_of_file(tmp_path, wire, options):
    path = tmp_path / "a.mcap"
    with McapWriter(path, wire, **options) as bag:
        for stamp, color, mm in noise():
            bag.image(COLOR, color, "rgb8", stamp)
            bag.image(DEPTH, mm, "16UC1", stamp + 0.003)
            bag.info("/camera/color/camera_info", stamp)
    sequence = open_sequence(path)
    assert len(sequence.frames) == 5
    assert not any("cut off" in str(note) or "not closed" in str(note) for note in sequence.notes)
    for k, (stamp, color, mm) in enumerate(noise()):
        scan = read_scan(sequence, k)
        assert sequence.frames[k].timestamp_s == pytest.approx(stamp, abs=1e-6)
        assert np.array_equal(scan.color, color)
        np.testing.assert_allclose(scan.depth_m, mm / 1000, rtol=1e-6)
