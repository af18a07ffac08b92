"""Camera files and the choice of a camera."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.datasets.intrinsics import freiburg_family, save_camera
from miniloop_cli.datasets.layouts.tum import choose_camera
from miniloop_cli.errors import ConfigError, InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import radial_tangential_lens

GOOD = {"fx": 525.0, "fy": 524.0, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480, "depth_scale": 5000}


def write(path, **changes):
    values = {key: value for key, value in (GOOD | changes).items() if value is not None}
    path.write_text("".join(f"{key}: {value}\n" for key, value in values.items()))
    return path


def test_round_trip(tmp_path):
    camera = Camera(500.25, 501.5, 320.125, 240, 640, 480, 1000.0, radial_tangential_lens(0.1, -0.2, 1e-3, 0, 1.163314))
    save_camera(tmp_path / "c.yaml", camera)
    read = read_camera_file(tmp_path / "c.yaml")
    assert (read.K == camera.K).all() and read.lens == camera.lens
    assert (read.width, read.height, read.depth_scale) == (640, 480, 1000.0)
    assert read.source == f"camera file {tmp_path / 'c.yaml'}"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fxx": 1}, r"c\.yaml: unknown key 'fxx'; did you mean 'fx'\?"),
        ({"depth_factor": 1}, "unknown key 'depth_factor'"),
        ({"focal": 1}, "unknown key 'focal'; choose one of fx, fy"),
        ({"fx": None, "width": None}, "fx, width missing"),
        ({"fx": "'525'"}, "fx must be a finite number"),
        ({"fx": ".nan"}, "fx must be a finite number"),
        ({"cx": "true"}, "cx must be a finite number"),
        ({"width": 640.5}, "width must be a whole number of pixels"),
        ({"height": -480}, "height must be a whole number"),
        ({"width": 10**12}, "width must be a finite number"),
        ({"fy": -480}, "fy is negative; image y points down here, so give 480"),
        ({"fx": 0.8}, "fx = 0.8 px does not fit an image of 640 px"),
        ({"cx": 3000}, "cx = 3000 px is far outside"),
        ({"depth_scale": 0.001}, "depth_scale is stored units a metre .*for 0.001 m a unit give 1000"),
        ({"depth_scale": 0}, "depth_scale is stored units a metre"),
    ],
)
def test_wrong_values_are_named(tmp_path, changes, words):
    with pytest.raises(ConfigError, match=words):
        read_camera_file(write(tmp_path / "c.yaml", **changes))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "just text",
        "- 1\n- 2",
        "fx: [",
        "fx: !!python/object/apply:os.system ['true']",
        "2001-99-99",
        "[" * 5000,
        "? {}\n: 1",
    ],
)
def test_other_yaml_is_refused(tmp_path, text):
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(InputError, match=r"c\.yaml"):
        read_camera_file(tmp_path / "c.yaml")


def test_yaml_line_is_named(tmp_path):
    (tmp_path / "c.yaml").write_text("fx: 1\nfy: }\n")
    with pytest.raises(InputError, match=r"c\.yaml:2: not a YAML file"):
        read_camera_file(tmp_path / "c.yaml")
    with pytest.raises(InputError, match="does not exist"):
        read_camera_file(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("text", "family"),
    [
        ("rgbd_dataset_freiburg1_xyz", "1"),
        ("# file: 'rgbd_dataset_freiburg3_long_office.bag'", "3"),
        ("fr2_desk", "2"),
        ("FR1-room", "1"),
        ("kitchen", None),
        ("freiburg12", None),
        ("afr1", None),
    ],
)
def test_family_from_text(text, family):
    assert freiburg_family(text) == family


def test_order_of_choice(tmp_path):
    root = tmp_path / "rgbd_dataset_freiburg2_desk"
    root.mkdir()
    (root / "rgb.txt").write_text("# color images\n")
    assert choose_camera(root, None).fx == 520.908620
    assert "the folder's name" in choose_camera(root, None).source
    (root / "depth.txt").write_text("# file: 'rgbd_dataset_freiburg3_x.bag'\n")
    assert choose_camera(root, None).fx == 535.4
    assert "the header of depth.txt" in choose_camera(root, None).source
    write(root / "camera.yaml", fx=501)
    assert choose_camera(root, None).fx == 501
    assert choose_camera(root, None).source == "the sequence's own camera.yaml"
    assert choose_camera(root, write(tmp_path / "mine.yaml", fx=502)).fx == 502
    other = tmp_path / "kitchen"
    other.mkdir()
    assert choose_camera(other, None).fx == 525 and "ROS default" in choose_camera(other, None).source


def test_given_camera_overrules(tum, tmp_path):
    path = write(tmp_path / "mine.yaml", width=64, height=48, fx=50, fy=50, cx=32, cy=24)
    assert open_sequence(tum.root, camera_path=path).camera.fx == 50


@given(
    st.tuples(*[st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), *[st.floats(-0.005, 0.005)] * 2, st.just(0.0)]),
    st.lists(st.tuples(st.floats(100, 540), st.floats(60, 420)), min_size=1, max_size=5),
)
def test_undistortion_inverts_the_lens(distortion, points):
    """Brown's model written out: distorting the ideal pixel gives the measured one back."""
    camera = Camera(525, 525, 319.5, 239.5, 640, 480, lens=radial_tangential_lens(*distortion))
    x, y = ((camera.undistort(np.array(points)) - [camera.cx, camera.cy]) / 525).T
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    np.testing.assert_allclose(np.stack([u, v], 1) * 525 + [camera.cx, camera.cy], points, atol=0.01)
