"""Camera files of other tools: recognised, read rightly, or refused in one line that names the key.

Where a tool is at hand, it writes the file itself.
"""

import json

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.datasets.intrinsics import save_camera
from miniloop_cli.errors import ConfigError, InputError, MiniloopError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import PINHOLE, fisheye_lens, radial_tangential_lens

K = (517.3, 516.5, 318.6, 255.3)
FIVE = (0.26, -0.95, -0.005, 0.003, 1.16)
EIGHT = (0.5, -2.6, 0.001, -0.002, 1.5, 0.38, -2.4, 1.4)
FOUR = (0.01, 0.002, -0.001, 0.0005)
ROWS = [517.3, 0, 318.6, 0, 516.5, 255.3, 0, 0, 1]
COLUMNS = [517.3, 0, 0, 0, 516.5, 0, 318.6, 255.3, 1]
NONE = PINHOLE
RADIAL4 = radial_tangential_lens(-0.28, 0.07, 0.0009, 0.0001)
RADIAL5, RADIAL8, FISHEYE = radial_tangential_lens(*FIVE), radial_tangential_lens(*EIGHT), fisheye_lens(*FOUR)

ORB_SLAM2 = """%YAML:1.0

#-----
# Camera Parameters. Adjust them!
#-----
Camera.fx: 517.3
Camera.fy: 516.5
Camera.cx: 318.6
Camera.cy: 255.3

Camera.k1: 0.26
Camera.k2: -0.95
Camera.p1: -5e-3
Camera.p2: 0.003
Camera.k3: 1.16

Camera.width: 640
Camera.height: 480
Camera.fps: 30.0
Camera.bf: 40.0
Camera.RGB: 1
ThDepth: 40.0
DepthMapFactor: 5000.0

ORBextractor.nFeatures: 1000
Viewer.KeyFrameSize: 0.05
"""
ORB_SLAM3 = """%YAML:1.0
---
File.version: "1.0"
Camera.type: "KannalaBrandt8"
Camera1.fx: 517.3
Camera1.fy: 516.5
Camera1.cx: 318.6
Camera1.cy: 255.3
Camera1.k1: 0.01
Camera1.k2: 0.002
Camera1.k3: -0.001
Camera1.k4: 0.0005
Camera2.fx: 441.120058
Camera.width: 640
Camera.height: 480
RGBD.DepthMapFactor: 1000.0
IMU.T_b_c1: !!opencv-matrix
  rows: 4
  cols: 4
  dt: f
  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
System.SaveAtlasToFile: "maps"
"""
STELLA = """Camera:
  name: "TUM"
  setup: "RGBD"
  model: "perspective"
  fx: 517.3
  fy: 516.5
  cx: 318.6
  cy: 255.3
  k1: -0.28
  k2: 0.07
  p1: 0.0009
  p2: 0.0001
  k3: 0.0
  fps: 30.0
  cols: 640
  rows: 480
  depthmap_factor: 5000.0
"""
OPENCV = """%YAML:1.0
---
calibration_time: "Sun Nov 29 2026"
nframes: 20
image_width: 640
image_height: 480
board_width: 9
square_size: 1.
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 517.3, 0., 318.6, 0., 5.165e+02, 255.3, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.26, -0.95, -5.0e-03, 0.003, 1.16 ]
avg_reprojection_error: 0.2
"""
ROS = """image_width: 640
image_height: 480
camera_name: rgb
camera_matrix:
  rows: 3
  cols: 3
  data: [517.3, 0, 318.6, 0, 516.5, 255.3, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.26, -0.95, -0.005, 0.003, 1.16]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [500, 0, 318, 0, 0, 500, 255, 0, 0, 0, 1, 0]
"""
ROS_MESSAGE = """header:
  seq: 1009
  stamp:
    secs: 1616939816
    nsecs: 37440538
  frame_id: "camera_color_optical_frame"
height: 480
width: 640
distortion_model: "rational_polynomial"
D: [0.5, -2.6, 0.001, -0.002, 1.5, 0.38, -2.4, 1.4]
K: [517.3, 0.0, 318.6, 0.0, 516.5, 255.3, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [517.3, 0.0, 318.6, 0.0, 0.0, 516.5, 255.3, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
"""
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [517.3, 516.5, 318.6, 255.3]
  distortion_model: equidistant
  distortion_coeffs: [0.01, 0.002, -0.001, 0.0005]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
  T_cam_imu:
  - [1.0, 0.0, 0.0, 0.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
"""
EUROC = """#Default
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
rate_hz: 20
resolution: [640, 480]
camera_model: pinhole
intrinsics: [517.3, 516.5, 318.6, 255.3] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0009, 0.0001]
"""
LISTING = """Device info:
    Name                          :     Intel RealSense D435I

Intrinsic Parameters:

 Intrinsic of "Depth" / 640x480 / {Z16}
  Width:      \t640
  Height:     \t480
  PPX:        \t310.2
  PPY:        \t245.2
  Fx:         \t472.9
  Fy:         \t472.9
  Distortion: \tBrown Conrady
  Coeffs:     \t0  \t0  \t0  \t0  \t0
  FOV (deg):  \t68.15 x 53.81

 Intrinsic of "Color" / 1280x720 / {YUYV/RGB8}
  Width:      \t1280
  Height:     \t720
  PPX:        \t640.5
  PPY:        \t365.1
  Fx:         \t927.6
  Fy:         \t927.6
  Distortion: \tInverse Brown Conrady
  Coeffs:     \t0  \t0  \t0  \t0  \t0
  FOV (deg):  \t69.2 x 42.42

 Intrinsic of "Color" / 640x480 / {YUYV/RGB8}
  Width:      \t640
  Height:     \t480
  PPX:        \t318.6
  PPY:        \t255.3
  Fx:         \t517.3
  Fy:         \t516.5
  Distortion: \tInverse Brown Conrady
  Coeffs:     \t0  \t0  \t0  \t0  \t0
  FOV (deg):  \t55.2 x 42.7
"""
REALSENSE = {"width": 640, "height": 480, "fx": 517.3, "fy": 516.5, "ppx": 318.6, "ppy": 255.3, "coeffs": list(FIVE)}
AZURE = {"fx": 517.3, "fy": 516.5, "cx": 318.6, "cy": 255.3, "codx": 0.0, "cody": 0.0, "metric_radius": 0.0}
AZURE |= dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), EIGHT, strict=True)) | {"width": 640, "height": 480}
TRANSFORMS = {"camera_model": "OPENCV", "fl_x": 517.3, "fl_y": 516.5, "cx": 319.1, "cy": 255.8, "w": 640, "h": 480}
TRANSFORMS |= {"k1": 0.26, "k2": -0.95, "p1": -0.005, "p2": 0.003, "k3": 1.16, "frames": []}
FRAMES = [{"file_path": f"{k}.png", "transform_matrix": np.eye(4).tolist(), **TRANSFORMS} for k in range(2)]
for frame in FRAMES:
    del frame["frames"]
SNAPSHOT = {"class_name": "PinholeCameraParameters", "extrinsic": np.eye(4).ravel().tolist(), "version_major": 1}
SNAPSHOT |= {"intrinsic": {"width": 640, "height": 480, "intrinsic_matrix": COLUMNS}, "version_minor": 0}
OPENCV_JSON = {"image_width": 640, "image_height": 480, "camera_matrix": {"type_id": "opencv-matrix", "rows": 3}}
OPENCV_JSON["camera_matrix"] |= {"cols": 3, "dt": "d", "data": ROWS}

FILES = {  # name of the file, text, lens, depth scale, words of the source
    "orb-slam2": ("TUM1.yaml", ORB_SLAM2, RADIAL5, 5000, "read as ORB-SLAM)"),
    "orb-slam3": ("d435.yaml", ORB_SLAM3, FISHEYE, 1000, "read as ORB-SLAM; its Camera1"),
    "stella": ("tum.yaml", STELLA, RADIAL4, 5000, "read as ORB-SLAM"),
    "opencv yaml": ("calib.yml", OPENCV, RADIAL5, None, "read as OpenCV"),
    "opencv json": ("calib.json", json.dumps(OPENCV_JSON), NONE, None, "read as OpenCV"),
    "ros": ("head_camera.yaml", ROS, RADIAL5, None, "read as ROS CameraInfo"),
    "ros message": ("info.txt", ROS_MESSAGE, RADIAL8, None, "read as ROS CameraInfo"),
    "kalibr": ("camchain.yaml", KALIBR, FISHEYE, None, "read as Kalibr"),
    "kalibr of opencv": ("chain.yaml", "%YAML:1.0\n" + KALIBR, FISHEYE, None, "read as Kalibr"),
    "euroc": ("sensor.yaml", EUROC, RADIAL4, None, "read as Kalibr"),
    "open3d": (
        "intrinsic.json",
        json.dumps({"width": 640, "height": 480, "intrinsic_matrix": COLUMNS}),
        NONE,
        None,
        "read as Open3D",
    ),
    "open3d view": ("ScreenCamera.json", json.dumps(SNAPSHOT), NONE, None, "read as Open3D"),
    "open3d bag": (
        "metadata.json",
        json.dumps(
            {"width": 640, "height": 480, "intrinsic_matrix": COLUMNS, "depth_scale": 1000.0, "color_format": "RGB8"}
        ),
        NONE,
        1000,
        "read as Open3D",
    ),
    "colmap": (
        "cameras.txt",
        "# Camera list with one line of data per camera:\n1 FULL_OPENCV 640 480 517.3 516.5 319.1 255.8 "
        + " ".join(map(str, (*EIGHT[:4], *EIGHT[4:])))
        + "\n",
        RADIAL8,
        None,
        "read as COLMAP's cameras.txt",
    ),
    "colmap fisheye": (
        "cameras.txt",
        "1 OPENCV_FISHEYE 640 480 517.3 516.5 319.1 255.8 0.01 0.002 -0.001 0.0005",
        FISHEYE,
        None,
        "COLMAP",
    ),
    "realsense": (
        "d455.json",
        json.dumps(REALSENSE | {"model": "distortion.brown_conrady"}),
        RADIAL5,
        None,
        "RealSense",
    ),
    "realsense sections": (
        "rs.json",
        json.dumps({"color": REALSENSE | {"model": 4}, "depth": REALSENSE | {"fx": 400}, "depth_scale": 0.001}),
        RADIAL5,
        1000,
        "RealSense; its color",
    ),
    "azure kinect": ("k4a.json", json.dumps(AZURE), RADIAL8, None, "read as Azure Kinect"),
    "azure kinect sections": (
        "k4a.json",
        json.dumps({"color_camera": AZURE, "depth_camera": AZURE | {"fx": 504.0}}),
        RADIAL8,
        None,
        "Azure Kinect; its color_camera",
    ),
    "nerfstudio": (
        "transforms.json",
        json.dumps(TRANSFORMS | {"depth_unit_scale_factor": 0.001}),
        RADIAL5,
        1000,
        "read as nerfstudio's transforms.json",
    ),
    "nerfstudio frames": (
        "transforms.json",
        json.dumps({"frames": FRAMES}),
        RADIAL5,
        None,
        "the camera of every frame",
    ),
}


def write(folder, name, text):
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize(("name", "text", "lens", "scale", "words"), FILES.values(), ids=FILES)
def test_files_of_other_tools(tmp_path, name, text, lens, scale, words):
    path = write(tmp_path, name, text)
    camera = read_camera_file(path, depth_scale=1234.0)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx(K)
    assert (camera.width, camera.height) == (640, 480)
    assert camera.lens == lens
    assert camera.depth_scale == pytest.approx(scale or 1234)
    assert words in camera.source and str(path) in camera.source
    assert ("1234 units a metre are assumed" in camera.source) == (scale is None)
    if scale is None:
        with pytest.raises(ConfigError, match="depth_scale missing; add it: stored units a metre"):
            read_camera_file(path)


@pytest.mark.parametrize("key", ["opencv yaml", "kalibr", "ros", "open3d", "azure kinect", "realsense"])
def test_a_depth_scale_may_be_added_to_any_mapping(tmp_path, key):
    name, text, *_ = FILES[key]
    added = text[:-1] + ', "depth_scale": 2000}' if name.endswith(".json") else text + "depth_scale: 2000\n"
    assert read_camera_file(write(tmp_path, name, added), depth_scale=1234.0).depth_scale == 2000


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
@pytest.mark.parametrize("coefficients", [(-0.28, 0.07, 0.0009, 0.0001), FIVE, EIGHT, (*EIGHT, 0, 0, 0, 0)])
def test_what_opencv_writes(tmp_path, suffix, coefficients):
    path = tmp_path / f"camera.{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array(ROWS).reshape(3, 3))
    storage.write("distortion_coefficients", np.array(coefficients)[:, None])
    storage.release()
    camera = read_camera_file(path, depth_scale=1000.0)
    assert np.array_equal(camera.K, np.array(ROWS).reshape(3, 3))
    assert camera.lens == radial_tangential_lens(*coefficients[:8])


@pytest.mark.parametrize(
    ("model", "parameters", "lens"),
    [
        ("SIMPLE_PINHOLE", [500, 320.5, 240.5], NONE),
        ("PINHOLE", [500, 500, 320.5, 240.5], NONE),
        ("SIMPLE_RADIAL", [500, 320.5, 240.5, 0.05], radial_tangential_lens(0.05)),
        ("RADIAL", [500, 320.5, 240.5, 0.05, 0.02], radial_tangential_lens(0.05, 0.02)),
        ("OPENCV", [500, 500, 320.5, 240.5, *RADIAL4.coefficients[:4]], RADIAL4),
        ("FULL_OPENCV", [500, 500, 320.5, 240.5, *EIGHT], RADIAL8),
        ("OPENCV_FISHEYE", [500, 500, 320.5, 240.5, *FOUR], FISHEYE),
        ("SIMPLE_RADIAL_FISHEYE", [500, 320.5, 240.5, 0.05], fisheye_lens(0.05)),
        ("RADIAL_FISHEYE", [500, 320.5, 240.5, 0.05, 0.02], fisheye_lens(0.05, 0.02)),
    ],
)
def test_what_colmap_writes(tmp_path, model, parameters, lens):
    """COLMAP's own projection of points is ours, half a pixel on."""
    row = f"1 {model} 640 480 {' '.join(map(str, parameters))}\n"
    camera = read_camera_file(write(tmp_path, "cameras.txt", row), depth_scale=1000.0)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.lens) == (500, 500, 320, 240, lens)
    pycolmap = pytest.importorskip("pycolmap")
    theirs = pycolmap.Camera(model=model, width=640, height=480, params=parameters)
    p_cam = np.array([[0.2, -0.1, 1.5], [-0.3, 0.2, 1.0], [0.5, 0.4, 1.0]])
    np.testing.assert_allclose(camera.distort(camera.project(p_cam)) + 0.5, theirs.img_from_cam(p_cam), atol=1e-6)


def test_what_open3d_writes(tmp_path):
    o3d = pytest.importorskip("open3d")
    path = tmp_path / "intrinsic.json"
    o3d.io.write_pinhole_camera_intrinsic(str(path), o3d.camera.PinholeCameraIntrinsic(640, 480, *K))
    camera = read_camera_file(path, depth_scale=1000.0)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height) == (*K, 640, 480)


def raw_azure(**changes):
    """The raw calibration of a device, its colour camera with the focal length of 904.14 px at a width of 1920."""
    shares = [0.4967627227, 0.5108628273, 0.4709070623, 0.6274453998]
    lens = [0.7227460, -2.8855903, 1.6327226, 0.6021990, -2.7196263, 1.5650531, 0, 0, -0.0001431912, 0.0007828466]
    intrinsics = {"ModelParameterCount": 14, "ModelParameters": shares + lens}
    intrinsics["ModelType"] = "CALIBRATION_LensDistortionModelBrownConrady"
    color = {"Intrinsics": intrinsics | changes, "Location": "CALIBRATION_CameraLocationPV0"}
    color |= {"SensorWidth": 4096, "SensorHeight": 3072, "MetricRadius": 0}
    depth = {"Location": "CALIBRATION_CameraLocationD0", "SensorWidth": 1024, "SensorHeight": 1024}
    return json.dumps({"CalibrationInformation": {"Cameras": [depth, color], "InertialSensors": []}})


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((1920, 1080), (904.141541, 903.521362, 953.284424, 555.142456)),  # what the SDK says of this device
        ((1280, 720), (602.761, 602.3476, 635.35630, 369.92830)),
        ((2048, 1536), (964.417664, 963.756, 1016.87006, 784.18530)),
    ],
)
def test_azure_kinects_calibration_at_the_images_size(tmp_path, size, expected):
    """Images of 16:9 leave out rows at the top and at the bottom of the sensor's 4:3."""
    camera = read_camera_file(write(tmp_path, "calibration.json", raw_azure()), image_size=size, depth_scale=1000.0)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx(expected, abs=2e-3)
    assert camera.lens.named["k6"] == 1.5650531 and camera.lens.named["p1"] == 0.0007828466
    assert f"colour at {size[0]} x {size[1]}" in camera.source


def test_several_cameras_are_chosen_by_the_images_size(tmp_path):
    chain = KALIBR + KALIBR.replace("cam0", "cam1").replace("[640, 480]", "[320, 240]").replace("517.3", "300.5")
    path = write(tmp_path, "chain.yaml", chain.replace("318.6, 255.3", "160, 120"))
    assert read_camera_file(path, image_size=(320, 240), depth_scale=1000.0).fx == 300.5
    first = read_camera_file(path, depth_scale=1000.0)
    assert first.fx == 517.3 and "cam0 of cam0, cam1" in first.source
    rows = "3 PINHOLE 640 480 500 500 320 240\n7 PINHOLE 320 240 250 250 160 120\n"
    path = write(tmp_path, "cameras.txt", rows)
    assert read_camera_file(path, image_size=(320, 240), depth_scale=1000.0).fx == 250
    with pytest.raises(ConfigError, match=r"2 cameras: camera 3 \(640 x 480\), camera 7 .* size is unknown"):
        read_camera_file(path, depth_scale=1000.0)
    same = write(tmp_path, "same.txt", "1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 640 480 500 500 320 240\n")
    assert read_camera_file(same, depth_scale=1000.0).fx == 500
    listing = write(tmp_path, "rs.txt", LISTING)
    camera = read_camera_file(listing, image_size=(640, 480), depth_scale=1000.0)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.lens) == (*K, NONE)
    assert '"Color" / 640x480' in camera.source
    with pytest.raises(ConfigError, match='2 streams: "Color" / 1280x720'):
        read_camera_file(listing, depth_scale=1000.0)


def test_a_listing_from_windows(tmp_path):
    (tmp_path / "rs.txt").write_bytes(LISTING.encode("utf-16"))
    assert read_camera_file(tmp_path / "rs.txt", image_size=(640, 480), depth_scale=1000.0).fx == 517.3


REFUSED = {
    "orb-slam size": ("a.yaml", ORB_SLAM2.replace("Camera.width: 640\n", ""), "Camera.width missing; add the size"),
    "orb-slam no size": (
        "a.yaml",
        ORB_SLAM2.replace("Camera.width: 640\nCamera.height: 480\n", ""),
        "Camera.width and Camera.height missing; add the size in pixels",
    ),
    "orb-slam key": (
        "a.yaml",
        ORB_SLAM2.replace("Camera.k1", "Camera.K1"),
        "unknown key 'Camera.K1'; did you mean 'Camera.k1'",
    ),
    "orb-slam flat key": (
        "a.yaml",
        ORB_SLAM2.replace("DepthMapFactor", "DepthMapFaktor"),
        "did you mean 'DepthMapFactor'",
    ),
    "orb-slam group": ("a.yaml", ORB_SLAM2.replace("Camera.k1", "Camra.k1"), "unknown key 'Camra.k1'"),
    "orb-slam two groups": ("a.yaml", ORB_SLAM3.replace("Camera1.k3", "Camera.k3"), "unknown key 'Camera.k3'"),
    "orb-slam rectified": ("a.yaml", ORB_SLAM2 + "Camera.type: Rectified\n", "coefficients of a lens under Camera"),
    "orb-slam lens": ("a.yaml", ORB_SLAM3.replace("KannalaBrandt8", "Omni"), "Camera.type is omni"),
    "orb-slam k4": ("a.yaml", ORB_SLAM3.replace("KannalaBrandt8", "PinHole"), "Camera1.k4 is of a fisheye lens"),
    "orb-slam fx": ("a.yaml", ORB_SLAM2.replace("Camera.fx: 517.3", "Camera.fx: 517,3"), "Camera.fx must be a finite"),
    "opencv key": (
        "a.yml",
        OPENCV.replace("distortion_coefficients", "distorsion_coefficients"),
        "unknown key 'distorsion_coefficients'; did you mean 'distortion_coefficients'",
    ),
    "opencv skew": ("a.yml", OPENCV.replace("517.3, 0.,", "517.3, 0.7,"), "camera_matrix has a skew of 0.7"),
    "opencv rows": (
        "a.yml",
        OPENCV.replace("rows: 5", "rows: 4"),
        "distortion_coefficients has 5 numbers, not 4 rows of 1",
    ),
    "opencv seven": (
        "a.yml",
        OPENCV.replace("rows: 5", "rows: 7").replace("1.16 ]", "1.16, 0., 0. ]"),
        "7 distortion coefficients; expected 4, 5, 8, 12 or 14, as in OpenCV",
    ),
    "opencv prism": (
        "a.yml",
        OPENCV.replace("rows: 5", "rows: 12").replace("1.16 ]", "1.16, 0, 0, 0, 0.01, 0, 0, 0 ]"),
        "thin-prism and tilt coefficients",
    ),
    "opencv sizes": (
        "a.yml",
        OPENCV.replace("image_width: 640\nimage_height: 480\n", ""),
        "image_width and image_height",
    ),
    "ros lens": (
        "a.yaml",
        ROS.replace("plumb_bob", "omnidirectional"),
        "distortion_model is 'omnidirectional'; supported are",
    ),
    "ros fisheye": ("a.yaml", ROS.replace("plumb_bob", "equidistant"), "5 coefficients of a fisheye lens; expected 4"),
    "ros no lens": (
        "a.yaml",
        ROS.replace("distortion_model: plumb_bob\n", "").replace("cols: 5", "cols: 4").replace(", 1.16]", "]"),
        "4 coefficients may be of either lens; add distortion_model",
    ),
    "ros eight": ("a.txt", ROS_MESSAGE.replace("rational_polynomial", "plumb_bob"), "more than 5 coefficients"),
    "ros nested": ("a.txt", ROS_MESSAGE.replace("D: [0.5,", "D: [[0.5],"), "D must have up to 14 finite numbers"),
    "ros key": ("a.yaml", ROS.replace("rows: 3", "row: 3", 1), "camera_matrix: unknown key 'row'; did you mean 'rows'"),
    "ros binning": ("a.txt", ROS_MESSAGE.replace("binning_x: 0", "binning_x: 2"), "binning_x is 2"),
    "ros roi": ("a.txt", ROS_MESSAGE.replace("x_offset: 0", "x_offset: 8"), "roi is a part of the image"),
    "kalibr model": ("a.yaml", KALIBR.replace("pinhole", "omni"), "cam0: camera_model is omni"),
    "kalibr cut": ("a.yaml", KALIBR.replace(" equidistant", ""), "cam0: distortion_model must be a word"),
    "kalibr lens": ("a.yaml", KALIBR.replace("equidistant", "fov"), "cam0: distortion_model is fov"),
    "kalibr size": ("a.yaml", KALIBR.replace("resolution", "resolutions"), "unknown key 'resolutions'; did you mean"),
    "kalibr no size": ("a.yaml", KALIBR.replace("  resolution: [640, 480]\n", ""), r"resolution missing; add \[width"),
    "kalibr coefficients": ("a.yaml", KALIBR.replace("distortion_coeffs", "label"), "distortion_coeffs missing"),
    "open3d rows": (
        "a.json",
        json.dumps({"width": 640, "height": 480, "intrinsic_matrix": ROWS}),
        "intrinsic_matrix is stored by rows",
    ),
    "open3d size": ("a.json", json.dumps({"height": 480, "intrinsic_matrix": COLUMNS}), "width missing; add the size"),
    "open3d several": (
        "a.json",
        json.dumps(
            {
                "class_name": "PinholeCameraTrajectory",
                "parameters": [
                    SNAPSHOT,
                    SNAPSHOT | {"intrinsic": {"width": 64, "height": 48, "intrinsic_matrix": COLUMNS}},
                ],
            }
        ),
        "the images have cameras of their own",
    ),
    "colmap model": (
        "c.txt",
        "1 THIN_PRISM_FISHEYE 640 480 500 500 320 240 0 0 0 0 0 0 0 0",
        ":1: camera model THIN_PRISM",
    ),
    "colmap count": ("c.txt", "\n1 OPENCV 640 480 500 500 320 240 0 0 0", ":2: OPENCV has 8 parameters .* not 7"),
    "colmap words": ("c.txt", "1 PINHOLE 640 480 500 500 320 x", ":1: not numbers"),
    # A lens of five coefficients in a model of four: without k3 = 1.16 it turns back.
    "colmap fold": ("c.txt", "1 OPENCV 640 480 517.3 516.5 318.6 255.3 0.26 -0.95 0 0", "lens folds over 328 px"),
    "realsense inverse": (
        "a.json",
        json.dumps(REALSENSE | {"model": "distortion.inverse_brown_conrady"}),
        "'inversebrownconrady' with coefficients other than 0 is not supported",
    ),
    "realsense unnamed": ("a.json", json.dumps(REALSENSE), "'that no key names' with coefficients"),
    "azure centre": ("a.json", json.dumps(AZURE | {"codx": 0.01}), "codx, cody"),
    "azure 6kt": ("a.json", json.dumps(AZURE | {"type": "Rational6KT"}), "Rational6KT with p1, p2"),
    "azure raw size": ("a.json", raw_azure(), "width and height missing; add the size"),
    "nerfstudio frames": (
        "t.json",
        json.dumps({"frames": [FRAMES[0], FRAMES[1] | {"fl_x": 518}]}),
        "the frames have cameras of their own",
    ),
    "nerfstudio model": ("t.json", json.dumps(TRANSFORMS | {"camera_model": "EQUIRECTANGULAR"}), "is EQUIRECTANGULAR"),
    "nerfstudio k4": ("t.json", json.dumps(TRANSFORMS | {"k4": 0.1}), "k4 of an OPENCV lens"),
    "nerfstudio key": ("t.json", json.dumps(TRANSFORMS | {"k_1": 0.1}), "unknown key 'k_1'; did you mean 'k1'"),
}


@pytest.mark.parametrize(("name", "text", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused_is_named(tmp_path, name, text, words):
    with pytest.raises(ConfigError, match=words) as error:
        read_camera_file(write(tmp_path, name, text), depth_scale=1000.0)
    assert str(tmp_path / name) in str(error.value) and str(error.value).isprintable()


def test_a_wrong_size_for_azure_kinect(tmp_path):
    with pytest.raises(ConfigError, match="640 x 576 is not a size of Azure Kinect's colour images"):
        read_camera_file(write(tmp_path, "c.json", raw_azure()), image_size=(640, 576), depth_scale=1000.0)


OWN = "".join(f"{key}: {value}\n" for key, value in zip(("fx", "fy", "cx", "cy"), K, strict=True))
OWN += "width: 640\nheight: 480\ndepth_scale: 5000\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (OWN + "fx: 300\n", "c.yaml:8: not a YAML file: key 'fx' is given twice"),
        (OWN.replace("517.3", "5_17.3"), "fx must be a finite number"),
        (OWN.replace("517.3", "8:37.3"), "fx must be a finite number"),
        (OWN + "lens: omni\n", "lens is one of pinhole, radial-tangential, fisheye, not 'omni'"),
        (OWN + "k1: 0.1\nk2: 0\nk3: 0\nk4: 0.1\n", "k4 without k5 and k6; add 'lens: fisheye'"),
        (OWN + "lens: fisheye\np1: 0.1\n", "a fisheye lens has no p1"),
        (OWN + "lens: pinhole\nk1: 0.1\n", "a pinhole lens has no k1"),
        (OWN + "k1: -0.6\n", "the radial-tangential lens folds over 257 px from the principal point"),
    ],
)
def test_our_own_file_is_read_strictly(tmp_path, text, words):
    with pytest.raises(MiniloopError, match=words):
        read_camera_file(write(tmp_path, "c.yaml", text))


def test_leading_zeros_are_decimal(tmp_path):
    assert read_camera_file(write(tmp_path, "c.yaml", OWN.replace("640", "0640"))).width == 640


@pytest.mark.parametrize(
    "lens",
    [NONE, RADIAL4, RADIAL5, RADIAL8, FISHEYE, fisheye_lens(), radial_tangential_lens(1e-5, 2.5e-7, 0, 0, 0, 1e-6)],
    ids=str,
)
def test_every_lens_is_written_and_read_back(tmp_path, lens):
    camera = Camera(*K, 640, 480, 1000.0, lens)
    save_camera(tmp_path / "camera.yaml", camera)
    read = read_camera_file(tmp_path / "camera.yaml")
    assert (read.lens, read.depth_scale) == (lens, 1000.0) and (read.K == camera.K).all()
    yaml = pytest.importorskip("yaml")
    plain = yaml.safe_load((tmp_path / "camera.yaml").read_text())
    assert all(isinstance(value, int | float) for key, value in plain.items() if key != "lens")


def test_a_recording_takes_its_size_and_scale(tum, tmp_path):
    """The layout's scale is assumed for a file that states none; of several cameras the images' size chooses."""
    rows = "1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 64 48 50 50 32.5 24.5\n"
    camera = open_sequence(tum.root, camera_path=write(tmp_path, "cameras.txt", rows)).camera
    assert (camera.fx, camera.cx, camera.depth_scale) == (50, 32, 5000)
    assert "camera 2 of 2" in camera.source and "5000 units a metre are assumed" in camera.source


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b 'c'>]><opencv_storage/>", "document type"),
        (b"<html></html>", "XML of <html>"),
        (b"<opencv_storage>", "not XML"),
        (b"<opencv_storage>" + b"<a>" * 100 + b"</a>" * 100 + b"</opencv_storage>", "nested more than 20 deep"),
        (b"<opencv_storage><a>1</a><a>2</a></opencv_storage>", "key 'a' is given twice"),
        (b'{"fx": 1, "fx": 2}', "key 'fx' is given twice"),
        (b"\x89PNG\r\n\x1a\n", "not a text file"),
        (b"fx: 1\n" * 20000, "kB of YAML, more than the 64 kB allowed"),
        (b'{"a":' * 100000, "not JSON"),
    ],
    ids=str,
)
def test_what_is_no_camera_file(tmp_path, data, words):
    (tmp_path / "c").write_bytes(data)
    with pytest.raises(InputError, match=words):
        read_camera_file(tmp_path / "c")
