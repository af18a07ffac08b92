"""PLY, voxel cloud and g2o: round trips, brute force, and other programs' readers as oracles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.results.fuse_cloud import VoxelCloud, fuse_cloud, joined, merge, pack, unpack
from miniloop_cli.results.g2o import read_g2o, write_g2o
from miniloop_cli.results.ply import read_ply, write_ply


@pytest.fixture
def cloud():
    rng = np.random.default_rng(0)
    return rng.normal(size=(50, 3)), rng.integers(0, 256, (50, 3), dtype=np.uint8)


def test_ply_round_trip(tmp_path, cloud):
    write_ply(tmp_path / "a.ply", *cloud)
    points, colors = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(points, cloud[0].astype(np.float32))
    np.testing.assert_array_equal(colors, cloud[1])


def test_ply_in_open3d(tmp_path, cloud):
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    write_ply(tmp_path / "mesh.ply", *cloud, faces)
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "mesh.ply"))
    np.testing.assert_allclose(np.asarray(mesh.vertices), cloud[0], atol=1e-6)
    np.testing.assert_allclose(np.asarray(mesh.vertex_colors) * 255, cloud[1], atol=1e-6)
    np.testing.assert_array_equal(np.asarray(mesh.triangles), faces)


def test_ply_of_nothing(tmp_path):
    write_ply(tmp_path / "a.ply", np.empty((0, 3)), np.empty((0, 3), np.uint8))
    assert read_ply(tmp_path / "a.ply")[0].shape == (0, 3)


@pytest.mark.parametrize("cut", [0, 3, 100, -1, -400])
def test_ply_cut_short_is_refused(tmp_path, cloud, cut):
    write_ply(tmp_path / "a.ply", *cloud)
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "b.ply").write_bytes(data[:cut])
    with pytest.raises(InputError, match=r"b\.ply"):
        read_ply(tmp_path / "b.ply")


def test_ply_with_an_absurd_count_is_refused(tmp_path, cloud):
    write_ply(tmp_path / "a.ply", *cloud)
    data = (tmp_path / "a.ply").read_bytes().replace(b"vertex 50", b"vertex 5000000000000")
    (tmp_path / "b.ply").write_bytes(data)
    with pytest.raises(InputError, match="cut short"):
        read_ply(tmp_path / "b.ply")


def test_ply_refuses_other_shapes(tmp_path):
    with pytest.raises(ValueError, match=r"\(4, 2\)"):
        write_ply(tmp_path / "a.ply", np.zeros((4, 2)), np.zeros((4, 3), np.uint8))


@settings(max_examples=40)
@given(st.integers(0, 9999), st.integers(1, 6), st.floats(0.02, 3))
def test_voxel_means_as_by_brute_force(seed, n_chunks, voxel_m):
    rng = np.random.default_rng(seed)
    chunks = [(rng.normal(size=(n, 3)), rng.integers(0, 256, (n, 3))) for n in rng.integers(0, 60, n_chunks)]
    points, colors = np.concatenate([c[0] for c in chunks]), np.concatenate([c[1] for c in chunks])
    cells = {}
    for p, c in zip(points, colors, strict=True):
        cells.setdefault(tuple(np.floor(p / voxel_m).astype(int)), []).append(np.r_[p, c])
    expected = np.array([np.mean(cells[key], axis=0) for key in sorted(cells)]).reshape(-1, 6)
    found_points, found_colors = fuse_cloud(chunks, voxel_m)
    np.testing.assert_allclose(found_points, expected[:, :3], atol=1e-6)
    assert np.abs(found_colors - expected[:, 3:]).max(initial=0) <= 0.5 + 1e-9


@given(st.lists(st.tuples(*[st.integers(-(2**20), 2**20 - 1)] * 3), min_size=1))
def test_keys_are_invertible_and_ordered(voxels):
    v = np.array(voxels)
    np.testing.assert_array_equal(unpack(pack(v)), v)
    assert (np.argsort(pack(v), kind="stable") == np.lexsort(v.T[::-1])).all()


def test_cloud_grows_coarser_instead_of_larger():
    rng = np.random.default_rng(2)
    cloud = VoxelCloud(0.01, max_voxels=500)
    for _ in range(20):
        cloud.add(rng.uniform(-1, 1, (400, 3)), np.full((400, 3), 7))
    points, colors = cloud.result()
    assert 0 < len(points) <= 500
    assert cloud.voxel_m in 0.01 * 2.0 ** np.arange(10)
    assert len(np.unique(np.floor(points / cloud.voxel_m), axis=0)) == len(points)
    assert (colors == 7).all()


def test_sorted_parts_are_joined_as_they_are_merged(rng):
    one, two, three = (merge(rng.integers(0, 900, 500), rng.uniform(0, 255, (500, 7))) for _ in range(3))
    nothing = np.zeros(0, np.int64), np.zeros((0, 7))
    for parts in ([one, two], [one, nothing], [nothing, two], [nothing, nothing], [one], [one, two, three, two]):
        expected = merge(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        copies = [tuple(column.copy() for column in part) for part in parts]  # the first one may be changed
        for found, right in zip(joined(copies), expected, strict=True):
            np.testing.assert_allclose(found, right, rtol=1e-12)


def test_cloud_leaves_out_what_is_not_finite_or_alone():
    cloud = VoxelCloud(1.0)
    cloud.add(np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0.5, 0.5, 0.5], [0.7, 0.5, 0.5], [3, 3, 3]]), np.zeros((5, 3)))
    assert len(cloud.result()[0]) == 2
    np.testing.assert_allclose(cloud.result(min_points=2)[0], [[0.6, 0.5, 0.5]], atol=1e-6)
    with pytest.raises(MiniloopError, match="larger voxels"):
        cloud.add(np.array([[1e9, 0, 0]]), np.zeros((1, 3)))


def test_cloud_of_nothing():
    points, colors = fuse_cloud([])
    assert points.shape == colors.shape == (0, 3)


@pytest.fixture
def graph():
    rng = np.random.default_rng(4)
    ids = np.array([3, 5, 8, 13])
    T = se3.pose(se3.exp_so3(rng.normal(size=(4, 3))), rng.normal(size=(4, 3)))
    pairs = np.array([[3, 5], [5, 8], [3, 13], [8, 13]])
    rows = np.searchsorted(ids, pairs)
    noise = se3.pose(se3.exp_so3(rng.normal(scale=0.01, size=(4, 3))), rng.normal(scale=0.01, size=(4, 3)))
    T_j_i = noise @ se3.inverse(T[rows[:, 1]]) @ T[rows[:, 0]]
    A = rng.normal(size=(4, 6, 6)) * np.array([10, 10, 10, 1, 1, 1])
    return ids, T, pairs, T_j_i, np.swapaxes(A, 1, 2) @ A + np.eye(6)


def test_g2o_round_trip(tmp_path, graph):
    write_g2o(tmp_path / "graph.g2o", *graph)
    back = read_g2o(tmp_path / "graph.g2o")
    for ours, read in zip(graph, (back.ids, back.T_world_cam, back.pairs, back.T_j_i, back.information), strict=True):
        np.testing.assert_allclose(read, ours, rtol=1e-7, atol=1e-9)


def test_g2o_in_gtsam(tmp_path, graph):
    gtsam = pytest.importorskip("gtsam")
    ids, T, pairs, T_j_i, information = graph
    write_g2o(tmp_path / "graph.g2o", *graph)
    factors, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), True)
    for number, pose in zip(ids.tolist(), T, strict=True):
        np.testing.assert_allclose(values.atPose3(number).matrix(), pose, atol=1e-9)
    assert factors.size() == len(pairs)
    for k in range(len(pairs)):
        factor = factors.at(k)
        assert factor.keys() == pairs[k].tolist()
        np.testing.assert_allclose(factor.measured().matrix(), se3.inverse(T_j_i[k]), atol=1e-9)
        np.testing.assert_allclose(factor.noiseModel().information(), information[k], rtol=1e-6, atol=1e-6)
        # Its error of a graph whose truth is Exp(xi) T_j_i is xi^T I xi / 2, to first order.
        xi = 1e-4 * np.random.default_rng(k).normal(size=6)
        truth = gtsam.Values()
        truth.insert(int(pairs[k, 0]), gtsam.Pose3())
        T_true = se3.pose(se3.exp_so3(xi[:3]), xi[3:]) @ T_j_i[k]
        truth.insert(int(pairs[k, 1]), gtsam.Pose3(se3.inverse(T_true)))
        assert factor.error(truth) == pytest.approx(xi @ information[k] @ xi / 2, rel=1e-2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0\n", "line 1"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n", "quaternion"),
        ("VERTEX_SE3:QUAT 0 0 0 nan 0 0 0 1\n", "finite"),
        ("# a\nVERTEX_SE3:QUAT x 0 0 0 0 0 0 1\n", "line 2"),
        ("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 " + "1 " * 21 + "\n", "not there"),
    ],
)
def test_broken_g2o_is_one_line(tmp_path, text, words):
    (tmp_path / "a.g2o").write_text(text)
    with pytest.raises(InputError, match=words):
        read_g2o(tmp_path / "a.g2o")


def test_empty_g2o(tmp_path):
    (tmp_path / "a.g2o").write_text("")
    graph = read_g2o(tmp_path / "a.g2o")
    assert graph.T_j_i.shape == (0, 4, 4)
    write_g2o(tmp_path / "b.g2o", graph.ids, graph.T_world_cam, graph.pairs, graph.T_j_i, graph.information)
    assert (tmp_path / "b.g2o").read_text().count("\n") == 2
