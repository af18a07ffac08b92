"""Every layout on a tiny generated sample: found by looking, decoded, camera, reference poses."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_recordings import write_exr

from miniloop_cli.datasets import known_layouts, open_sequence, read_ground_truth, read_scan
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.errors import ConfigError, InputError
from miniloop_cli.geometry import se3
from miniloop_cli.scene.sequence import Trajectory

COUNT = 4
T_TRUE = se3.pose(Rotation.random(COUNT, random_state=1).as_matrix(), np.random.default_rng(1).normal(0, 2, (COUNT, 3)))
OPENGL = np.diag([1.0, -1, -1, 1])


def matrix_text(M: np.ndarray) -> str:
    return "\n".join(" ".join(f"{v:.12g}" for v in row) for row in M) + "\n"


def redwood(tiny):
    for k in range(COUNT):
        tiny.color(f"color/{k + 1:05d}-{k * 33369:012d}.jpg")
        tiny.depth(f"depth/{k + 1:05d}-{k * 33000:012d}.png")
    K = [60.5, 0, 0, 0, 61.5, 0, 31.5, 23.5, 1]
    tiny.text("camera_intrinsic.json", json.dumps({"width": 64, "height": 48, "intrinsic_matrix": K}))
    tiny.text("trajectory.log", "".join(f"{k} {k} {k + 1}\n{matrix_text(T)}" for k, T in enumerate(T_TRUE)))
    return {"layout": "open3d", "fx": 60.5, "cy": 23.5, "scale": 1000, "first_s": 0}


def seven_scenes(tiny):
    for k in range(COUNT):
        tiny.color(f"frame-{k:06d}.color.png", 640, 480)
        tiny.depth(f"frame-{k:06d}.depth.png", 640, 480)
        tiny.text(f"frame-{k:06d}.pose.txt", matrix_text(T_TRUE[k]))
    return {"layout": "7-scenes", "fx": 585, "cy": 240, "scale": 1000, "first_s": 0}


def icl_nuim(tiny):
    F = np.diag([1.0, -1, 1, 1])
    for k in range(1, COUNT + 1):
        tiny.color(f"rgb/{k}.png", 640, 480)
        tiny.depth(f"depth/{k}.png", 640, 480)
    write_trajectory(tiny.root / "livingRoom0.gt.freiburg", Trajectory(np.arange(1.0, COUNT + 1), F @ T_TRUE @ F))
    return {"layout": "icl-nuim", "fx": 481.2, "cy": 239.5, "scale": 5000, "first_s": 1 / 30}


def scannet(tiny):
    for k in range(COUNT):
        tiny.color(f"color/{k}.jpg", 130, 97)
        tiny.depth(f"depth/{k}.png", 64, 48)
        tiny.text(f"pose/{k}.txt", matrix_text(T_TRUE[k]))
    K = np.eye(4)
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = 117, 118, 64, 48
    tiny.text("intrinsic/intrinsic_color.txt", matrix_text(K))
    return {"layout": "scannet", "fx": 117, "cy": 48, "scale": 1000, "first_s": 0}


def polycam(tiny):
    for k in range(COUNT):
        name = f"{5_000_000 + 100_000 * k}"
        tiny.color(f"keyframes/images/{name}.jpg", 128, 96)
        tiny.depth(f"keyframes/depth/{name}.png", 32, 24)
        camera = {"fx": 100 + 5 * (k == 3), "fy": 100.0, "cx": 63.5, "cy": 47.5, "width": 128, "height": 96}
        T = T_TRUE[k] @ OPENGL
        camera |= {f"t_{r}{c}": T[r, c] for r in range(3) for c in range(4)}
        tiny.text(f"keyframes/cameras/{name}.json", json.dumps(camera))
    return {"layout": "polycam", "fx": 100, "cy": 47.5, "scale": 1000, "first_s": 5.0}


def record3d(tiny):
    T = T_TRUE @ OPENGL
    poses = np.hstack([Rotation.from_matrix(T[:, :3, :3]).as_quat(), T[:, :3, 3]]).tolist()
    for k in range(COUNT):
        tiny.color(f"rgb/{k}.jpg", 96, 128)
        tiny.depth(f"depth/{k}.png", 24, 32)
    data = {"w": 96, "h": 128, "dw": 24, "dh": 32, "fps": 60, "K": [90, 0, 0, 0, 91, 0, 47.5, 63.5, 1], "poses": poses}
    tiny.text("metadata.json", json.dumps(data))
    return {"layout": "record3d", "fx": 90, "cy": 63.5, "scale": 1000, "first_s": 0}


SAMPLES = [redwood, seven_scenes, icl_nuim, scannet, polycam, record3d]


@pytest.mark.parametrize("sample", SAMPLES)
def test_layout_is_found_and_read(tiny, sample):
    expected = sample(tiny)
    sequence = open_sequence(tiny.root)
    assert sequence.layout == expected["layout"]
    assert open_sequence(tiny.root, layout=expected["layout"]) == sequence
    assert (sequence.camera.fx, sequence.camera.cy) == (expected["fx"], expected["cy"])
    assert sequence.camera.depth_scale == expected["scale"] and sequence.camera.source != "given"
    assert len(sequence.frames) == COUNT and sequence.frames[0].timestamp_s == pytest.approx(expected["first_s"])
    scan = read_scan(sequence, 1)
    assert scan.color.shape == (sequence.camera.height, sequence.camera.width, 3)
    assert scan.depth_m.shape == scan.color.shape[:2]
    assert 3000 / expected["scale"] <= scan.depth_m.min() and scan.depth_m.max() < 20000 / expected["scale"]
    truth = read_ground_truth(open_sequence(tiny.root, max_frames=2))
    np.testing.assert_allclose(truth.timestamps_s, [f.timestamp_s for f in sequence.frames], atol=1e-9)
    np.testing.assert_allclose(truth.T_world_cam, T_TRUE, atol=1e-7)


@pytest.mark.parametrize("sample", SAMPLES)
def test_given_camera_and_camera_yaml_overrule(tiny, sample, tmp_path):
    sample(tiny)
    camera = open_sequence(tiny.root).camera
    text = f"fx: 77\nfy: 77\ncx: 20\ncy: 20\nwidth: {camera.width}\nheight: {camera.height}\ndepth_scale: 2000\n"
    tiny.text("camera.yaml", text)
    assert open_sequence(tiny.root).camera.depth_scale == 2000
    (tmp_path / "mine.yaml").write_text(text.replace("77", "78"))
    assert open_sequence(tiny.root, camera_path=tmp_path / "mine.yaml").camera.fx == 78


@pytest.mark.parametrize("sample", SAMPLES)
def test_missing_depth_image_drops_the_frame(tiny, sample):
    sample(tiny)
    frames = open_sequence(tiny.root).frames
    frames[2].depth.path.unlink()
    sequence = open_sequence(tiny.root)
    assert sequence.frames == (*frames[:2], frames[3])
    assert any("3 pairs from 4 colour and 3 depth" in str(note) for note in sequence.notes)


def test_every_layout_describes_itself():
    for entry in known_layouts().values():
        layout = entry.load()
        assert layout.__doc__ and layout.open.__doc__ and layout.ground_truth.__doc__


def test_lower_resolution_depth_is_sampled_not_mixed(tiny):
    scannet(tiny)
    depth = np.where(np.arange(64) < 32, 1000, 4000).astype(np.uint16)[None].repeat(48, 0)
    tiny.put("depth/0.png", depth)
    scan = read_scan(open_sequence(tiny.root), 0)
    assert set(np.unique(scan.depth_m)) == {1.0, 4.0}
    assert (scan.depth_m[:, 0] == 1).all() and (scan.depth_m[:, 64] == 1).all() and (scan.depth_m[:, 66] == 4).all()
    tiny.put("depth/0.png", depth[:, :40])
    with pytest.raises(InputError, match=r"frame 0 \(depth/0\.png\): .*not the same field of view"):
        read_scan(open_sequence(tiny.root), 0)


def test_seven_scenes_marks_no_reading_by_65535(tiny):
    seven_scenes(tiny)
    depth = np.full((480, 640), 1500, np.uint16)
    depth[:, :100] = 65535
    tiny.put("frame-000000.depth.png", depth)
    scan = read_scan(open_sequence(tiny.root), 0)
    assert (scan.depth_m[:, :100] == 0).all() and (scan.depth_m[:, 100:] == 1.5).all()


def test_lost_tracking_leaves_the_frame_out(tiny):
    scannet(tiny)
    tiny.text("pose/1.txt", "-inf -inf -inf -inf\n" * 4)
    assert len(read_ground_truth(open_sequence(tiny.root)).timestamps_s) == COUNT - 1
    tiny.text("pose/2.txt", matrix_text(2 * np.eye(4)))
    with pytest.raises(InputError, match=r"pose/2\.txt: not a rigid transformation"):
        read_ground_truth(open_sequence(tiny.root))


def test_zoom_of_a_phone_is_noted(tiny):
    polycam(tiny)
    assert any("focal length varies by up to 5.0 %" in str(note) for note in open_sequence(tiny.root).notes)


def test_record3d_depth_in_exr(tiny):
    record3d(tiny)
    for path in list((tiny.root / "depth").iterdir()):
        write_exr(path.with_suffix(".exr"), R=np.full((32, 24), 1.5, np.float32))
        path.unlink()
    sequence = open_sequence(tiny.root)
    assert any("read as metres" in str(note) for note in sequence.notes)
    depth_m = read_scan(sequence, 0).depth_m
    assert set(np.unique(depth_m)) <= {np.float32(0), np.float32(1.5)} and (depth_m == 1.5).any()


def test_redwood_without_intrinsics_says_so(tiny):
    for k in range(2):
        tiny.color(f"image/{k}.png", 640, 480)
        tiny.depth(f"depth/{k}.png", 640, 480)
    camera = open_sequence(tiny.root).camera
    assert camera.fx == 525 and "no intrinsic.json" in camera.source


@pytest.mark.parametrize(
    "text", ["", "[]", "{", "{}", '{"intrinsic_matrix": [1, 2]}', '{"intrinsic_matrix": "x"}', "[" * 9999]
)
def test_broken_json_is_named(tiny, text):
    redwood(tiny)
    tiny.text("camera_intrinsic.json", text)
    with pytest.raises((ConfigError, InputError), match=r"camera_intrinsic\.json"):
        open_sequence(tiny.root)
