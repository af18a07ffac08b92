"""scripts/fetch_tum.sh against archives on this machine."""

import http.server
import os
import shutil
import subprocess
import sys
import tarfile
import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.scene.sequence import Trajectory

SCRIPT = Path(__file__).parents[2] / "scripts" / "fetch_tum.sh"
pytestmark = pytest.mark.skipif(
    not SCRIPT.exists() or not all(map(shutil.which, ("bash", "curl", "tar", "gzip"))),
    reason="needs the repository, bash, curl, tar and gzip",
)
NAME = "freiburg1_tiny"


@pytest.fixture
def archive(tmp_path, make_tum):
    """A server's folder with one archive of 5 frames; the ground truth covers all but the first."""
    tum = make_tum(tmp_path / "made" / f"rgbd_dataset_{NAME}")
    stamps = np.linspace(10.05, 11, 20)
    write_trajectory(tum.root / "groundtruth.txt", Trajectory(stamps, np.broadcast_to(np.eye(4), (20, 4, 4))))
    served = tmp_path / "served" / "freiburg1"
    served.mkdir(parents=True)
    with tarfile.open(served / f"rgbd_dataset_{NAME}.tgz", "w:gz") as tar:
        tar.add(tum.root, arcname=tum.root.name)
    return served / f"rgbd_dataset_{NAME}.tgz"


def run(tmp_path, *arguments, url=None):
    url = url or f"file://{tmp_path / 'served'}"
    environment = os.environ | {"MINILOOP_TUM_URL": url, "PYTHON": sys.executable}
    environment["PYTHONPATH"] = str(SCRIPT.parents[1])
    command = ["bash", str(SCRIPT), "-d", str(tmp_path / "data"), *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)


def test_fetches_once_and_cuts_a_subset(tmp_path, archive):
    first = run(tmp_path, f"rgbd_dataset_{NAME}", "--subset", "3")
    assert first.returncode == 0, first.stderr
    whole, cut = tmp_path / "data" / f"rgbd_dataset_{NAME}", tmp_path / "data" / f"{NAME}_3"
    assert sorted(p.name for p in (tmp_path / "data").iterdir()) == sorted([whole.name, cut.name])
    assert len(open_sequence(whole).frames) == 5
    frames = open_sequence(cut).frames
    assert [f.timestamp_s for f in frames] == pytest.approx(
        [10.1, 10.3, 10.4]
    )  # round(linspace(0, 3, 3)) of the covered
    assert (cut / "groundtruth.txt").read_bytes() == (whole / "groundtruth.txt").read_bytes()
    assert frames[1].color.path.read_bytes() == (whole / "rgb" / "10.300000.png").read_bytes()
    archive.unlink()
    again = run(tmp_path, NAME, "--subset", "3")
    assert again.returncode == 0 and again.stderr.count("is there") == 2


def test_resumes_where_it_was_cut_off(tmp_path, archive):
    (tmp_path / "data").mkdir()
    part = tmp_path / "data" / f"rgbd_dataset_{NAME}.tgz.part"
    part.write_bytes(archive.read_bytes()[:1000])
    with archive.open("r+b") as file:  # proves that the first part was not fetched again
        file.write(b"\0" * 500)
    done = run(tmp_path, NAME)
    assert done.returncode == 0, done.stderr
    assert len(open_sequence(tmp_path / "data" / f"rgbd_dataset_{NAME}").frames) == 5


def test_starts_again_where_the_server_cannot_resume(tmp_path, archive):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / f"rgbd_dataset_{NAME}.tgz.part").write_bytes(archive.read_bytes()[:1000])

    class Quiet(http.server.SimpleHTTPRequestHandler):  # knows no ranges
        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=tmp_path / "served"))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        done = run(tmp_path, NAME, url=f"http://127.0.0.1:{server.server_port}")
    finally:
        server.shutdown()
        server.server_close()
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "data" / f"rgbd_dataset_{NAME}" / "rgb.txt").exists()


def test_damaged_archives_are_not_extracted(tmp_path, archive):
    whole = archive.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"<html>moved</html>", whole[:2000] + b"\0" * 50 + whole[2050:]):
        archive.write_bytes(damaged)
        done = run(tmp_path, NAME)
        assert done.returncode == 1 and "came damaged and was removed" in done.stderr
        assert list((tmp_path / "data").iterdir()) == []


def test_archives_that_write_elsewhere_are_refused(tmp_path, archive):
    evil = tmp_path / "evil.txt"
    evil.write_text("x")
    with tarfile.open(archive, "w:gz") as tar:
        tar.add(tmp_path / "made" / f"rgbd_dataset_{NAME}", arcname=f"rgbd_dataset_{NAME}")
        tar.add(evil, arcname="../evil.txt")
    done = run(tmp_path, NAME)
    assert done.returncode == 1 and "damaged" in done.stderr


def test_messages(tmp_path):
    done = run(tmp_path, NAME, url="http://127.0.0.1:9")
    assert done.returncode == 1 and "no network" in done.stderr.splitlines()[-1]
    for arguments, words in (
        (["kitchen"], "is no sequence"),
        (["freiburg1_../x"], "is no sequence"),
        (["--subset", "many"], "needs a number"),
        (["--fast"], "unknown option"),
    ):
        done = run(tmp_path, *arguments)
        assert done.returncode == 2 and words in done.stderr
    assert "freiburg1_room" in run(tmp_path, "--list").stdout


def test_too_large_a_subset_is_refused(tmp_path, archive):
    done = run(tmp_path, NAME, "--subset", "5")
    assert done.returncode == 1 and "has 4 frames; choose at most so many, not 5" in done.stderr
    assert not (tmp_path / "data" / f"{NAME}_5").exists()


@pytest.mark.real
@pytest.mark.skipif(not os.environ.get("MINILOOP_TUM"), reason="MINILOOP_TUM is not set")
def test_subset_of_a_subset_is_itself(tmp_path):
    from miniloop_cli.datasets.subset import write_subset

    source = Path(os.environ["MINILOOP_TUM"]) / "freiburg1_xyz_100"
    write_subset(source, tmp_path / "copy", 100)
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        assert (tmp_path / "copy" / name).read_bytes() == (source / name).read_bytes()
