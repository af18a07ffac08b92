"""Recordings of phone apps and data sets from given frames, written by what those apps use: ZIP, video, struct, JSON.

None of it uses miniloop. Each writer returns the path to open.
"""

import csv
import io
import json
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass
class Shots:
    """Frames to write: RGB (h, w, 3), depth (h', w') in metres, poses camera to world (OpenCV axes), times in s."""

    color: list[np.ndarray]
    depth_m: list[np.ndarray]
    T_world_cam: np.ndarray
    times_s: np.ndarray
    K: np.ndarray  # of the colour images
    confidence: list[np.ndarray] | None = None  # 0 low, 1 medium, 2 high; of the size of depth

    @property
    def size(self) -> tuple[int, int]:
        return self.color[0].shape[1], self.color[0].shape[0]


def made_up(count: int = 6, size: tuple[int, int] = (256, 192), depth: tuple[int, int] = (256, 192)) -> Shots:
    """Smooth colour that video codecs keep, depth of slopes, poses at random."""
    rng = np.random.default_rng(7)
    x, y = np.meshgrid(np.linspace(0, 1, size[0]), np.linspace(0, 1, size[1]))
    color = [
        np.stack([255 * x, 255 * y, np.full_like(x, 20 * (k % 12))], axis=2).astype(np.uint8) for k in range(count)
    ]
    u, v = np.meshgrid(np.linspace(0, 1, depth[0]), np.linspace(0, 1, depth[1]))
    depth_m = [(1 + u + 0.5 * v + 0.1 * k).astype(np.float32) for k in range(count)]
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=3).as_matrix()
    T[:, :3, 3] = rng.normal(0, 2, (count, 3))
    K = np.array([[0.8 * size[0], 0, size[0] / 2 - 0.5], [0, 0.8 * size[0], size[1] / 2 - 0.5], [0, 0, 1]])
    confidence = [np.full(depth[::-1], 2, np.uint8) for _ in range(count)]
    return Shots(color, depth_m, T, 100 + np.arange(count) / 30, K, confidence)


def encoded(image: np.ndarray, suffix: str = ".png", *parameters: int) -> bytes:
    done, data = cv2.imencode(suffix, image[..., ::-1] if image.ndim == 3 else image, parameters)
    assert done
    return data.tobytes()


def stored_mm(depth_m: np.ndarray, units_per_m: float = 1000.0) -> np.ndarray:
    return np.round(depth_m * units_per_m).astype(np.uint16)


def put(root: Path, name: str, data: bytes | str) -> None:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data.encode() if isinstance(data, str) else data)


def quaternions(T: np.ndarray) -> np.ndarray:
    return np.hstack([Rotation.from_matrix(T[:, :3, :3]).as_quat(), T[:, :3, 3]])


def video(
    path: Path,
    frames: list[np.ndarray],
    rate: int = 60,
    lossless: bool = False,
    gop: int = 12,
    encoder: str = "libx264",
) -> Path:
    """An MP4 of H.264 or, by libx265, of HEVC as ffmpeg writes it, with B-frames."""
    import av

    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        options = {"crf": "0" if lossless else "12", "g": str(gop), "bf": "2"}
        stream = container.add_stream(encoder, rate=rate, options=options)
        stream.width, stream.height = frames[0].shape[1], frames[0].shape[0]
        stream.pix_fmt = "yuv444p" if lossless else "yuv420p"
        for image in frames:
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


def stray_scanner(root: Path, shots: Shots, form: str = "new", **how: object) -> Path:
    """`form` of odometry.csv: new (with intrinsics), 2024 (without), or first (seven columns and no header)."""
    video(root / "rgb.mp4", shots.color, **how)
    names = ["timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw"]
    names += ["fx", "fy", "cx", "cy", "distortion_center_x", "distortion_center_y"] * (form == "new")
    rows = [] if form == "first" else [[names[0], *[f" {name}" for name in names[1:]]]]
    pinhole = [shots.K[0, 0], shots.K[1, 1], shots.K[0, 2], shots.K[1, 2]]
    for k, (q, t) in enumerate(zip(quaternions(shots.T_world_cam), shots.times_s, strict=True)):
        put(root, f"depth/{k:06d}.png", encoded(stored_mm(shots.depth_m[k])))
        if shots.confidence:
            put(root, f"confidence/{k:06d}.png", encoded(shots.confidence[k]))
        pose = [f" {v:.9f}" for v in (*q[4:], *q[:4])]
        own = [*[f" {v:.9g}" for v in pinhole], " ", " "] * (form == "new")
        rows.append(pose if form == "first" else [f"{t:.6f}", f" {k:06d}", *pose, *own])
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    put(root, "odometry.csv", text.getvalue())
    put(root, "camera_matrix.csv", "\n".join(", ".join(f"{v:.9g}" for v in row) for row in shots.K))
    return root


def record3d_file(path: Path, shots: Shots, quality: int = 95) -> Path:
    import liblzfse

    path.parent.mkdir(parents=True, exist_ok=True)
    (w, h), (dh, dw) = shots.size, shots.depth_m[0].shape
    T = quaternions(shots.T_world_cam @ OPENGL)
    data = {"w": w, "h": h, "dw": dw, "dh": dh, "fps": 30, "K": shots.K.T.ravel().tolist(), "poses": T.tolist()}
    data |= {"frameTimestamps": shots.times_s.tolist(), "initPose": T[0].tolist()}
    data["perFrameIntrinsicCoeffs"] = [[shots.K[0, 0], shots.K[1, 1], shots.K[0, 2], shots.K[1, 2]]] * len(shots.color)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", json.dumps(data))
        archive.writestr("icon", encoded(shots.color[0], ".jpg"))
        for k, image in enumerate(shots.color):
            archive.writestr(f"rgbd/{k}.jpg", encoded(image, ".jpg", cv2.IMWRITE_JPEG_QUALITY, quality))
            archive.writestr(f"rgbd/{k}.depth", liblzfse.compress(shots.depth_m[k].astype("<f4").tobytes()))
            if shots.confidence:
                archive.writestr(f"rgbd/{k}.conf", liblzfse.compress(shots.confidence[k].tobytes()))
    return path


def polycam(root: Path, shots: Shots, corrected: bool = True) -> Path:
    kinds = [("images", "cameras")] + [("corrected_images", "corrected_cameras")] * corrected
    for k, image in enumerate(shots.color):
        name = f"{round(shots.times_s[k] * 1e6)}"
        for images, cameras in kinds:
            put(root, f"keyframes/{images}/{name}.jpg", encoded(image, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 95))
            T = shots.T_world_cam[k] @ OPENGL
            T = T if cameras == "corrected_cameras" or not corrected else T + 0.0 * T
            camera = {f"t_{i}{j}": T[i, j] for i in range(3) for j in range(4)}
            camera |= {"fx": shots.K[0, 0], "fy": shots.K[1, 1], "cx": shots.K[0, 2], "cy": shots.K[1, 2]}
            camera |= {"width": shots.size[0], "height": shots.size[1], "blur_score": 100.0, "timestamp": int(name)}
            put(root, f"keyframes/{cameras}/{name}.json", json.dumps(camera))
        put(root, f"keyframes/depth/{name}.png", encoded(stored_mm(shots.depth_m[k])))
        if shots.confidence:
            levels = np.array([0, 127, 255], np.uint8)[shots.confidence[k]]
            put(root, f"keyframes/confidence/{name}.png", encoded(levels))
    return root


def zipped(folder: Path, path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                archive.write(file, file.relative_to(folder.parent))
    return path


def arkitscenes(root: Path, shots: Shots, video_id: str = "47333462") -> Path:
    folder = root / video_id / f"{video_id}_frames"
    rows = []
    for k, image in enumerate(shots.color):
        name = f"{video_id}_{shots.times_s[k]:.3f}"
        put(folder, f"lowres_wide/{name}.png", encoded(image))
        put(folder, f"lowres_depth/{name}.png", encoded(stored_mm(shots.depth_m[k])))
        if shots.confidence:
            put(folder, f"confidence/{name}.png", encoded(shots.confidence[k]))
        shifted = f"{video_id}_{shots.times_s[k] + 0.001 * (k % 3 - 1):.3f}"
        numbers = (*shots.size, shots.K[0, 0], shots.K[1, 1], shots.K[0, 2], shots.K[1, 2])
        put(folder, f"lowres_wide_intrinsics/{shifted}.pincam", " ".join(f"{v:.6g}" for v in numbers))
        T_cam_world = np.linalg.inv(shots.T_world_cam[k])
        turn = Rotation.from_matrix(T_cam_world[:3, :3]).as_rotvec()
        rows.append(" ".join(f"{v:.12g}" for v in (shots.times_s[k], *turn, *T_cam_world[:3, 3])))
    put(folder, "lowres_wide.traj", "\n".join(rows) + "\n")
    return root / video_id


def scannet_sens(
    path: Path, shots: Shots, depth_K: np.ndarray | None = None, color: str = ".jpg", raw: bool = False
) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    (w, h), (dh, dw) = shots.size, shots.depth_m[0].shape
    K, Kd = np.eye(4), np.eye(4)
    K[:3, :3] = shots.K
    s = np.array([dw / w, dh / h])
    Kd[:3, :3] = shots.K if depth_K is None else depth_K
    if depth_K is None:
        Kd[:2, :2] *= s[:, None]
        Kd[:2, 2] = (shots.K[:2, 2] + 0.5) * s - 0.5
    name = b"StructureSensor"
    out = [struct.pack("<IQ", 4, len(name)), name]
    out += [struct.pack("<16f", *M.ravel()) for M in (K, np.eye(4), Kd, np.eye(4))]
    out.append(struct.pack("<ii4If", {".png": 1, ".jpg": 2}[color], 0 if raw else 1, w, h, dw, dh, 1000.0))
    out.append(struct.pack("<Q", len(shots.color)))
    for k, image in enumerate(shots.color):
        pixels = encoded(image, color, *((cv2.IMWRITE_JPEG_QUALITY, 95) if color == ".jpg" else ()))
        depth = stored_mm(shots.depth_m[k]).astype("<u2").tobytes()
        depth = depth if raw else zlib.compress(depth)
        stamp = round(shots.times_s[k] * 1e6)
        out.append(struct.pack("<16f4Q", *shots.T_world_cam[k].ravel(), stamp, stamp + 900, len(pixels), len(depth)))
        out += [pixels, depth]
    out.append(struct.pack("<Q", 0))  # readings of an accelerometer
    path.write_bytes(b"".join(out))
    return path


def scannetpp(root: Path, shots: Shots, form: str = "lz4", **how: object) -> Path:
    """`form` of depth.bin: lz4 and deflate by frame, or one stream."""
    import lz4.block

    folder = root / "iphone"
    video(folder / "rgb.mp4", shots.color, **how)
    blocks = []
    for depth_m in shots.depth_m:
        plain = depth_m.astype("<f4").tobytes()
        if form == "lz4":
            blocks.append(lz4.block.compress(stored_mm(depth_m).astype("<u2").tobytes(), store_size=False))
        elif form == "deflate":
            packer = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)
            blocks.append(packer.compress(plain) + packer.flush())
        else:
            blocks.append(plain)
    if form == "stream":
        packer = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)
        put(folder, "depth.bin", packer.compress(b"".join(blocks)) + packer.flush())
    else:
        put(folder, "depth.bin", b"".join(struct.pack("<I", len(block)) + block for block in blocks))
    entries = {}
    for k, T in enumerate(shots.T_world_cam):
        entry = {"timestamp": shots.times_s[k], "pose": (T + 50).tolist(), "aligned_pose": T.tolist()}
        entries[f"frame_{k:06d}"] = entry | {"intrinsic": shots.K.tolist(), "imu": {}}
    put(folder, "pose_intrinsic_imu.json", json.dumps(entries))
    return root


def replica(root: Path, shots: Shots, quality: int = 95) -> Path:
    for k, image in enumerate(shots.color):
        put(root, f"room0/results/frame{k:06d}.jpg", encoded(image, ".jpg", cv2.IMWRITE_JPEG_QUALITY, quality))
        put(root, f"room0/results/depth{k:06d}.png", encoded(stored_mm(shots.depth_m[k], 6553.5)))
    rows = [" ".join(f"{v:.12e}" for v in T.ravel()) for T in shots.T_world_cam]
    put(root, "room0/traj.txt", "\n".join(rows) + "\n")
    K = shots.K
    camera = {"w": shots.size[0], "h": shots.size[1], "fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    put(root, "cam_params.json", json.dumps({"camera": camera | {"scale": 6553.5}}))
    return root / "room0"


def bop(root: Path, shots: Shots, mm_a_unit: tuple[float, ...] = (0.1,), shift_px: float = 0.0) -> Path:
    scene = root / "test" / "000001"
    cameras = {}
    for k, image in enumerate(shots.color):
        unit = mm_a_unit[k % len(mm_a_unit)]
        put(scene, f"rgb/{k:06d}.png", encoded(image))
        put(scene, f"depth/{k:06d}.png", encoded(stored_mm(shots.depth_m[k], 1000 / unit)))
        T_cam_world, K = np.linalg.inv(shots.T_world_cam[k]), shots.K.copy()
        K[0, 2] += shift_px * (k % 2)
        cameras[str(k)] = {"cam_K": K.ravel().tolist(), "depth_scale": unit, "view_level": 0}
        cameras[str(k)] |= {"cam_R_w2c": T_cam_world[:3, :3].ravel().tolist()}
        cameras[str(k)] |= {"cam_t_w2c": (1000 * T_cam_world[:3, 3]).tolist()}
    put(scene, "scene_camera.json", json.dumps(cameras))
    return scene


def tum_tables(
    root: Path, shots: Shots, color: str, depth: str, units_per_m: float, T: np.ndarray, head: str = ""
) -> None:
    tables: dict[str, list[str]] = {color: [], depth: []}
    for k, image in enumerate(shots.color):
        for folder, data in ((color, image), (depth, stored_mm(shots.depth_m[k], units_per_m))):
            name = f"{folder}/{shots.times_s[k]:.6f}.png"
            put(root, name, encoded(data))
            tables[folder].append(f"{shots.times_s[k]:.6f} {name}")
    for folder, rows in tables.items():
        put(root, f"{folder}.txt", f"# images{head}\n" + "\n".join(rows) + "\n")
    poses = [
        " ".join(f"{v:.9f}" for v in (t, *q[4:], *q[:4])) for t, q in zip(shots.times_s, quaternions(T), strict=True)
    ]
    put(root, "groundtruth.txt", "# timestamp tx ty tz qx qy qz qw\n" + "\n".join(poses) + "\n")


def eth3d(root: Path, shots: Shots) -> Path:
    tum_tables(root, shots, "rgb", "depth", 5000, shots.T_world_cam)
    K = shots.K
    put(root, "calibration.txt", f"{K[0, 0]:.9g} {K[1, 1]:.9g} {K[0, 2]:.9g} {K[1, 2]:.9g}\n")
    return root


def bonn(root: Path, shots: Shots) -> Path:
    """The poses of markers that are on the camera as those of the data set are."""
    tros = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    tm = np.array([[1.0157, 0.1828, -0.2389], [0.0009, -0.8431, -0.6413], [-0.3009, 0.6147, -0.8085]])
    u, _, vt = np.linalg.svd(tm)
    T_m = np.eye(4)
    T_m[:3, :3], T_m[:3, 3] = u @ vt, [0.0113, -0.0098, 0.0111]
    T = np.linalg.inv(tros) @ shots.T_world_cam @ np.linalg.inv(T_m) @ np.linalg.inv(tros)
    folder = root / "rgbd_bonn_balloon"
    tum_tables(folder, shots, "rgb", "depth", 5000, T)
    return folder


def openloris(root: Path, shots: Shots) -> Path:
    T_base_cam = np.eye(4)
    T_base_cam[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T_base_cam[:3, 3] = [0.2, -0.03, 1.1]
    tum_tables(root, shots, "color", "aligned_depth", 1000, shots.T_world_cam @ np.linalg.inv(T_base_cam))
    K = shots.K
    sensors = cv2.FileStorage(str(root / "sensors.yaml"), cv2.FILE_STORAGE_WRITE)
    sensors.startWriteStruct("d400_color_optical_frame", cv2.FileNode_MAP)
    sensors.write("sensor_type", "camera")
    sensors.write("fps", 30)
    sensors.write("width", shots.size[0])
    sensors.write("height", shots.size[1])
    sensors.write("model", "pinhole")
    sensors.write("intrinsics", np.array([[K[0, 0], K[0, 2], K[1, 1], K[1, 2]]]))
    sensors.write("distortion_model", "radial-tangential")
    sensors.write("distortion_coefficients", np.zeros((1, 5)))
    sensors.endWriteStruct()
    sensors.release()
    transforms = cv2.FileStorage(str(root / "trans_matrix.yaml"), cv2.FILE_STORAGE_WRITE)
    transforms.startWriteStruct("trans_matrix", cv2.FileNode_SEQ)
    for child, T in (("laser", np.eye(4)), ("d400_color_optical_frame", T_base_cam)):
        transforms.startWriteStruct("", cv2.FileNode_MAP)
        transforms.write("parent_frame", "base_link")
        transforms.write("child_frame", child)
        transforms.write("matrix", T)
        transforms.endWriteStruct()
    transforms.endWriteStruct()
    transforms.release()
    return root


def nerfcapture(root: Path, shots: Shots, stated: bool = True, per_frame: bool = True) -> Path:
    """As NeRFCapture's client for Instant-NGP writes it: depth of the size of colour, 10 m = 65535."""
    data = {"w": shots.size[0], "h": shots.size[1], "frames": []}
    own = {"fl_x": shots.K[0, 0], "fl_y": shots.K[1, 1], "cx": shots.K[0, 2] + 0.5, "cy": shots.K[1, 2] + 0.5}
    data |= own
    if stated:
        data["integer_depth_scale"] = 10 / 65535
    for k, image in enumerate(shots.color):
        put(root, f"images/{k}.png", encoded(image))
        units = 6553.5 if stated else 1000.0
        put(root, f"images/{k}.depth.png", encoded(stored_mm(shots.depth_m[k], units)))
        frame = {"file_path": f"images/{k}", "depth_path": f"images/{k}.depth.png", "timestamp": shots.times_s[k]}
        frame["transform_matrix"] = (shots.T_world_cam[k] @ OPENGL).tolist()
        data["frames"].append(frame | (own if per_frame else {}))
    put(root, "transforms.json", json.dumps(data))
    return root


def nerfstudio(root: Path, shots: Shots) -> Path:
    """As nerfstudio prepares a recording: depth in millimetres and no word on it, one camera."""
    own = {"fl_x": shots.K[0, 0], "fl_y": shots.K[1, 1], "cx": shots.K[0, 2] + 0.5, "cy": shots.K[1, 2] + 0.5}
    data = {"camera_model": "OPENCV", "k1": 0.0, "w": shots.size[0], "h": shots.size[1], "frames": [], **own}
    for k, image in enumerate(shots.color):
        put(root, f"images/frame_{k + 1:05d}.png", encoded(image))
        put(root, f"depth/frame_{k + 1:05d}.png", encoded(stored_mm(shots.depth_m[k])))
        frame = {"file_path": f"images/frame_{k + 1:05d}.png", "depth_file_path": f"depth/frame_{k + 1:05d}.png"}
        frame["transform_matrix"] = (shots.T_world_cam[k] @ OPENGL).tolist()
        data["frames"].append(frame)
    put(root, "transforms.json", json.dumps(data))
    return root
