"""What a user may get wrong: one clear line on stderr, exit status 1 or 2, and nothing half-written."""

import json
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import FRAMES, command, environment, invoke, launch, run_process

LEFT_BY_A_FAILED_RUN = {
    "camera.yaml",
    "config.yaml",
    "edges.csv",
    "frames.csv",
    "inliers.npz",
    "rejected.npz",
    "log.txt",
    "report.html",
    "summary.json",
}


def images(recording, kind):
    return sorted((recording / kind).glob("*.png"))


def rewrite(path, change):
    cv2.imwrite(str(path), change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))


def truncate(path):
    path.write_bytes(path.read_bytes()[:2000])


def halve(path):
    rewrite(path, lambda image: image[::2, ::2])


def eight_bits(path):
    rewrite(path, lambda image: (image // 256).astype(np.uint8))


def one_line(done, status=1):
    """The message of a failed process, once it is known to be one line and the only output."""
    assert done.returncode == status, done.stderr
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("miniloop: ")
    return done.stderr.removeprefix("miniloop: ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("register", "nowhere"), "nowhere does not exist"),
        (("register", "empty"), "empty is empty"),
        (("register", "file"), "file is not a folder"),
        (("register", "letters"), "no supported layout"),
        (("register", "room", "--config", "papr"), "did you mean 'paper'?"),
        (("register", "room", "--config", "wrong.yaml"), "did you mean 'matching.ratio'?"),
        (("register", "room", "--set", "features.coutn=9"), "did you mean 'features.count'?"),
        (("register", "room", "--set", "features.count=-1"), "--set: setting 'features.count': must be greater"),
        (("register", "room", "--set", "features.count"), "key=value"),
        (("register", "room", "--layout", "tmu"), "did you mean 'tum'?"),
        (("register", "room", "--camera", "wrong_camera.yaml"), "did you mean 'fx'?"),
        (("register", "room", "--camera", "nowhere.yaml"), "nowhere.yaml does not exist"),
        (("register", "room", "-o", "file"), "file"),
        (("eval", "--gt", "room"), "run `miniloop register` first"),
        (("export", "empty", "--to", "tum"), "no trajectory.txt"),
        (("config", "explain", "treshold_m"), "did you mean 'ransac.threshold_m'?"),
    ],
)
def test_one_line_and_nothing_written(recording, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "letter.txt").write_text("dear reader")
    (tmp_path / "file").write_text("")
    (tmp_path / "wrong.yaml").write_text("matching: {ratoi: 0.7}\n")
    (tmp_path / "wrong_camera.yaml").write_text("fxx: 500\n")
    (tmp_path / "room").symlink_to(recording)
    before = {path.name for path in tmp_path.iterdir()}
    done = launch(*arguments)
    usage = done.returncode == 2 and words == "file"  # click itself refuses a file where a folder must be
    assert words in (done.stderr if usage else one_line(done))
    assert {path.name for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("regsiter", "room"), "Did you mean 'register'?"),
        (("register", "room", "--sed", "3"), "--seed"),
        (("register",), "Missing argument 'SEQ"),
        (("register", "room", "--features", "sfit"), "'rootsift', 'sift', 'orb'"),
        (("register", "room", "--seed", "-1"), "--seed"),
        (("register", "room", "--jobs", "0"), "0 jobs do nothing"),
        (("export", "--to", "clomap"), "colmap"),
        (("cache", "prune"), "--older-than DAYS or --all"),
    ],
)
def test_wrong_usage_is_status_two(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    done = launch(*arguments)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "damage", "words"),
    [
        ("rgb", truncate, "truncated"),
        ("depth", truncate, "truncated"),
        ("depth", halve, "depth is 160 x 120, colour 320 x 240"),
        ("depth", eight_bits, "8-bit"),
        ("rgb", lambda path: path.unlink(), "does not exist"),
    ],
)
def test_a_bad_frame_is_named_and_the_rest_registered(copied, tmp_path, kind, damage, words):
    damage(images(copied, kind)[3])
    outcome = invoke("register", copied, "-o", tmp_path / "out")
    assert outcome.exit_code == 0
    assert f"registered  {FRAMES - 1} of {FRAMES} frames" in outcome.output
    said = " ".join(outcome.output.split())
    assert "no pose for frame 3 " in said
    assert words in said
    assert words in (tmp_path / "out" / "frames.csv").read_text()
    assert words in (tmp_path / "out" / "log.txt").read_text()
    assert len((tmp_path / "out" / "trajectory.txt").read_text().splitlines()) == FRAMES  # a comment and the rest


def check_failed_run(folder, words):
    """A folder that says why nothing came of it, in the log and in the report, and holds nothing that seems more."""
    assert {path.name for path in folder.iterdir()} == LEFT_BY_A_FAILED_RUN
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["frames"], summary["registered"], summary["components"]) == (FRAMES, 0, 0)
    assert "It did not work" in (folder / "report.html").read_text()
    assert words in (folder / "log.txt").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "status"), [(("register", "nowhere"), 1), (("register",), 2), (("-V",), 0)])
def test_status_of_the_process(tmp_path, arguments, status):
    assert run_process(*arguments, cwd=tmp_path).returncode == status


def test_every_depth_image_of_eight_bits(copied, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in images(copied, "depth"):
        eight_bits(path)
    message = one_line(launch("register", copied, "-o", "out"))
    assert f"{FRAMES} of {FRAMES} frames cannot be read" in message
    assert "8-bit" in message
    check_failed_run(tmp_path / "out", "8-bit")


@pytest.mark.slow
def test_no_overlap_at_all(copied, tmp_path, registered):
    """Every image shows something else; an earlier result in the same folder must not survive."""
    rng = np.random.default_rng(0)
    for path in images(copied, "rgb"):
        blocks = rng.integers(0, 256, (60, 80, 3), dtype=np.uint8)
        cv2.imwrite(str(path), cv2.resize(blocks, (320, 240), interpolation=cv2.INTER_CUBIC))
    shutil.copytree(registered.folder, tmp_path / "out")
    message = one_line(run_process("register", copied, "-o", "out", cwd=tmp_path))
    assert "no scan was registered" in message
    assert "out/report.html" in message
    check_failed_run(tmp_path / "out", "no scan was registered")


@pytest.mark.slow
def test_ground_truth_that_is_not_a_number(copied, tmp_path, registered):
    truth = copied / "groundtruth.txt"
    lines = truth.read_text().splitlines()
    lines[5] = lines[5].replace(lines[5].split()[1], "nan")
    truth.write_text("\n".join(lines) + "\n")
    message = one_line(launch("eval", registered.folder, "--gt", copied))
    assert "groundtruth.txt:6: NaN" in message
    outcome = invoke("register", copied, "-o", tmp_path / "out", "-q")
    assert outcome.exit_code == 0  # poses do not need it


@pytest.mark.slow
def test_traceback_only_on_request(tmp_path):
    assert "Traceback" in run_process("register", "nowhere", "--debug", cwd=tmp_path).stderr


@pytest.mark.slow
def test_a_full_disk_and_a_closed_pipe(registered, recording, tmp_path):
    arguments = command("eval", registered.folder, "--gt", recording, "--json", "-")
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            arguments, stdout=full, stderr=subprocess.PIPE, text=True, env=environment(), check=False, cwd=tmp_path
        )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "No space left" in done.stderr
    line = f"{' '.join(arguments)} | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, env=environment(), check=True)
    assert done.stderr == ""
