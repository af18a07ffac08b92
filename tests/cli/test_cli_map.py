"""Maps on the command line: look into one, find images in it, make one of several recordings, add to it, take out."""

import base64
import json
import os
import shutil

import numpy as np
import pytest
from command_line import ROOT, launch

from miniloop_cli import Map, maps
from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.report.map_page import write_map_page
from miniloop_cli.report.viewer.map_scene import load_map
from miniloop_cli.report.viewer.matches import unpack_matches
from miniloop_cli.report.viewer.shown import show_map
from miniloop_cli.results.map_files import up_to_date
from miniloop_cli.results.map_folder import manifest_hash, read_map
from miniloop_cli.results.map_verdict import map_verdict
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.folder_lock import exclusive
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence

pytestmark = pytest.mark.slow  # recordings are simulated and registered

SETTINGS = SimulationSettings(frames=18, width=320, height=240, path="xyz")


def part_of_recording(whole, folder, rows):
    """A recording of some frames of another one."""
    shutil.copytree(whole, folder)
    for table in ("rgb.txt", "depth.txt"):
        lines = (whole / table).read_text().splitlines()
        images = [line for line in lines if not line.startswith("#")]
        for k in set(range(len(images))) - set(rows):
            (folder / images[k].split()[1]).unlink()
        (folder / table).write_text("\n".join(images[k] for k in rows) + "\n")
    return folder


@pytest.fixture(scope="module")
def recordings(shared):
    """Three recordings of one room, which share no frame, and one of another room."""
    whole = write_sequence(shared / "whole", SETTINGS, seed=5)
    rows = {"first": range(0, 18, 3), "second": range(1, 18, 3), "third": range(2, 18, 3)}
    found = {name: part_of_recording(whole, shared / name, list(of)) for name, of in rows.items()}
    return found | {"whole": whole, "elsewhere": write_sequence(shared / "elsewhere", SETTINGS, seed=11)}


@pytest.fixture(scope="module")
def office(shared, recordings):
    """The map of the first two."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINILOOP_CACHE", str(shared / "cache"))
        done = launch("register", recordings["first"], recordings["second"], "-o", shared / "office", "-j", 1)
    assert done.returncode == 0, done.stderr
    return shared / "office", done.stdout


@pytest.fixture
def copy(office, tmp_path):
    return shutil.copytree(office[0], tmp_path / "office")


def poses(folder):
    return read_trajectory(folder / "trajectory.txt")


def largest_difference(a, b):
    """Of two folders' trajectories: centimetres and degrees, after the first pose is laid on the other one's."""
    P, Q = poses(a).T_world_cam, poses(b).T_world_cam
    E = se3.inverse(Q) @ (Q[0] @ se3.inverse(P[0]) @ P)
    return 100 * np.linalg.norm(E[:, :3, 3], axis=1).max(), se3.rotation_angle_deg(E[:, :3, :3]).max()


def test_a_result_says_what_its_map_holds(registered):
    done = launch("map", "info", registered.folder)
    assert done.returncode == 0
    assert "8 of 8 frames, 8 keyframes" in done.stdout
    numbers = json.loads(launch("map", "info", registered.folder, "--json", "-").stdout)
    assert numbers["bytes"] < 200_000 * numbers["keyframes"]
    assert numbers["points"] > 100
    size = sum(path.stat().st_size for path in (registered.folder / "map").glob("*.npz"))
    assert numbers["bytes"] == size


def test_a_folder_without_a_map_says_so(tmp_path):
    for arguments in (("map", "info", tmp_path), ("locate", tmp_path, "x.png"), ("add", tmp_path, "x")):
        done = launch(*arguments)
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr == f"miniloop: {tmp_path} holds no map: give a folder that `miniloop register` wrote\n"
        assert not list(tmp_path.iterdir())


def test_recordings_of_one_room_lie_in_one_frame(office, recordings):
    folder, said = office
    assert "first and second by" in said
    numbers = json.loads((folder / "summary.json").read_text())
    assert numbers["pieces"] == 1
    assert numbers["certificate"]["certified"] and numbers["certificate"]["relative_gap"] <= 1e-4
    assert [r["registered"] for r in numbers["recordings"]] == [6, 6]
    truth = {round(t, 4): T for t, T in zip(*_truth(recordings["whole"]), strict=True)}
    found = [
        (T, truth[round(t, 4)]) for name in ("first", "second") for t, T in zip(*_both(folder / name), strict=True)
    ]
    P, Q = (np.array(side) for side in zip(*found, strict=True))
    E = se3.inverse(Q) @ (Q[0] @ se3.inverse(P[0]) @ P)
    assert np.linalg.norm(E[:, :3, 3], axis=1).max() < 0.02
    assert (folder / "cloud.ply").stat().st_size > 10_000
    assert (folder / "first" / "report.html").is_file()


def _truth(recording):
    truth = read_trajectory(recording / "groundtruth.txt")
    return truth.timestamps_s, truth.T_world_cam


def _both(folder):
    found = poses(folder)
    return found.timestamps_s, found.T_world_cam


def test_a_note_on_a_joint_is_a_sentence_of_the_page(office, tmp_path):
    copy = shutil.copytree(office[0], tmp_path / "copy")
    numbers = json.loads((copy / "summary.json").read_text()) | {"notes": ["too few frames show the same place"]}
    page = write_map_page(copy, read_map(copy), numbers, Store(tmp_path / "kept")).read_text()
    assert "<li>Too few frames show the same place.</li>" in page


def test_a_map_says_whether_it_can_be_trusted(office, recordings, tmp_path):
    folder, said = office
    verdict = json.loads((folder / "summary.json").read_text())["verdict"]
    assert verdict == {"level": "good", "reasons": []}
    assert said.splitlines()[-1] == "good        no check contradicts it"
    apart = tmp_path / "apart"
    done = launch("register", recordings["first"], recordings["elsewhere"], "-o", apart, "-j", 1, "--strict")
    assert done.returncode == 1 and "the result is doubtful: the recordings form 2 pieces" in done.stderr
    doubt = "the recordings form 2 pieces, and no edges join the pieces"
    assert f"doubtful    {doubt}" in done.stdout
    page = (apart / "report.html").read_text()
    assert 'class="verdict doubtful"' in page and f"<li>{doubt}" in page
    assert 'class="verdict good"' in (folder / "report.html").read_text()
    # What is doubted in one of the recordings is doubted in the map.
    shutil.copytree(folder, tmp_path / "copy")
    summary = tmp_path / "copy" / "first" / "summary.json"
    numbers = json.loads(summary.read_text())
    numbers["verdict"] |= {"level": "bad", "reasons": ["it is upside down"]}
    summary.write_text(json.dumps(numbers))
    found = map_verdict(tmp_path / "copy", read_map(tmp_path / "copy"), {"attic": "it is dark"})
    assert found["level"] == "bad"
    assert found["reasons"] == ["first: it is upside down", "attic could not be registered and is left out: it is dark"]
    summary.write_text("{}")
    assert map_verdict(tmp_path / "copy", read_map(tmp_path / "copy"), {})["level"] == "doubtful"


def test_adding_gives_what_registering_together_gives(copy, recordings, tmp_path):
    before = manifest_hash(copy)
    done = launch("add", copy, recordings["third"], "-j", 1)
    assert done.returncode == 0, done.stderr
    assert "seconds" in done.stdout
    assert manifest_hash(copy) != before
    names = ("first", "second", "third")
    together = tmp_path / "together"
    assert launch("register", *(recordings[name] for name in names), "-o", together, "-j", 1, "-q").returncode == 0
    for name in names:
        cm, deg = largest_difference(copy / name, together / name)
        assert cm < 0.05
        assert deg < 0.02
    again = launch("add", copy, recordings["third"], "-j", 1)
    assert again.returncode == 1
    assert "is in the map already" in again.stderr
    assert launch("map", "remove", copy, "third", "-j", 1).returncode == 0
    assert not (copy / "third").exists()
    assert manifest_hash(copy) == before


def test_a_map_of_one_recording_takes_another(registered, recordings, tmp_path):
    folder = shutil.copytree(registered.folder, tmp_path / "room")
    done = launch("add", folder, recordings["elsewhere"], "-j", 1)
    assert done.returncode == 0, done.stderr
    assert "2, not joined to each other" in done.stdout
    assert {"map", "room", "elsewhere", "summary.json", "cloud.ply", "report.html"} == {
        path.name for path in folder.iterdir()
    }
    assert (folder / "room" / "report.html").is_file()
    assert len(poses(folder / "room").timestamps_s) == 8
    done = launch("map", "remove", folder, "nowhere")
    assert done.returncode == 1
    assert "no recording 'nowhere'; it has room, elsewhere" in done.stderr


def test_an_addition_that_ends_half_way_leaves_the_map_as_it_was(copy, recordings, monkeypatch):
    from miniloop_cli.results import map_files, map_folder

    def killed(*arguments, **more):
        raise KeyboardInterrupt

    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(map_folder, "joined_arrays", killed)
        maps.add(copy, recordings["third"], jobs=1)
    assert all(path.read_bytes() == content for path, content in before.items())
    assert Map.open(copy).recordings == ("first", "second")
    # Killed after the map has changed: whoever changes it next writes the files beside it.
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(map_files, "map_trajectories", killed)
        maps.add(copy, recordings["third"], jobs=1)
    assert Map.open(copy).recordings == ("first", "second", "third")
    with pytest.raises(MiniloopError, match="in the map already"):
        maps.add(copy, recordings["third"], jobs=1)
    assert len(poses(copy / "third").timestamps_s) == 6


@pytest.mark.skipif(os.name != "posix", reason="needs signals that end a process")
def test_additions_that_are_killed_lose_nothing(copy, recordings, shared, monkeypatch):
    """By both signals, early and while the new map is written; `python -m benchmarks kills` does it a hundred times."""
    from benchmarks.map_kills import SIGNALS, added, killed_once

    monkeypatch.setenv("MINILOOP_CACHE", str(shared / "cache"))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    whole = shutil.copytree(copy, copy.parent / "whole")
    assert launch("add", whole, recordings["third"], "-j", 1, "-q").returncode == 0
    after = manifest_hash(whole)
    for k, (near_end, wait_s) in enumerate(((False, 1.0), (True, 0.0), (True, 0.2))):
        folder = shutil.copytree(copy, copy.parent / f"killed{k}" / copy.name)
        left = killed_once(folder, recordings["third"], after, SIGNALS[k % 2], wait_s, near_end)
        said = added(folder, recordings["third"])
        assert ("is in the map already" in said) == left.changed
        assert manifest_hash(folder) == after
        assert up_to_date(folder)
        assert len(poses(folder / "third").timestamps_s) == 6


def test_two_processes_do_not_change_one_map(copy, recordings):
    with exclusive(copy):
        done = launch("add", copy, recordings["third"])
        assert done.returncode == 1
        assert "is in use by another run" in done.stderr
        assert launch("map", "info", copy).returncode == 0, "readers need not wait"


def test_an_image_is_found_where_it_was_taken(office, recordings):
    folder, _ = office
    sequence = open_sequence(recordings["third"])
    color = sequence.frames[2].color.path
    depth = sequence.frames[2].depth.path
    opened = Map.open(folder)
    stamps, T = _truth(recordings["whole"])
    P = poses(folder / "first")
    first = int(np.abs(stamps - P.timestamps_s[0]).argmin())
    truth = P.T_world_cam[0] @ se3.inverse(T[first]) @ T[np.abs(stamps - sequence.frames[2].timestamp_s).argmin()]
    for options in ((), ("--depth", depth)):
        done = launch("locate", folder, color, *options, "--json", "-")
        assert done.returncode == 0, done.stderr
        (row,) = json.loads(done.stdout)["rows"]
        assert row["found"]
        assert row["inliers"] > 30
        E = se3.inverse(truth) @ np.array(row["T_world_cam"])
        assert np.linalg.norm(E[:3, 3]) < 0.02
        assert se3.rotation_angle_deg(E[:3, :3]) < 1
        assert np.linalg.eigvalsh(row["covariance"]).min() > 0
        assert row["keyframes"][0]["recording"] in opened.recordings
    scan = read_scan(sequence, 2)
    found = opened.locate(scan.color, scan.depth_m, sequence.camera)
    assert np.allclose(found.T_world_cam, row["T_world_cam"], atol=1e-3)
    assert "found" in launch("locate", folder, color).stdout


def test_a_photograph_of_unknown_focal_length_is_found(office, recordings):
    """Cropped, so that no camera of the map fits its size."""
    sequence = open_sequence(recordings["third"])
    scan = read_scan(sequence, 2)
    found = Map.open(office[0]).locate(scan.color[10:-10, 16:-16])
    assert found.found
    assert abs(found.focal_px / sequence.camera.fx - 1) < 0.05
    whole = Map.open(office[0]).locate(scan.color, camera=sequence.camera)
    assert np.linalg.norm((se3.inverse(whole.T_world_cam) @ found.T_world_cam)[:3, 3]) < 0.1


def test_another_room_is_not_in_the_map(office, recordings):
    done = launch("locate", office[0], recordings["elsewhere"], "--json", "-")
    assert done.returncode == 1
    rows = json.loads(done.stdout)["rows"]
    assert len(rows) == 18
    assert not any(row["found"] for row in rows)
    assert all(row["reason"].startswith("not in this map: ") for row in rows)
    assert done.stderr.startswith("miniloop: none of 18 images was found")


def test_what_cannot_be_looked_for_is_said(office, recordings, tmp_path):
    folder = office[0]
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    done = launch("locate", folder, tmp_path, "--json", "-")
    assert done.returncode == 1
    assert "cannot be read" in json.loads(done.stdout)["rows"][0]["reason"]
    assert "does not exist" in launch("locate", folder, tmp_path / "gone.png").stderr
    color = open_sequence(recordings["third"]).frames[0].color.path
    assert "has no file" in launch("locate", folder, color, "--depth", tmp_path).stderr


def test_several_recordings_need_a_folder_and_know_what_is_for_one(recordings, tmp_path):
    pair = (recordings["first"], recordings["second"])
    done = launch("register", *pair)
    assert done.returncode == 2
    assert "name its folder with -o DIR" in done.stderr
    done = launch("register", *pair, "-o", tmp_path / "x", "--gravity", tmp_path / "imu.txt")
    assert done.returncode == 2
    assert "--gravity is for one recording" in done.stderr
    done = launch("register", recordings["first"], recordings["first"], "-o", tmp_path / "x", "-j", 1)
    assert done.returncode == 1
    assert "is in the map already" in done.stderr
    assert not (tmp_path / "x").exists()


def test_all_recordings_stand_in_one_view(office):
    folder = office[0]
    content = read_map(folder)
    shown = show_map(load_map(folder, content), folder)
    scene = shown.values
    assert [r["name"] for r in scene["recordings"]] == ["first", "second"]
    assert [(r["first"], r["count"]) for r in scene["recordings"]] == [(0, 6), (6, 6)]
    for r, name in enumerate(("first", "second")):
        T = poses(folder / name).T_world_cam
        at = [pose[:3] for pose in scene["frames"]["pose"][6 * r : 6 * r + 6]]
        np.testing.assert_allclose(at, T[:, :3, 3], atol=2e-6)
    edges, T = scene["edges"], np.concatenate([poses(folder / name).T_world_cam for name in ("first", "second")])
    between = [e for e, (i, j) in enumerate(zip(edges["i"], edges["j"], strict=True)) if i < 6 <= j]
    verified = [e for e in between if edges["verdicts"][edges["verdict"][e]] == "verified"]
    joins = json.loads((folder / "summary.json").read_text())["joins"]
    assert len(verified) == sum(join["edges"] for join in joins) > 0
    # The matches that are drawn are of these frames: by the poses, each lies on the epipolar line of its partner.
    px, _ = unpack_matches(base64.b64decode(edges["packed"]))
    camera = content.parts[0].camera
    for e in verified[:5]:
        start = sum(edges["drawn"][:e])
        rows = px[start : start + edges["drawn"][e]].astype(float)
        ideal = [camera.undistort(rows[:, k : k + 2]) for k in (0, 2)]
        rays = [np.c_[p - [camera.cx, camera.cy], np.full(len(p), camera.fx)] for p in ideal]
        T_j_i = se3.inverse(T[edges["j"][e]]) @ T[edges["i"][e]]
        lines = np.cross(T_j_i[:3, 3], rays[0] @ T_j_i[:3, :3].T)
        distance_px = np.abs((lines * rays[1]).sum(axis=1)) / np.linalg.norm(lines[:, :2], axis=1)
        assert np.median(distance_px) < 1.5
    kind, image = shown.answer("frame/7.jpg")
    assert kind == "image/jpeg" and len(image) > 1000
    assert shown.answer("frame/12.jpg") is None
    page = (folder / "report.html").read_text()
    assert 'id="v-scene"' in page and "default-src 'none'; img-src data:" in page


def test_recordings_of_a_room_that_looks_alike_when_half_turned_are_no_sure_thing(shared):
    """The second goes on where the first ends, and most of what it shows looks like what the first shows."""
    room = SimulationSettings(frames=36, width=240, height=180, alike="half-turn")
    whole = write_sequence(shared / "half-turn", room, seed=0)
    rows = {"begin": range(14), "end": range(12, 28)}
    folders = [part_of_recording(whole, shared / name, list(of)) for name, of in rows.items()]
    done = launch("register", *folders, "-o", shared / "alike", "-j", 1, "--strict")
    assert done.returncode == 1 and "the result is doubtful" in done.stderr
    reasons = json.loads((shared / "alike" / "summary.json").read_text())["verdict"]["reasons"]
    assert any(reason.startswith("joined to the others, begin is bent between frames ") for reason in reasons)
