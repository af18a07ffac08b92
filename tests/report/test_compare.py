"""`miniloop compare`: two results, or a result and the poses of another program."""

import json
import re
import shutil
import struct

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from click.testing import CliRunner

from miniloop_cli.cli.main import cli
from miniloop_cli.datasets.named_poses import by_time, read_named_poses
from miniloop_cli.datasets.trajectory import read_trajectory, write_trajectory
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.results.columns import load
from miniloop_cli.results.comparison import compare, read_side
from miniloop_cli.scene.sequence import Trajectory

MOVED = se3.pose(se3.exp_so3(np.array([0.2, -1, 0.5])), np.array([3.0, -1, 2]))
GL = np.diag([1.0, -1, -1, 1])


@pytest.fixture
def other(run, tmp_path):
    """A second result: elsewhere, frame 3 moved by 30 cm, one edge less, one more, another setting."""
    folder = tmp_path / "other"
    shutil.copytree(run.results, folder)
    poses = load(run.results).results.trajectory
    T = MOVED @ poses.T_world_cam
    T[3, :3, 3] += [0.3, 0, 0]
    write_trajectory(folder / "trajectory.txt", Trajectory(poses.timestamps_s, T))
    lines = (run.results / "edges.csv").read_text().splitlines()
    gone = next(k for k, line in enumerate(lines) if line.startswith("1,2,"))
    added = lines[gone].replace("1,2,100.1,100.2", "1,4,100.1,100.4")
    (folder / "edges.csv").write_text("\n".join([*lines[:gone], *lines[gone + 1 :], added]) + "\n")
    (run.results / "config.yaml").write_text("matching:\n  count: 5\n  ratio: 0.8\nrefine: bundle\n")
    (folder / "config.yaml").write_text("matching:\n  count: 7\n  ratio: 0.8\nrefine: bundle\n")
    return folder


def test_where_two_results_differ(run, other):
    found = compare(read_side(run.results, "a"), read_side(other, "b"), run.sequence.root)
    assert found.frames.tolist() == [0, 1, 2, 3, 4, 6, 7]
    assert found.distances_m.argmax() == 3 and 0.2 < found.distances_m.max() < 0.3
    assert found.farthest == "3"
    assert found.only == (frozenset({(1, 2)}), frozenset({(1, 4)}))
    assert found.shared_edges == len([e for e in run.edges if e["verdict"] == "verified"]) - 1
    assert found.settings == (("matching.count", 5, 7),)
    exact, moved = (error.numbers["ate_rmse_m"] for error in found.errors)
    assert exact < 1e-6 < 0.05 < moved < 0.2


def test_the_command_writes_table_page_and_json(run, other, tmp_path):
    page, numbers = tmp_path / "out" / "page.html", tmp_path / "numbers.json"
    arguments = ["compare", str(run.results), str(other), "--sequence", str(run.sequence.root), "-o", str(page)]
    done = CliRunner().invoke(cli, [*arguments, "--json", str(numbers)], catch_exceptions=False)
    assert re.search(r"verified edges that only it has +1 +1\n", done.stdout)
    assert re.search(r"matching\.count +5 +7\n", done.stdout)
    assert "They differ most at frame 3." in done.stdout
    assert json.loads(numbers.read_text())["only"] == [[[1, 2]], [[1, 4]]]
    html = page.read_text()
    scene = json.loads(re.search(r'id="v-scene">(.*?)</script>', html, re.DOTALL)[1])
    edges = scene["edges"]
    origin = dict(zip(zip(edges["i"], edges["j"], strict=True), edges["origin"], strict=True))
    assert origin[1, 2] == 1 and origin[1, 4] == 2 and origin[0, 1] == 0
    assert (
        len({len(column) for name, column in edges.items() if name in ("i", "j", "px", "deg", "origin", "cycle")}) == 1
    )
    shift = np.array(scene["other"]["positions"][6]) - scene["frames"]["pose"][6][:3]
    assert np.linalg.norm(shift) < 0.2  # laid over the first, in its world
    assert scene["frames"]["difference_m"][3] > 0.2 and scene["frames"]["difference_m"][5] is None
    assert '"><script>document' not in html


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_the_page_shows_both(run, other, tmp_path):
    page = tmp_path / "page.html"
    arguments = ["compare", str(run.results), str(other), "--sequence", str(run.sequence.root), "-o", str(page)]
    CliRunner().invoke(cli, arguments, catch_exceptions=False)
    with Browser(800, 600) as browser:
        browser.open(page.as_uri())
        for name, value in (("edge-mode", "verified"), ("edge-color", "origin"), ("path-color", "difference_m")):
            browser.run(f"(() => {{ const e = document.getElementById('v-{name}'); e.value = '{value}';"
                        "e.dispatchEvent(new Event('change')); })()")  # fmt: skip
        legend = browser.run("document.getElementById('v-legend').innerText")
        assert "only results" in legend and "only other" in legend and "difference 0" in legend
        browser.run("location.hash = '#edge=1-4'")
        browser.until("document.getElementById('v-details').innerText.includes('only other')")
        assert browser.problems == []


def colmap_text(folder, names, T_world_cam):
    rows = [se3.to_rows(T) for T in se3.inverse(T_world_cam)]
    lines = ["# Image list"]
    for k, (name, r) in enumerate(zip(names, rows, strict=True)):
        lines += [f"{k + 1} {r[6]} {r[3]} {r[4]} {r[5]} {r[0]} {r[1]} {r[2]} 1 {name}", "1.5 2.5 -1 3 4 17"]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")


def colmap_binary(folder, names, T_world_cam):
    data = struct.pack("<Q", len(names))
    for k, (name, r) in enumerate(zip(names, se3.to_rows(se3.inverse(T_world_cam)), strict=True)):
        data += struct.pack("<I7dI", k + 1, r[6], *r[3:6], *r[:3], 1) + name.encode() + b"\0"
        data += struct.pack("<Q", 2) + struct.pack("<ddqddq", 1, 2, -1, 3, 4, 5)
    (folder / "images.bin").write_bytes(data)


def transforms(folder, names, T_world_cam):
    frames = [
        {"file_path": f"images/{n}", "transform_matrix": (T @ GL).tolist()}
        for n, T in zip(names, T_world_cam, strict=True)
    ]
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))


@pytest.mark.parametrize("write", [colmap_text, colmap_binary, transforms])
@pytest.mark.parametrize("naming", ["numbers", "stamps", "own"])
def test_poses_by_name_are_laid_over_a_result(run, tmp_path, write, naming):
    data = load(run.results, run.sequence)
    poses = data.results.trajectory
    kept = [0, 1, 2, 3, 4, 6, 7]
    T = MOVED @ poses.T_world_cam
    T[:, :3, 3] *= 2.5  # as without depth: in no units
    names = {
        "numbers": [f"{k:06d}.png" for k in kept],
        "stamps": [f"{t:.6f}.jpg" for t in poses.timestamps_s],
        "own": [run.sequence.frames[k].color.path.name for k in kept],
    }[naming]
    folder = tmp_path / "model"
    folder.mkdir()
    write(folder, names, T)
    side = read_side(folder, "other", data, run.sequence if naming == "own" else None)
    np.testing.assert_allclose(side.trajectory.timestamps_s, poses.timestamps_s, atol=1e-6)
    found = compare(read_side(run.results, "a"), side, with_scale=True)
    assert found.distances_m.max() < 1e-5 and found.angles_deg.max() < 1e-4
    assert found.scale == pytest.approx(2.5)


def test_a_trajectory_of_rtabmap(run, tmp_path):
    poses = load(run.results).results.trajectory
    lines = ["#timestamp x y z qx qy qz qw id"]
    for k, (t, r) in enumerate(zip(poses.timestamps_s, se3.to_rows(MOVED @ poses.T_world_cam), strict=True)):
        lines.append(f"{t:.6f} " + " ".join(f"{v:.9f}" for v in r) + f" {k + 1}")
    (tmp_path / "rtabmap_poses.txt").write_text("\n".join(lines) + "\n")
    side = read_side(tmp_path / "rtabmap_poses.txt", "rtabmap", load(run.results))
    assert compare(read_side(run.results, "a"), side).distances_m.max() < 1e-5


def test_what_cannot_be_compared_is_said(run, tmp_path):
    data = load(run.results)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="neither a results folder"):
        read_side(tmp_path / "empty", "b", data)
    later = Trajectory(9000.0 + np.arange(5), np.repeat(np.eye(4)[None], 5, axis=0))
    write_trajectory(tmp_path / "later.txt", later)
    with pytest.raises(MiniloopError, match="later cannot be aligned to"):
        compare(
            read_side(run.results, "a"),
            type(read_side(run.results, "a"))("later", read_trajectory(tmp_path / "later.txt")),
        )
    colmap_text(tmp_path, ["left.png", "right.png", "x.png"], np.repeat(np.eye(4)[None], 3, axis=0))
    with pytest.raises(InputError, match="named neither"):
        by_time(read_named_poses(tmp_path), data.frames.timestamp_s)
    for name, content in (
        ("images.txt", b"1 1 0 0 0 0 0 0\n"),
        ("images.txt", b"1 9 0 0 0 0 0 0 1 a.png\n\n"),
        ("images.bin", b"\x05"),
        ("images.bin", struct.pack("<Q", 1 << 60)),
        ("images.bin", struct.pack("<Q", 0) + b"x"),
        ("transforms.json", b'{"frames": [{"transform_matrix": [1]}]}'),
        ("transforms.json", b'{"frames": 3}'),
    ):
        folder = tmp_path / "damaged"
        folder.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            read_named_poses(folder / name)
