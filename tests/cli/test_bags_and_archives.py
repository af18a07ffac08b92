"""Bags and archives on the command line: the same poses as from the folder, topics by name, errors in one line."""

import json
import zipfile

import numpy as np
import pytest
from command_line import launch

from miniloop_cli.datasets import open_sequence, read_trajectory
from tests.datasets.bag_writers import COLOR, DEPTH, BagWriter, write_rgbd

INFO = "/camera/color/camera_info"


def bag_of(folder, path, kind="ros1"):
    """A bag with the images of a recording; depth in metres, so that no digit is lost."""
    sequence = open_sequence(folder)
    camera = sequence.camera
    with BagWriter(path, kind) as bag:
        for frame in sequence.frames:
            depth_m = frame.depth.read().astype(np.float32) / np.float32(camera.depth_scale)
            bag.image(COLOR, frame.color.read(), "rgb8", frame.timestamp_s)
            bag.image(DEPTH, depth_m, "32FC1", frame.depth_timestamp_s)
            size = (camera.width, camera.height)
            bag.info(INFO, frame.timestamp_s, size, camera.K.ravel(), camera.lens.coefficients)
    return path


def zipped(folder, path):
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(folder.rglob("*")):
            archive.write(file, f"room/{file.relative_to(folder).as_posix()}")
    return path


def test_inspect_a_bag(tmp_path):
    done = launch("inspect", write_rgbd(tmp_path / "scan.bag"), "--json", "-")
    assert done.returncode == 0, done.stderr
    numbers = json.loads(done.stdout)
    assert (numbers["layout"], numbers["frames"]) == ("ros", 5)
    assert any(DEPTH in note for note in numbers["notes"])


def test_topics_are_named_and_refused(tmp_path):
    path = write_rgbd(tmp_path / "scan.bag")
    done = launch("inspect", path, "--topics", f"color={COLOR},depth={DEPTH},info={INFO}")
    assert done.returncode == 0, done.stderr
    for command in ("inspect", "register"):
        for topics, said in (("color=/none", "has no such topic"), ("nonsense", "--topics is a list such as")):
            done = launch(command, path, "--topics", topics)
            assert done.returncode == 1 and said in done.stderr
            assert len(done.stderr.strip().splitlines()) == 1, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["room.bag", "room.zip"])
def test_it_is_registered_as_the_folder_is(tmp_path, recording, registered, kind):
    path = bag_of(recording, tmp_path / kind) if kind == "room.bag" else zipped(recording, tmp_path / kind)
    results = tmp_path / "results"
    topics = ("--topics", f"color={COLOR}") if kind == "room.bag" else ()
    done = launch("register", path, "-o", results, "-q", "-j", 1, *topics)
    assert done.returncode == 0, done.stderr
    expected, found = (read_trajectory(folder / "trajectory.txt") for folder in (registered.folder, results))
    np.testing.assert_allclose(found.timestamps_s, expected.timestamps_s, atol=1e-6)
    np.testing.assert_allclose(found.T_world_cam, expected.T_world_cam, atol=1e-6)
    # The recording is found again by what the summary says.
    done = launch("export", results, "--to", "nerfstudio", "-o", tmp_path / "export")
    assert done.returncode == 0, done.stderr
    frames = json.loads((tmp_path / "export" / "transforms.json").read_text())["frames"]
    assert len(frames) == len(found.timestamps_s)
    assert all((tmp_path / "export" / frame["file_path"]).is_file() for frame in frames)


@pytest.mark.slow
def test_the_ground_truth_in_an_archive_is_that_of_the_folder(tmp_path, recording, registered):
    numbers = []
    for truth in (recording, zipped(recording, tmp_path / "room.zip")):
        done = launch("eval", registered.folder, "--gt", truth, "--json", "-")
        assert done.returncode == 0, done.stderr
        numbers.append(json.loads(done.stdout))
    assert numbers[0]["ate_rmse_m"] == numbers[1]["ate_rmse_m"] > 0
    done = launch("eval", registered.folder, "--gt", write_rgbd(tmp_path / "scan.bag"))
    assert done.returncode == 1 and "has no ground truth" in done.stderr
