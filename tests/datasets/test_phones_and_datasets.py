"""Recordings of phone apps and data sets as their own tools write them: found, decoded, camera, times, poses."""

import json
import pickle
import struct
import sys
import threading
import zipfile
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
import recorded_by_apps as apps

from miniloop_cli.datasets import open_sequence, read_ground_truth, read_scan
from miniloop_cli.errors import ConfigError, InputError, MiniloopError
from miniloop_cli.scene.sequence import NoteKind

SHOTS = apps.made_up()
BIG = apps.made_up(size=(512, 384))
VGA = apps.made_up(3, size=(640, 480), depth=(640, 480))
UPRIGHT = apps.made_up(size=(384, 512), depth=(192, 256))
SELFIE = apps.made_up(3, size=(480, 640), depth=(480, 640))


def as_folder(make, **how):
    return lambda root, shots: make(root / "recording", shots, **how)


def as_file(make, name, **how):
    return lambda root, shots: make(root / name, shots, **how)


def polycam_zip(root, shots):
    return apps.zipped(apps.polycam(root / "capture", shots), root / "capture.zip")


def stray_zip(root, shots):
    return apps.zipped(apps.stray_scanner(root / "71de12f9", shots), root / "71de12f9.zip")


def r3d_unpacked(root, shots):
    zipfile.ZipFile(apps.record3d_file(root / "a.r3d", shots)).extractall(root / "unpacked")
    return root / "unpacked"


# name: layout, writer, frames, largest difference of colour (0: lossless) and of depth (m)
CASES = {
    "record3d": ("record3d-file", as_file(apps.record3d_file, "a.r3d"), UPRIGHT, 6, 0),
    "record3d landscape": ("record3d-file", as_file(apps.record3d_file, "a.r3d"), BIG, 6, 0),
    "record3d faceid": ("record3d-file", as_file(apps.record3d_file, "a.r3d"), SELFIE, 6, 0),
    "record3d unpacked": ("record3d-file", r3d_unpacked, UPRIGHT, 6, 0),
    "stray scanner": ("stray-scanner", as_folder(apps.stray_scanner), BIG, 8, 0.0006),
    "stray scanner 2024": ("stray-scanner", as_folder(apps.stray_scanner, form="2024"), BIG, 8, 0.0006),
    "stray scanner hevc": ("stray-scanner", as_folder(apps.stray_scanner, encoder="libx265"), BIG, 8, 0.0006),
    "scannetpp hevc": ("scannetpp", as_folder(apps.scannetpp, encoder="libx265"), BIG, 8, 0.0006),
    "stray scanner zip": ("stray-scanner", stray_zip, BIG, 8, 0.0006),
    "polycam": ("polycam", as_folder(apps.polycam), BIG, 6, 0.0006),
    "polycam zip": ("polycam", polycam_zip, BIG, 6, 0.0006),
    "arkitscenes": ("arkitscenes", as_folder(apps.arkitscenes), SHOTS, 0, 0.0006),
    "scannet sens": ("scannet-sens", as_file(apps.scannet_sens, "scene0000_00.sens"), BIG, 6, 0.0006),
    "scannet sens png raw": (
        "scannet-sens",
        as_file(apps.scannet_sens, "a.sens", color=".png", raw=True),
        BIG,
        0,
        0.0006,
    ),
    "scannetpp lz4": ("scannetpp", as_folder(apps.scannetpp), BIG, 8, 0.0006),
    "scannetpp deflate": ("scannetpp", as_folder(apps.scannetpp, form="deflate"), BIG, 8, 0),
    "scannetpp stream": ("scannetpp", as_folder(apps.scannetpp, form="stream"), BIG, 8, 0),
    "replica": ("replica", as_folder(apps.replica), SHOTS, 6, 0.0002),
    "bop": ("bop", as_folder(apps.bop), SHOTS, 0, 0.0001),
    "bop units": ("bop", as_folder(apps.bop, mm_a_unit=(0.1, 1.0)), SHOTS, 0, 0.0006),
    "eth3d": ("eth3d", as_folder(apps.eth3d), SHOTS, 0, 0.0002),
    "bonn": ("bonn", as_folder(apps.bonn), VGA, 0, 0.0002),
    "openloris": ("openloris", as_folder(apps.openloris), SHOTS, 0, 0.0006),
    "nerfcapture": ("nerfstudio", as_folder(apps.nerfcapture), SHOTS, 0, 0.0002),
    "nerfstudio": ("nerfstudio", as_folder(apps.nerfstudio), SHOTS, 0, 0.0006),
}
NEEDS_NUMBERS = ("replica", "bop", "bop units", "nerfstudio")  # no times: frames are 1/30 s apart
OWN_CAMERA = ("bonn",)


@pytest.fixture(scope="module", params=CASES)
def case(request, tmp_path_factory):
    layout, write, shots, color_off, depth_off = CASES[request.param]
    return request.param, layout, write(tmp_path_factory.mktemp("recording"), shots), shots, color_off, depth_off


def test_recording_is_read_as_it_was_written(case):
    name, layout, path, shots, color_off, depth_off = case
    sequence = open_sequence(path)
    assert sequence.layout == layout and sequence == open_sequence(path, layout=layout)
    assert len(sequence.frames) == len(shots.color)
    times = np.arange(len(shots.color)) / 30 if name in NEEDS_NUMBERS else shots.times_s
    np.testing.assert_allclose([f.timestamp_s for f in sequence.frames], times, atol=1e-3)
    if name not in OWN_CAMERA:
        np.testing.assert_allclose(sequence.camera.K, shots.K, rtol=1e-5)
    assert (sequence.camera.width, sequence.camera.height) == shots.size
    assert not sequence.camera.depth_scale_assumed or name == "nerfstudio"
    for k, (color, depth_m) in enumerate(zip(shots.color, shots.depth_m, strict=True)):
        scan = read_scan(sequence, k)
        assert np.abs(scan.color.astype(int) - color).mean() <= color_off
        wanted = cv2.resize(depth_m, shots.size, interpolation=cv2.INTER_NEAREST_EXACT)
        assert np.abs(scan.depth_m - wanted).max() <= depth_off
        assert frame_of(sequence, k) == frame_of(pickle.loads(pickle.dumps(sequence)), k)


def frame_of(sequence, k):
    frame = sequence.frames[k]
    return frame, frame.color.fingerprint(), frame.depth.fingerprint(), frame.color.header(), frame.depth.header()


def test_reference_poses_are_camera_to_world_with_our_axes(case):
    _, _, path, shots, _, _ = case
    sequence = open_sequence(path)
    truth = read_ground_truth(open_sequence(path, max_frames=2))
    assert truth is not None
    np.testing.assert_allclose(truth.timestamps_s, [f.timestamp_s for f in sequence.frames], atol=1e-3)
    np.testing.assert_allclose(truth.T_world_cam, shots.T_world_cam, atol=2e-6)


def test_images_have_fingerprints_of_their_own(case):
    _, _, path, shots, _, _ = case
    frames = open_sequence(path).frames
    for kind in ("color", "depth"):
        assert len({getattr(frame, kind).fingerprint() for frame in frames}) == len(shots.color)


def test_given_camera_overrules(case, tmp_path):
    _, _, path, shots, _, _ = case
    text = f"fx: 321\nfy: 322\ncx: 20\ncy: 20\nwidth: {shots.size[0]}\nheight: {shots.size[1]}\ndepth_scale: 2000\n"
    (tmp_path / "mine.yaml").write_text(text)
    sequence = open_sequence(path, camera_path=tmp_path / "mine.yaml")
    assert (sequence.camera.fx, sequence.camera.fy) == (321, 322)
    assert all(frame.camera is None for frame in sequence.frames)


CONFIDENT = [name for name in CASES if name.split()[0] in ("record3d", "stray", "polycam", "arkitscenes")]


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIDENT)
def test_depth_of_low_confidence_is_no_reading(name, tmp_path):
    _, write, shots, _, _ = CASES[name]
    maps = [np.full(image.shape, 2, np.uint8) for image in shots.depth_m]
    for image in maps:
        third = image.shape[1] // 3
        image[:, :third], image[:, third : 2 * third] = 0, 1
    path = write(tmp_path, replace(shots, confidence=maps))
    for least, share in ((0, 0), (1, 1 / 3), (2, 2 / 3)):
        sequence = open_sequence(path, min_confidence=least)
        assert (read_scan(sequence, 1).depth_m == 0).mean() == pytest.approx(share, abs=0.01)
        said = [str(note) for note in sequence.notes if "confidence of each depth reading" in str(note)]
        assert len(said) == 1 and f"depth.min_confidence = {least}" in said[0]
    prints = {open_sequence(path, min_confidence=k).frames[0].depth.fingerprint() for k in (0, 1, 2)}
    assert len(prints) == 3
    assert open_sequence(path) == open_sequence(path, min_confidence=1)


def test_maps_that_are_missing_are_counted(tmp_path):
    root = apps.stray_scanner(tmp_path / "a", BIG)
    (root / "confidence/000002.png").unlink()
    notes = [str(note) for note in open_sequence(root).notes]
    assert "confidence/ has maps for 5 of 6 frames: all depth of the others is used" in notes


def test_polycam_says_which_images_are_used(tmp_path):
    both = open_sequence(apps.polycam(tmp_path / "both", BIG))
    assert "corrected_images" in both.frames[0].color.name and both.ground_truth_path.name == "corrected_cameras"
    assert any("keyframes/images are not" in str(note) for note in both.notes)
    raw = open_sequence(apps.polycam(tmp_path / "raw", BIG, corrected=False))
    assert "/keyframes/images/" in raw.frames[0].color.name and raw.ground_truth_path.name == "cameras"


def test_bop_images_with_principal_points_of_their_own(tmp_path):
    sequence = open_sequence(apps.bop(tmp_path, SHOTS, shift_px=8.0))
    assert any("the principal point varies by up to 4.0 px" in str(note) for note in sequence.notes)
    assert all(frame.camera is not None for frame in sequence.frames)


def test_sens_depth_with_intrinsics_of_its_own_is_registered(tmp_path):
    K = BIG.K.copy()
    K[:2] *= 0.41  # the depth camera sees more than colour, whose scale is 0.5
    K[0, 2], K[1, 2] = 127.63, 95.41
    sequence = open_sequence(apps.scannet_sens(tmp_path / "a.sens", BIG, depth_K=K))
    assert any("registered to colour as it is read" in str(note) for note in sequence.notes)
    depth_m = read_scan(sequence, 0).depth_m
    u, v = np.meshgrid(np.arange(512), np.arange(384))
    x, y = (u - BIG.K[0, 2]) / BIG.K[0, 0] * K[0, 0] + K[0, 2], (v - BIG.K[1, 2]) / BIG.K[1, 1] * K[1, 1] + K[1, 2]
    wanted = BIG.depth_m[0][np.rint(y).astype(int), np.rint(x).astype(int)]
    assert (depth_m > 0).mean() > 0.98
    np.testing.assert_allclose(depth_m[depth_m > 0], wanted[depth_m > 0], atol=0.012)  # of two pixels of its slope


def test_sens_depth_of_another_place_is_refused(tmp_path):
    path = apps.scannet_sens(tmp_path / "a.sens", BIG)
    data = bytearray(path.read_bytes())
    start = 12 + len(b"StructureSensor") + 3 * 64 + 3 * 4  # x of the depth camera
    data[start : start + 4] = struct.pack("<f", 0.05)
    path.write_bytes(data)
    with pytest.raises(InputError, match="50 mm apart: depth is not registered"):
        open_sequence(path)


def test_sens_without_times_and_with_lost_tracking(tmp_path):
    T = SHOTS.T_world_cam.copy()
    T[2] = -np.inf
    path = apps.scannet_sens(tmp_path / "a.sens", replace(SHOTS, T_world_cam=T, times_s=np.zeros(6)))
    sequence = open_sequence(path)
    assert any("no time stamps: 30 frames a second" in str(note) for note in sequence.notes)
    truth = read_ground_truth(sequence)
    np.testing.assert_allclose(truth.timestamps_s * 30, [0, 1, 3, 4, 5])


def test_replica_without_its_camera_uses_nice_slams(tmp_path):
    root = apps.replica(tmp_path, apps.made_up(2, (1200, 680), (1200, 680)))
    (tmp_path / "cam_params.json").unlink()
    sequence = open_sequence(root)
    assert (sequence.camera.fx, sequence.camera.depth_scale) == (600, 6553.5) and sequence.camera.depth_scale_assumed
    assert any("depth_scale 6553.5" in str(note) for note in sequence.notes)


def test_openloris_without_transformations_has_no_reference(tmp_path):
    root = apps.openloris(tmp_path / "cafe1-1", SHOTS)
    (root / "trans_matrix.yaml").unlink()
    sequence = open_sequence(root)
    assert read_ground_truth(sequence) is None
    assert any("poses of the robot's base" in str(note) for note in sequence.notes)


def test_depth_scale_that_is_no_length_is_refused(tmp_path):
    root = apps.nerfcapture(tmp_path / "a", SHOTS)
    text = (root / "transforms.json").read_text().replace(str(10 / 65535), "6553.5")
    (root / "transforms.json").write_text(text)
    with pytest.raises(InputError, match=r"integer_depth_scale is metres a unit of depth; 6553\.5 cannot be"):
        open_sequence(root)
    unstated = open_sequence(apps.nerfcapture(tmp_path / "b", SHOTS, stated=False))
    assert unstated.camera.depth_scale == 1000 and unstated.camera.depth_scale_assumed


@pytest.mark.parametrize("per_s", [1, 1000, 1e6, 1e9])
def test_stamps_of_transforms_are_read_in_their_unit(tmp_path, per_s):
    root = apps.nerfcapture(tmp_path / "a", SHOTS)
    path = root / "transforms.json"
    data = json.loads(path.read_text())
    for frame, time_s in zip(data["frames"], SHOTS.times_s, strict=True):
        frame["timestamp"] = time_s * per_s
    path.write_text(json.dumps(data))
    sequence = open_sequence(root)
    np.testing.assert_allclose([frame.timestamp_s for frame in sequence.frames], SHOTS.times_s, atol=1e-6)
    np.testing.assert_allclose(read_ground_truth(sequence).timestamps_s, SHOTS.times_s, atol=1e-6)
    assert any("converted to seconds" in str(note) for note in sequence.notes) == (per_s > 1)


def test_stamps_of_transforms_without_a_clear_unit_are_refused(tmp_path):
    root = apps.nerfcapture(tmp_path / "a", SHOTS)
    path = root / "transforms.json"
    data = json.loads(path.read_text())
    for k, frame in enumerate(data["frames"]):
        frame["timestamp"] = 5 * k
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match="steps by 5: seconds or milliseconds"):
        open_sequence(root)


def test_most_frames_without_images_are_a_doubt(tmp_path):
    root = apps.nerfcapture(tmp_path / "a", SHOTS)
    count = len(SHOTS.color)
    for k in range(2, count):
        (root / f"images/{k}.depth.png").unlink()
    (note,) = (note for note in open_sequence(root).notes if "lack an image" in str(note))
    assert note.kind == NoteKind.MOST_DROPPED


@pytest.mark.parametrize("lost", [0, 3, 5])
def test_frames_without_depth_move_no_other_frame(tmp_path, lost):
    """The table has a row for each frame of the video: it says which depth images are missing."""
    whole = open_sequence(apps.stray_scanner(tmp_path / "a", BIG))
    root = apps.stray_scanner(tmp_path / "b", BIG)
    (root / f"depth/{lost:06d}.png").unlink()
    sequence = open_sequence(root)
    assert any("5 pairs from 6 colour and 5 depth images" in str(note) for note in sequence.notes)
    kept = [frame for k, frame in enumerate(whole.frames) if k != lost]
    for frame, expected in zip(sequence.frames, kept, strict=True):
        assert frame.timestamp_s == expected.timestamp_s
        assert np.array_equal(frame.color.read(), expected.color.read())
        assert np.array_equal(frame.depth.read(), expected.depth.read())


def test_video_depth_and_table_of_different_lengths_are_refused(tmp_path):
    root = apps.stray_scanner(tmp_path / "a", BIG)
    (root / "depth/000003.png").unlink()
    rows = (root / "odometry.csv").read_text().splitlines()
    (root / "odometry.csv").write_text("\n".join(rows[:-2]))
    with pytest.raises(InputError, match=r"6 frames, but there are 5 depth images and 4 rows in odometry\.csv"):
        open_sequence(root)
    first = apps.stray_scanner(tmp_path / "b", BIG, form="first")  # its table has no numbers of frames
    (first / "depth/000003.png").unlink()
    with pytest.raises(InputError, match="it is not known which belong together"):
        open_sequence(first)


def test_first_recordings_of_stray_scanner_have_the_times_of_the_video(tmp_path):
    sequence = open_sequence(apps.stray_scanner(tmp_path / "a", BIG, form="first", rate=60))
    np.testing.assert_allclose([f.timestamp_s for f in sequence.frames], np.arange(6) / 60, atol=1e-4)
    assert any("those of rgb.mp4 are used" in str(note) and note.doubtful for note in sequence.notes)
    np.testing.assert_allclose(read_ground_truth(sequence).T_world_cam, BIG.T_world_cam, atol=2e-6)


def test_cameras_of_single_frames_of_stray_scanner(tmp_path):
    root = apps.stray_scanner(tmp_path / "a", BIG)
    rows = (root / "odometry.csv").read_text().splitlines()
    cells = rows[3].split(",")
    cells[9] = cells[10] = f" {1.03 * BIG.K[0, 0]}"
    (root / "odometry.csv").write_text("\n".join([*rows[:3], ",".join(cells), *rows[4:]]))
    sequence = open_sequence(root)
    assert [frame.camera is not None for frame in sequence.frames] == [False, False, True, False, False, False]
    assert sequence.camera.fx == pytest.approx(BIG.K[0, 0])
    assert "median of the cameras" in sequence.camera.source


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [40, 3, 39, 4], [7, 7, 8, 6], [49, 0, 25, 24]])
def test_video_frames_in_any_order(tmp_path, order):
    from miniloop_cli.datasets.video import video_frames

    images = [np.full((64, 80, 3), 5 * k, np.uint8) for k in range(50)]
    frames, times_s = video_frames(apps.video(tmp_path / "v.mp4", images, rate=25, gop=16))
    assert len(frames) == 50
    np.testing.assert_allclose(np.diff(times_s), 0.04, atol=1e-6)
    for k in order:
        assert np.abs(frames[k].read().astype(int) - 5 * k).mean() < 2


def test_next_frame_of_a_video_needs_no_seek(tmp_path, monkeypatch):
    from miniloop_cli.datasets import video

    frames, _ = video.video_frames(
        apps.video(tmp_path / "v.mp4", [np.full((64, 80, 3), k, np.uint8) for k in range(40)])
    )
    starts = []
    start = video._Video._start
    monkeypatch.setattr(video._Video, "_start", lambda self, pts: (starts.append(pts), start(self, pts)))
    for frame in frames:
        frame.read()
    assert len(starts) == 1


def test_threads_share_a_video(tmp_path):
    from miniloop_cli.datasets.video import video_frames

    frames, _ = video_frames(apps.video(tmp_path / "v.mp4", [np.full((64, 80, 3), 5 * k, np.uint8) for k in range(40)]))
    off = []

    def read(first):
        for k in range(first, 40, 3):
            off.append(np.abs(frames[k].read().astype(int) - 5 * k).mean())

    threads = [threading.Thread(target=read, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(off) == 40 and max(off) < 2


@pytest.mark.parametrize(
    ("module", "wheel", "name"),
    [("av", "av", "stray scanner"), ("liblzfse", "pyliblzfse", "record3d"), ("lz4.block", "lz4", "scannetpp lz4")],
)
def test_missing_wheel_is_named_with_its_extra(module, wheel, name, tmp_path, monkeypatch):
    _, write, shots, _, _ = CASES[name]
    path = write(tmp_path, shots)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MiniloopError, match=rf"the wheel {wheel} is needed: pip install 'miniloop\[phones\]'"):
        read_scan(open_sequence(path), 0)


def first_frame(path):
    """Opens a recording and reads a frame of it, in the middle."""
    sequence = open_sequence(path)
    return read_scan(sequence, len(sequence.frames) // 2)


def test_sens_that_is_cut_off_keeps_its_whole_frames(tmp_path):
    path = apps.scannet_sens(tmp_path / "a.sens", SHOTS)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * 0.7)])
    sequence = open_sequence(path)
    assert 0 < len(sequence.frames) < 6
    assert any(f"ends after {len(sequence.frames)} of 6 frames" in str(note) for note in sequence.notes)
    read_scan(sequence, len(sequence.frames) - 1)


def test_video_without_an_index_is_refused_in_one_line(tmp_path):
    root = apps.stray_scanner(tmp_path / "a", BIG)
    data = (root / "rgb.mp4").read_bytes()
    (root / "rgb.mp4").write_bytes(data[: data.index(b"moov") - 4])
    with pytest.raises(InputError, match=r"rgb\.mp4: the video is damaged, cut off or without an index"):
        open_sequence(root)


def test_playlist_is_no_video(tmp_path):
    root = apps.stray_scanner(tmp_path / "a", BIG)
    (root / "rgb.mp4").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile:///etc/passwd\n#EXT-X-ENDLIST\n")
    with pytest.raises(InputError, match="not an MP4, MOV or Matroska video"):
        open_sequence(root)


def lzfse_bomb(stated: int, blocks: int = 40) -> bytes:
    """A block that holds 22 MB, again and again, each saying that it holds a part of `stated` bytes."""
    import liblzfse

    block = liblzfse.compress(bytes(22 << 20))[:-4]
    assert block[:4] == b"bvx2" and block.count(b"bvx2") == 1
    sizes = [stated // blocks + (k < stated % blocks) for k in range(blocks)]
    return b"".join(block[:4] + struct.pack("<I", size) + block[8:] for size in sizes) + b"bvx$"


@pytest.mark.slow
def test_bombs_are_not_unpacked(tmp_path):
    import liblzfse

    path = apps.record3d_file(tmp_path / "a.r3d", UPRIGHT)

    def with_member(name, data):
        with zipfile.ZipFile(path) as archive:
            held = {member: archive.read(member) for member in archive.namelist()}
        with zipfile.ZipFile(tmp_path / "b.r3d", "w", zipfile.ZIP_DEFLATED) as archive:
            for member, content in (held | {name: data}).items():
                archive.writestr(member, content)
        return tmp_path / "b.r3d"

    with pytest.raises(InputError, match=r"rgbd/3\.depth.*67108864 bytes of pixels instead of 196608"):
        first_frame(with_member("rgbd/3.depth", liblzfse.compress(bytes(64 << 20))))
    with pytest.raises(InputError, match=r"rgbd/3\.depth.*far more than the image; they are not unpacked"):
        first_frame(with_member("rgbd/3.depth", lzfse_bomb(UPRIGHT.depth_m[0].nbytes)))
    with pytest.raises(InputError, match=r"rgbd/3\.depth"):
        first_frame(with_member("rgbd/3.conf", liblzfse.compress(bytes(5))))
    with pytest.raises(InputError, match="metadata"):
        first_frame(with_member("metadata", b" " * (200 << 20)))
    sens = apps.scannet_sens(tmp_path / "a.sens", replace(SHOTS, color=SHOTS.color[:1], depth_m=SHOTS.depth_m[:1]))
    data = sens.read_bytes()
    small, big = zlib.compress(apps.stored_mm(SHOTS.depth_m[0]).tobytes()), zlib.compress(bytes(300 << 20), 9)
    data = data.replace(struct.pack("<Q", len(small)), struct.pack("<Q", len(big)), 1).replace(small, big)
    sens.write_bytes(data)
    with pytest.raises(InputError, match="98305 bytes, expected 98304"):
        first_frame(sens)


@pytest.mark.parametrize("frames", [0, 1, 2**63])
def test_sens_may_claim_what_it_likes(tmp_path, frames):
    path = apps.scannet_sens(tmp_path / "a.sens", SHOTS)
    data = bytearray(path.read_bytes())
    start = 12 + len(b"StructureSensor") + 4 * 64 + 7 * 4
    data[start : start + 8] = struct.pack("<Q", frames)
    path.write_bytes(data)
    if frames:
        assert len(open_sequence(path).frames) == min(frames, 6)
    else:
        with pytest.raises(InputError, match="no whole frame of the 0"):
            open_sequence(path)


def test_frames_of_transforms_stay_in_the_folder(tmp_path):
    root = apps.nerfcapture(tmp_path / "a", SHOTS)
    data = json.loads((root / "transforms.json").read_text())
    data["frames"][2]["depth_path"] = "../../etc/passwd"
    (root / "transforms.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match="frame 2 points outside the sequence"):
        open_sequence(root)


def test_video_behind_a_link_needs_leave(tmp_path):
    root = apps.stray_scanner(tmp_path / "a", BIG)
    (root / "rgb.mp4").rename(tmp_path / "elsewhere.mp4")
    (root / "rgb.mp4").symlink_to(tmp_path / "elsewhere.mp4")
    with pytest.raises(InputError, match="--follow-links"):
        open_sequence(root)
    assert len(open_sequence(root, follow_links=True).frames) == 6


def test_wrong_types_in_json_are_named(tmp_path):
    root = apps.scannetpp(tmp_path / "a", BIG)
    path = root / "iphone/pose_intrinsic_imu.json"
    good = json.loads(path.read_text())
    for key, value, told in (
        ("timestamp", "noon", "timestamp: expected"),
        ("intrinsic", [1, 2], "frame_000001: intrinsic"),
        ("aligned_pose", "x", "frame_000001: aligned_pose"),
        ("aligned_pose", np.diag([2.0, 2, 2, 1]).tolist(), "not a rigid transformation"),
    ):
        bad = json.loads(json.dumps(good))
        bad["frame_000001"][key] = value
        path.write_text(json.dumps(bad))
        with pytest.raises((InputError, ConfigError), match=told):
            read_ground_truth(open_sequence(root))


@pytest.mark.parametrize("size", [[64], "x", None, {}])
def test_sizes_in_transforms_that_are_none(tmp_path, size):
    root = apps.nerfcapture(tmp_path / "a", SHOTS)
    data = json.loads((root / "transforms.json").read_text())
    data["frames"][1]["w"] = size
    (root / "transforms.json").write_text(json.dumps(data))
    with pytest.raises((InputError, ConfigError), match=r"transforms\.json"):
        open_sequence(root)
