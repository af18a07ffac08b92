"""Trajectories as other tools write them, by writers of their own: read back equal, or refused by name."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.datasets.trajectory_formats import read_pose_file
from miniloop_cli.errors import InputError

EPOCH_S = 1305031102.0
EUROC = "p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
PER_S = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


@pytest.fixture(params=range(3))
def poses(request):
    """Stamps (n,) s to the microsecond, positions (n, 3), rotations."""
    rng = np.random.default_rng(request.param)
    n = int(rng.integers(3, 30))
    stamps = EPOCH_S + np.round(np.cumsum(rng.uniform(0.01, 0.1, n)), 6)
    return stamps, rng.normal(0, 3, (n, 3)), Rotation.random(n, random_state=request.param)


def integers(stamps_s, unit):
    """Stamps in a unit, without what floating point makes of them."""
    return [round(round(t * 10**6) * PER_S[unit] / 10**6) for t in stamps_s]


def rows(first, position, q, separator=" ", w_first=False):
    """Lines of stamps as they are written, positions and quaternions x y z w."""
    q = np.roll(q, 1, axis=1) if w_first else q
    lines = [[str(t), *(f"{v:.12f}" for v in (*p, *r))] for t, p, r in zip(first, position, q, strict=True)]
    return "".join(separator.join(line) + "\n" for line in lines)


def matrices(position, rotation, upper_only):
    for p, R in zip(position, rotation.as_matrix(), strict=True):
        M = np.vstack([np.column_stack([R, p]), [0, 0, 0, 1]])
        yield M[:3] if upper_only else M


def check(read, poses, atol=1e-9):
    stamps, position, rotation = poses
    np.testing.assert_allclose(read.timestamps_s, stamps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(read.T_world_cam[:, :3, 3], position, atol=atol)
    np.testing.assert_allclose(read.T_world_cam[:, :3, :3], rotation.as_matrix(), atol=atol)


def as_written(stamps, digits=6):
    return [f"{t:.{digits}f}" for t in stamps]


def test_euroc(tmp_path, poses):
    stamps, position, rotation = poses
    body = rows(integers(stamps, "ns"), position, rotation.as_quat(), ",", w_first=True)
    (tmp_path / "data.csv").write_text(f"#timestamp [ns],{EUROC}\n{body}")
    read = read_trajectory(tmp_path / "data.csv")
    check(read, poses)
    assert read.source == "EuRoC CSV, quaternion w first, stamps in ns"


def test_euroc_with_velocities_and_biases(tmp_path, poses):
    stamps, position, rotation = poses
    more = ",".join(f"{name}_{axis} [x]" for name in ("v_RS_R", "b_w_RS_S", "b_a_RS_S") for axis in "xyz")
    body = rows(integers(stamps, "ns"), position, rotation.as_quat(), ",", w_first=True)
    body = "".join(line + 9 * ",0.125" + "\n" for line in body.splitlines())
    (tmp_path / "data.csv").write_text(
        f"#timestamp, {EUROC}, {more}\n{body}".replace("#timestamp,", "#timestamp [ns],")
    )
    read = read_trajectory(tmp_path / "data.csv")
    check(read, poses)
    assert "9 more columns unused" in read.source


@pytest.mark.parametrize(
    ("header", "w_first"),
    [
        ("timestamp qx qy qz qw tx ty tz", False),
        ("# timestamp, qw, qx, qy, qz, tx, ty, tz", True),
        (
            "field.header.stamp,orientation.x,orientation.y,orientation.z,orientation.w,position.x,position.y,position.z",
            0,
        ),
        ("time;quat_w;quat_x;quat_y;quat_z;pos_x;pos_y;pos_z", True),
        ("t [s]\tq_w\tq_x\tq_y\tq_z\tp_x\tp_y\tp_z", True),
    ],
)
def test_columns_go_by_their_names(tmp_path, poses, header, w_first):
    stamps, position, rotation = poses
    q = np.roll(rotation.as_quat(), 1, axis=1) if w_first else rotation.as_quat()
    lines = np.column_stack([q, position])
    body = "".join(
        f"{t:.6f} " + " ".join(f"{v:.12f}" for v in line) + "\n" for t, line in zip(stamps, lines, strict=True)
    )
    (tmp_path / "t.csv").write_text(f"{header}\n{body}")
    read = read_trajectory(tmp_path / "t.csv")
    check(read, poses)
    assert f"quaternion w {'first' if w_first else 'last'}" in read.source


@pytest.mark.parametrize("separator", [" ", "\t", ",", ", ", ";", " ; "])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_separators_encodings_and_line_ends(tmp_path, separator, encoding, end):
    poses = (
        np.array([EPOCH_S, EPOCH_S + 0.5]),
        np.array([[1.5, -2, 0.25], [2, 0, 1]]),
        Rotation.random(2, random_state=0),
    )
    text = "# written by hand\n\n" + rows(as_written(poses[0]), poses[1], poses[2].as_quat(), separator)
    (tmp_path / "t.txt").write_bytes(text.replace("\n", end).encode(encoding))
    check(read_trajectory(tmp_path / "t.txt"), poses)


@pytest.mark.parametrize("separator", [" ", "\t", ";", "; "])
def test_decimal_commas(tmp_path, poses, separator):
    stamps, position, rotation = poses
    text = rows(as_written(stamps), position, rotation.as_quat(), separator).replace(".", ",")
    (tmp_path / "t.csv").write_text(text)
    read = read_trajectory(tmp_path / "t.csv")
    check(read, poses)
    assert "decimal commas" in read.source


def test_commas_with_two_meanings_are_refused(tmp_path):
    """16 numbers of a matrix, or 8 of TUM's format with decimal commas: both are sound."""
    (tmp_path / "t.txt").write_text("1,0 0,0 0,1 0,0 0,0 1,0 0,0 0,1\n")
    with pytest.raises(InputError, match="may be separators or decimal points"):
        read_pose_file(tmp_path / "t.txt")


@pytest.mark.parametrize("columns", [12, 16, 4, 5])
def test_matrices_by_frame_number(tmp_path, poses, columns):
    stamps, position, rotation = poses
    text = ""
    for k, M in enumerate(matrices(position, rotation, columns == 12)):
        values = [" ".join(f"{v:.12e}" for v in row) for row in M]
        text += f"{k} {k} {k + 1}\n" if columns == 5 else ""
        text += (" " if columns >= 12 else "\n").join(values) + "\n"
    (tmp_path / "poses.txt").write_text(text)
    read = read_trajectory(tmp_path / "poses.txt", stamps, lambda: {"frames of the recording": stamps})
    check(read, poses)
    assert f"by frame number ({len(stamps)}: frames of the recording)" in read.source
    with pytest.raises(
        InputError, match=rf"has no time stamps, and its {len(stamps)} poses are not one a frame \(7 frames"
    ):
        read_trajectory(tmp_path / "poses.txt", np.arange(7.0), lambda: {"frames of the recording": np.arange(7.0)})
    with pytest.raises(InputError, match="no frames to count"):
        read_trajectory(tmp_path / "poses.txt")


def test_matrices_column_by_column_are_named(tmp_path, poses):
    text = "".join(" ".join(f"{v:.12f}" for v in M.T.ravel()) + "\n" for M in matrices(*poses[1:], False))
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(InputError, match=r"poses\.txt:1: not a matrix .* column by column; transpose it"):
        read_pose_file(tmp_path / "poses.txt")


@pytest.mark.parametrize(("unit", "digits"), [("mm", 1000), ("cm", 100), ("m", 1)])
def test_units_of_length_in_the_header(tmp_path, poses, unit, digits):
    stamps, position, rotation = poses
    header = f"timestamp tx[{unit}] ty[{unit}] tz[{unit}] qx qy qz qw\n"
    (tmp_path / "t.txt").write_text(header + rows(as_written(stamps), position * digits, rotation.as_quat()))
    read = read_trajectory(tmp_path / "t.txt")
    check(read, poses)
    assert (f"positions in {unit}" in read.source) == (unit != "m")


IDENTITY = "0 0 0 0 0 0 1"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"# id tx ty tz qx qy qz qw\n1 {IDENTITY}\n", "names no column for stamp"),
        (f"# timestamp x y z q0 q1 q2 q3\n1 {IDENTITY}\n", "names no column for qw, qx, qy, qz"),
        ("timestamp,x,y,z,roll,pitch,yaw\n1,0,0,0,0,0,0\n", "names no column for qw"),
        (f"time,stamp,x,y,z,qx,qy,qz,qw\n1 1 {IDENTITY}\n", "both 'time' and 'stamp' look like the column of stamp"),
        (f"sec,nsec,x,y,z,qx,qy,qz,qw\n1 1 {IDENTITY}\n", "the time is in two columns"),
        (f"timestamp,x,y,z,qx,qy,qz,qw,frame\n1 {IDENTITY}\n", "names 9 columns, the first row has 8 values"),
        (f"time[min] tx ty tz qx qy qz qw\n1 {IDENTITY}\n", "unit 'min' is unknown"),
        (f"time tx[m] ty[mm] tz[m] qx qy qz qw\n1 {IDENTITY}\n", "positions in m and mm"),
        (f"the poses of the desk\n1 {IDENTITY}\n", "names no time stamp"),
        (f"1 {IDENTITY} 5\n", "found 9 values"),
        ("1 2 3 4 5 6 7\n", "found 7 values"),
        ("1 0.2 0.3 0.4 0.1 0.1 0.1 0.1\n", r"t\.txt:1: not a unit quaternion"),
        ("1 0 0 0 0 1 0 0 0 0 1.1 0\n", r"t\.txt:1: not a rigid motion"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", r"t\.txt:1: not a rigid motion"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2\n", "does not end in 0 0 0 1"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", r"t\.txt:3: the file ends within a matrix"),
        ("0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1\n0 0 0 1\n", r"t\.txt:4: expected 4 values"),
        (2 * "5 5 6\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", r"t\.txt:6: the frame numbers of the log do not increase"),
        ("0.5 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "the frame numbers of the log"),
    ],
)
def test_what_is_refused(tmp_path, text, words):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_trajectory(tmp_path / "t.txt")
    assert "\n" not in str(caught.value)
