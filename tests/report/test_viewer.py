"""What the 3D view is given: points coarse first, packed; frames, edges, pieces; and how its script was built."""

import base64
import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.datasets.thumbnails import thumbnail
from miniloop_cli.errors import InputError
from miniloop_cli.evaluation.evaluate import Protocol, evaluate
from miniloop_cli.geometry import se3
from miniloop_cli.report.viewer.embedded import embedded
from miniloop_cli.report.viewer.levels import BITS, STEPS, TILE_LEVELS, coarse_first, tiles
from miniloop_cli.report.viewer.matches import unpack_matches
from miniloop_cli.report.viewer.packing import coarser, pack_points, unpack_points
from miniloop_cli.report.viewer.placed import place
from miniloop_cli.report.viewer.scene import ellipsoids, scene, speeds
from miniloop_cli.results.columns import load
from miniloop_cli.results.folder import read_table
from miniloop_cli.results.ply import write_ply
from miniloop_cli.results.thumbnails import write_thumbnails
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.scene.sequence import Trajectory

ROOT = Path(__file__).parents[2]


def cloud(seed, n=400):
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 5, (n, 3)) * rng.choice([1, 0.01], (n, 1))  # a room, and a heap in its corner


@given(st.integers(0, 9999))
def test_every_beginning_is_a_coarse_picture(seed):
    points = cloud(seed)
    levels = coarse_first(points)
    assert sorted(levels.order.tolist()) == list(range(len(points)))
    assert (np.diff(levels.level) >= 0).all() and levels.level[0] == 0
    for level in range(1, 8):
        # By brute force: as many points as there are filled cells, no two in one cell.
        cells = levels.steps.astype(int) >> (BITS - level)
        begun = levels.level <= level
        filled = len(np.unique(cells, axis=0))
        assert begun.sum() == filled == len(np.unique(cells[begun], axis=0))


@given(st.integers(0, 9999))
def test_positions_keep_within_half_a_step(seed):
    points = cloud(seed)
    levels = coarse_first(points)
    step = levels.side / STEPS
    back = levels.corner + step * levels.steps
    assert np.abs(back - points[levels.order]).max() <= 0.5001 * step


def test_what_does_not_fit_is_thinned_evenly():
    grid = np.stack(np.meshgrid(*[np.arange(16.0)] * 3), axis=-1).reshape(-1, 3)
    levels = coarse_first(grid)
    some = levels.first(1000)
    assert len(some) == 1000
    assert set(some.order) <= set(levels.order) and len(set(some.order)) == 1000
    octants = np.bincount((grid[some.order] >= 8) @ [1, 2, 4], minlength=8)
    assert octants.max() < 1.3 * octants.min()
    assert levels.first(5000) is levels


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((5, 3)), np.array([[1.0, 2, 3]])])
def test_few_points_are_points_too(points):
    levels = coarse_first(points)
    assert len(levels) == len(points)
    assert sum(tile.end - tile.begin for tile in tiles(levels)[1]) == len(points)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 9999))
def test_tiles_are_cubes_of_an_octree(seed):
    points = np.random.default_rng(seed).uniform(0, 1, (8000, 3)) ** 4
    levels, found = tiles(coarse_first(points), few=50)
    assert [tile.begin for tile in found] == [0, *(tile.end for tile in found[:-1])] and found[-1].end == len(points)
    known = {(tile.depth, tile.cell) for tile in found}
    assert len(known) == len(found) > 1 and found[0].depth == 0
    for tile in found:
        inside = levels.steps[tile.begin : tile.end].astype(int) >> (BITS - tile.depth)
        assert (inside == tile.cell).all()
        if tile.depth < max(depth for depth, _ in known):  # at most one point a cell of its grid
            cells = levels.steps[tile.begin : tile.end].astype(int) >> (BITS - tile.depth - TILE_LEVELS)
            assert len(np.unique(cells, axis=0)) == tile.end - tile.begin


@given(st.integers(0, 9999))
def test_packed_points_come_back(seed):
    rng = np.random.default_rng(seed)
    steps = rng.integers(0, 1 << 16, (50, 3)).astype(np.uint16)
    colors = rng.integers(0, 256, (50, 3), dtype=np.uint8)
    steps_back, colors_back = unpack_points(pack_points(steps, colors))
    np.testing.assert_array_equal(steps_back, steps)
    np.testing.assert_array_equal(colors_back, colors)


def test_rounded_steps_stay_within_a_sixteenth_of_the_spacing():
    steps = np.random.default_rng(0).integers(0, 1 << 16, (500, 3)).astype(np.uint16)
    for spacing in (1.0, 100.0, 4000.0):
        assert np.abs(coarser(steps, spacing).astype(int) - steps).max() <= max(spacing / 8, 0)
    np.testing.assert_array_equal(coarser(steps, 1.0), steps)
    few, many = (len(pack_points(s, np.zeros_like(s, np.uint8))) for s in (coarser(steps, 1000.0), steps))
    assert few < 0.8 * many


def test_a_page_carries_images_of_all_frames_with_or_without_the_recording(run, tmp_path):
    large, small = embedded(load(run.results, run.sequence), None, Store(tmp_path / "kept"))["pictures"]
    assert sorted(map(int, [*large["files"], *small["files"]])) == list(range(8))
    files = {k: thumbnail(np.full((120, 160, 3), 20 * k, np.uint8)) for k in range(8)}
    write_thumbnails(run.results / "thumbnails.npz", files)
    large, small = embedded(load(run.results), None, Store(tmp_path / "kept"))["pictures"]
    assert large["files"] == {} and sorted(map(int, small["files"])) == list(range(8))


def test_ellipsoids_are_the_covariance_of_the_position():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(3, 6, 6))
    covariance = A @ np.swapaxes(A, 1, 2)
    covariance[1] = np.nan
    T = se3.pose(se3.exp_so3(rng.normal(size=(3, 3))), rng.normal(size=(3, 3)))
    found = ellipsoids(covariance, T)
    assert found[1] is None
    for k in (0, 2):
        R = se3.rotations(np.array(found[k][3:]))
        rebuilt = R @ np.diag(np.square(found[k][:3])) @ R.T
        expected = T[k, :3, :3] @ covariance[k, 3:, 3:] @ T[k, :3, :3].T
        np.testing.assert_allclose(rebuilt, expected, atol=1e-3 * np.abs(expected).max())
        # And by sampling what a small motion [exp(w) | v] does to the camera's position.
        xi = rng.multivariate_normal(np.zeros(6), 1e-6 * covariance[k], 20_000)
        moved = (T[k] @ se3.pose(se3.exp_so3(xi[:, :3]), xi[:, 3:]))[:, :3, 3]
        np.testing.assert_allclose(np.cov(moved.T) * 1e6, expected, atol=0.1 * np.abs(expected).max())
    assert ellipsoids(None, T) == [None] * 3


def test_speed_is_measured_within_a_piece():
    stamps = np.array([0.0, 1, 2, 4, 5])
    positions = np.array([[0, 0, 0], [1, 0, 0], [9, 9, 9], [4, 0, 0], [9, 9, 11.0]])
    speed = speeds(stamps, positions, np.array([0, 0, 1, 0, 1]))
    np.testing.assert_allclose(speed, [1, 1, 2 / 3, 1, 2 / 3])
    assert np.isnan(speeds(stamps[:1], positions[:1], np.array([0]))).all()


def test_frames_edges_and_truth_of_a_run(run):
    data = load(run.results, run.sequence)
    poses = data.results.trajectory
    moved = se3.pose(se3.exp_so3(np.array([0.3, 1, -0.4])), np.array([5.0, 1, 2]))
    evaluation = evaluate(poses, Trajectory(poses.timestamps_s, moved @ poses.T_world_cam), protocol=Protocol())
    shown = scene(data, evaluation)
    frames = shown["frames"]
    assert frames["pose"][5] is None and frames["piece"][5] == -1 and "no match" in frames["reason"][5]
    for k in (0, 1, 2, 3, 4, 6, 7):
        # The truth is the estimate, elsewhere: moved back it lies on it.
        np.testing.assert_allclose(shown["truth"][k], frames["pose"][k][:3], atol=2e-5)
        assert frames["error_m"][k] == pytest.approx(0, abs=1e-6)
    assert shown["truth"][5] is None
    edges = shown["edges"]
    rows = list(zip(edges["i"], edges["j"], strict=True))
    assert sorted(rows) == sorted((e["i"], e["j"]) for e in run.edges)
    verdicts = [edges["verdicts"][v] for v in edges["verdict"]]
    assert verdicts == sorted(verdicts, key=["verified", "weak", "rejected"].index)
    with np.load(run.results / "inliers.npz") as stored:
        px, agrees = unpack_matches(base64.b64decode(edges["packed"]))
        assert agrees.all() and edges["drawn"] == [3] * len(rows)
        for row, some in zip(rows, px.reshape(-1, 3, 4), strict=True):
            e = next(k for k, edge in enumerate(run.edges) if (edge["i"], edge["j"]) == row)
            np.testing.assert_allclose(some[:, :2], stored["px_i"][3 * e : 3 * e + 3], atol=0.51)
            np.testing.assert_allclose(some[:, 2:], stored["px_j"][3 * e : 3 * e + 3], atol=0.51)


def test_rejected_edges_keep_what_was_matched(run):
    first = next(k for k, edge in enumerate(run.edges) if edge["verdict"] == "rejected")
    px = np.array([[10, 20, 30, 40], [300, 500, 70, 65535]], np.uint16)
    good = {"edges": np.array([first]), "offsets": np.array([0, 2]), "px": px, "agrees": np.array([True, False])}
    np.savez_compressed(run.results / "rejected.npz", **good)
    edges = scene(load(run.results), None)["edges"]
    at = list(zip(edges["i"], edges["j"], strict=True)).index((run.edges[first]["i"], run.edges[first]["j"]))
    start = sum(edges["drawn"][:at])
    back, agrees = unpack_matches(base64.b64decode(edges["packed"]))
    np.testing.assert_array_equal(back[start : start + 2], px)
    assert edges["drawn"][at] == 2 and agrees[start : start + 2].tolist() == [True, False]
    for change in ({"edges": np.array([99])}, {"offsets": np.array([0, 3])}, {"px": px[:, :2]}, {"agrees": px}):
        np.savez_compressed(run.results / "rejected.npz", **(good | change))
        with pytest.raises(InputError, match=r"rejected\.npz"):
            load(run.results)


def test_a_piece_apart_is_chained_along_its_edges(run):
    """Frames 6 and 7 are made a piece of their own, whose only edge holds their true motion."""
    data = load(run.results)
    T = {6: data.results.trajectory.T_world_cam[5], 7: data.results.trajectory.T_world_cam[6]}
    lines = (run.results / "trajectory.txt").read_text().splitlines()
    (run.results / "trajectory.txt").write_text("\n".join(lines[:-2]) + "\n")
    text = (run.results / "frames.csv").read_text().splitlines()
    text[-2:] = [line.replace(",1,0,registered", ",0,1,other_piece") for line in text[-2:]]
    (run.results / "frames.csv").write_text("\n".join(text) + "\n")
    table = (run.results / "edges.csv").read_text().splitlines()
    motion = ",".join(f"{v:.9f}" for v in se3.to_rows(se3.inverse(T[7]) @ T[6]))
    table = [f"{line},{motion if line.startswith('6,7,') else ',' * 6}" for line in table]
    table[0] = table[0].rstrip(",") + ",tx,ty,tz,qx,qy,qz,qw"
    (run.results / "edges.csv").write_text("\n".join(table) + "\n")
    assert len(read_table(run.results / "edges.csv")) == len(run.edges)
    placed = place(load(run.results), leveled=False)
    assert placed.piece.tolist() == [0, 0, 0, 0, 0, -1, 1, 1]
    found = se3.inverse(placed.T_world_cam[7]) @ placed.T_world_cam[6]
    np.testing.assert_allclose(found, se3.inverse(T[7]) @ T[6], atol=1e-6)
    others = placed.T_world_cam[:5, :3, 3]
    gap = np.linalg.norm(placed.T_world_cam[6:, None, :3, 3] - others, axis=2).min()
    assert gap > 0.5  # beside the others, not among them


def test_covariances_of_another_run_are_refused(run):
    path = run.results / "covariances.npz"
    np.savez(path, frames=np.array([0, 3]), covariance=np.eye(6)[None].repeat(2, axis=0))
    found = load(run.results).covariance
    assert found.shape == (8, 6, 6) and np.isfinite(found[[0, 3]]).all() and np.isnan(found[1]).all()
    for frames, covariance in (
        ([8], np.eye(6)[None]),
        ([-1], np.eye(6)[None]),
        ([0], np.eye(6)),
        ([0.5], np.eye(6)[None]),
    ):
        np.savez(path, frames=np.array(frames), covariance=covariance)
        with pytest.raises(InputError, match=r"covariances\.npz"):
            load(run.results)


def test_a_report_carries_at_most_so_many_points_and_says_so(run, monkeypatch, tmp_path):
    monkeypatch.setattr("miniloop_cli.report.viewer.embedded.MOST_POINTS", 500)
    view = embedded(load(run.results, run.sequence), None, Store(tmp_path / "kept"))
    assert view["model"]["count"] == 500
    assert view["notes"] == ["500 of the 2,000 points; `miniloop view` shows all."]
    assert sum(len(size["files"]) for size in view["pictures"]) == 8
    write_ply(run.results / "cloud.ply", np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    assert embedded(load(run.results), None, Store(tmp_path / "kept"))["model"] is None


def test_the_script_is_built_from_the_sources():
    """After a change of viewer/src: npm ci && npm run build in viewer/."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "viewer" / "src").iterdir()):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    digest.update((ROOT / "viewer" / "package-lock.json").read_bytes())
    assets = ROOT / "miniloop_cli" / "report" / "viewer" / "assets"
    first = (assets / "viewer.js").open(encoding="ascii").readline()
    assert digest.hexdigest() in first
    three = json.loads((ROOT / "viewer" / "package.json").read_text())["devDependencies"]["three"]
    assert f"three.js {three}, MIT licence" in first
    assert "three.js authors" in (assets / "three.LICENSE.txt").read_text(encoding="utf-8")


def test_the_script_sets_no_markup():
    """Names come from recordings: they are set as text, never as HTML."""
    for path in (ROOT / "viewer" / "src").iterdir():
        assert not re.search(
            r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|new Function", path.read_text()
        )
