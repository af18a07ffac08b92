"""`miniloop register`: what it leaves behind, what it prints, that it can be stopped, repeated and run in parallel."""

import json
import shlex
import shutil
import signal
import subprocess
import time

import pytest
import yaml
from command_line import FRAMES, command, differing, environment, invoke, run_process

from miniloop_cli.runtime.atomic_files import HOST
from miniloop_cli.runtime.folder_lock import exclusive

FILES = {
    "camera.yaml",
    "cloud.ply",
    "config.yaml",
    "covariances.npz",
    "edges.csv",
    "frames.csv",
    "graph.g2o",
    "inliers.npz",
    "rejected.npz",
    "landmarks.npz",
    "map",
    "log.txt",
    "report.html",
    "summary.json",
    "trajectory.txt",
}


def test_every_file_of_the_contract_and_no_other(registered):
    assert {path.name for path in registered.folder.iterdir()} == FILES


def test_summary_leads_back_to_the_recording(registered, recording):
    summary = json.loads((registered.folder / "summary.json").read_text())
    assert summary["registered"] == summary["frames"] == FRAMES
    assert summary["recording"] == str(recording)
    assert summary["layout"] == "tum"
    assert {"features", "matching", "edges", "averaging", "refinement", "model"} <= set(summary["timings_s"])


def test_log_says_what_was_given_and_what_came_of_it(registered):
    log = (registered.folder / "log.txt").read_text()
    for words in ("camera: the sequence's own camera.yaml", "units a metre", "seed: 0", "min_matches: 12", "It worked"):
        assert words in log
    assert "It worked" in (registered.folder / "report.html").read_text()


def test_the_certificate_is_told_everywhere(registered):
    summary = json.loads((registered.folder / "summary.json").read_text())
    certificate = summary["certificate"]
    assert certificate["certified"] and 0 <= certificate["relative_gap"] <= 1e-4
    assert 0 < certificate["moved_by_refinement_m"] < 0.02 and not certificate["better_minimum_taken"]
    (sentence,) = [note["text"] for note in summary["notes"] if note["kind"] == "proven"]
    assert sentence.startswith("no other arrangement of these edges and weights is better")
    assert (
        sentence in registered.stderr.splitlines()
        and f"note: {sentence}" in (registered.folder / "log.txt").read_text()
    )
    assert sentence[1:] in (registered.folder / "report.html").read_text()


def test_table_fits_eighty_columns(registered):
    lines = registered.stdout.splitlines()
    assert lines[0] == f"registered  {FRAMES} of {FRAMES} frames"
    paths = ("results", "report")  # are not broken, so that they can be copied
    assert max(len(line) for line in lines if not line.startswith(paths) and "/" not in line) <= 80
    assert any(line.endswith("report.html") for line in lines)


def test_notes_go_to_stderr_as_they_come(registered):
    lines = registered.stderr.splitlines()
    assert lines[0].endswith(f"layout tum, {FRAMES} frames")
    assert lines[1] == "camera: the sequence's own camera.yaml"
    assert lines.index("features ...") < lines.index("matching ...") < lines.index("refinement ...")


def test_effective_settings_repeat_the_run(registered, recording, tmp_path):
    outcome = invoke("register", recording, "-o", tmp_path, "--config", registered.folder / "config.yaml", "-q")
    assert outcome.exit_code == 0
    assert outcome.output == ""
    assert differing(registered.folder, tmp_path) == []


def test_settings_on_the_command_line_win(recording, tmp_path):
    arguments = ("--config", "fast", "--features", "orb", "--set", "features.count=900", "--max-frames", 4)
    outcome = invoke("register", recording, "-o", tmp_path, *arguments, "--json", "-")
    assert json.loads(outcome.stdout)["frames"] == 4
    config = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert config["features"]["type"] == "orb"
    assert config["features"]["count"] == 900
    assert config["refine"] == "posegraph"


@pytest.mark.slow
@pytest.mark.parametrize(("jobs", "inner"), [(2, 1), (4, 3)])
def test_same_bytes_with_any_number_of_threads(registered, recording, tmp_path, jobs, inner):
    """Jobs, and threads of the matrix libraries; `registered` has one job and a thread a core inside."""
    arguments = ("register", recording, "-o", tmp_path / "out", "-j", jobs)
    variables = {"MINILOOP_CACHE": tmp_path / "cache", "OPENBLAS_NUM_THREADS": inner, "OMP_NUM_THREADS": inner}
    done = run_process(*arguments, cwd=tmp_path, **variables)
    assert done.returncode == 0, done.stderr
    assert differing(registered.folder, tmp_path / "out") == []


@pytest.mark.slow
def test_every_setting_acts(registered, recording, tmp_path):
    """A run that finds finished work gives what a fresh one gives, and not what other settings gave."""
    setting = ("--set", "averaging.rotation_scale_deg=0.2", "-q")
    assert invoke("register", recording, "-o", tmp_path / "kept", *setting).exit_code == 0
    assert invoke("register", recording, "-o", tmp_path / "fresh", *setting, "--fresh").exit_code == 0
    assert differing(tmp_path / "kept", tmp_path / "fresh") == []
    # The bundle leads back to nearly the same poses from wherever it starts: what averaging gave shows without it.
    averaged = ("register", recording, "--set", "refine=none", "-q")
    assert invoke(*averaged, "-o", tmp_path / "default").exit_code == 0
    assert invoke(*averaged, "-o", tmp_path / "other", *setting).exit_code == 0
    assert "trajectory.txt" in differing(tmp_path / "default", tmp_path / "other")


@pytest.mark.slow
def test_other_edges_are_refined_again(registered, recording, tmp_path):
    arguments = ("register", recording, "-o", tmp_path / "kept", "--set", "averaging.max_residual_m=0.002", "-q")
    assert invoke(*arguments).exit_code == 0
    assert "trajectory.txt" in differing(registered.folder, tmp_path / "kept")
    done = run_process(*arguments[:3], tmp_path / "fresh", *arguments[4:], cwd=tmp_path, MINILOOP_CACHE=tmp_path)
    assert done.returncode == 0, done.stderr
    assert differing(tmp_path / "kept", tmp_path / "fresh") == []


@pytest.mark.slow
def test_the_run_that_compiles_gives_the_same_bytes(registered, recording, tmp_path):
    """What is compiled in a process and what is loaded from disk are not the same copies of a function."""
    variables = {"MINILOOP_CACHE": tmp_path / "cache", "NUMBA_CACHE_DIR": tmp_path / "kernels"}
    done = run_process("register", recording, "-o", tmp_path / "out", "-j", 1, cwd=tmp_path, **variables)
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "kernels").rglob("*.nbc"))
    assert differing(registered.folder, tmp_path / "out") == []


@pytest.mark.slow
@pytest.mark.parametrize(("stage", "number"), [("features", signal.SIGKILL), ("matches", signal.SIGINT)])
def test_stopped_in_the_middle_the_same_command_continues(registered, recording, tmp_path, stage, number):
    cache, output = tmp_path / "cache", tmp_path / "out"
    arguments = ("register", recording, "-o", output, "-j", 1)
    process = subprocess.Popen(
        command(*arguments), cwd=tmp_path, env=environment(MINILOOP_CACHE=cache), stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 600
    while not list(cache.glob(f"{stage}/*.npz")) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.002)
    process.send_signal(number)
    _, stderr = process.communicate(timeout=600)
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert "the same command continues" in stderr
        assert not output.exists()
    else:
        assert process.returncode == -number
        assert [path for path in output.iterdir() if not path.name.startswith(".")] == []
    kept = {path: path.stat().st_ino for path in cache.glob("features/*.npz")}
    done = run_process(*arguments, cwd=tmp_path, MINILOOP_CACHE=cache)
    assert done.returncode == 0, done.stderr
    assert differing(registered.folder, output) == []
    assert {path.name for path in output.iterdir()} == FILES
    assert kept
    assert all(path.stat().st_ino == inode for path, inode in kept.items())


@pytest.mark.slow
def test_two_runs_on_one_folder(recording, tmp_path):
    with exclusive(tmp_path / "out"):
        done = run_process("register", recording, "-o", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 1
    assert "in use by another run" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_later_run_leaves_nothing_of_an_earlier_one(registered, recording, tmp_path):
    (tmp_path / f".trajectory.txt.miniloop-{HOST}-{2**31 - 1}.tmp").write_text("what a killed run left")
    (tmp_path / "trajectory.txt").write_text("old")
    outcome = invoke("register", recording, "-o", tmp_path, "--max-frames", 5, "-q")
    assert outcome.exit_code == 0
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert (tmp_path / "trajectory.txt").read_text() != "old"


def test_export_and_mesh_find_the_recording_and_the_camera(registered, tmp_path):
    outcome = invoke("export", registered.folder, "--to", "nerfstudio", "-o", tmp_path)
    assert outcome.exit_code == 0, outcome.output
    data = json.loads((tmp_path / "transforms.json").read_text())
    assert len(data["frames"]) == FRAMES
    assert data["fl_x"] == pytest.approx(262.5)


def test_a_recording_that_moved_is_asked_for(registered, tmp_path):
    moved = tmp_path / "results"
    moved.mkdir()
    for name in ("trajectory.txt", "frames.csv", "graph.g2o"):
        (moved / name).write_bytes((registered.folder / name).read_bytes())
    (moved / "summary.json").write_text(json.dumps({"recording": str(tmp_path / "gone"), "layout": "tum"}))
    assert invoke("export", moved, "--to", "tum").exit_code == 0
    outcome = invoke("export", moved, "--to", "colmap")
    assert "--sequence" in str(outcome.exception)


@pytest.mark.slow
def test_the_verdict_is_said_last_and_in_the_summary(recording, tmp_path):
    outcome = invoke("register", recording, "-o", tmp_path / "good")
    verdict = json.loads((tmp_path / "good" / "summary.json").read_text())["verdict"]
    assert (verdict["level"], verdict["reasons"]) == ("good", [])
    assert outcome.stdout.splitlines()[-1].split(maxsplit=1) == ["good", verdict["headline"]]
    strict = ("--strict", "--set", "features.count=40", "-q")
    outcome = invoke("register", recording, "-o", tmp_path / "bad", *strict)
    verdict = json.loads((tmp_path / "bad" / "summary.json").read_text())["verdict"]
    assert verdict["level"] != "good" and "frames are not registered" in verdict["reasons"][0]
    assert outcome.exit_code == 1 and f"the result is {verdict['level']}" in str(outcome.exception)


@pytest.mark.slow
def test_a_depth_scale_that_the_recording_contradicts_is_no_success(recording, tmp_path):
    """TUM's frames as a Kinect stores them, in a folder whose layout assumes millimetres."""
    for kind, folder in (("rgb", "color"), ("depth", "depth")):
        (tmp_path / "five" / folder).mkdir(parents=True)
        for k, path in enumerate(sorted((recording / kind).iterdir())):
            shutil.copy(path, tmp_path / "five" / folder / f"{k:05d}{path.suffix}")
    camera = yaml.safe_load((recording / "camera.yaml").read_text())
    K = [camera["fx"], 0, 0, 0, camera["fy"], 0, camera["cx"], camera["cy"], 1]
    size = {"width": camera["width"], "height": camera["height"]}
    (tmp_path / "five" / "camera_intrinsic.json").write_text(json.dumps(size | {"intrinsic_matrix": K}))
    invoke("register", tmp_path / "five", "-o", tmp_path / "out")
    verdict = json.loads((tmp_path / "out" / "summary.json").read_text())["verdict"]
    assert verdict["level"] == "doubtful"
    assert any("depth_scale 1000 units a metre is assumed" in why for why in verdict["reasons"])


@pytest.mark.slow
@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-"])
def test_closed_streams_are_no_error(recording, tmp_path, closed):
    words = " ".join(map(shlex.quote, map(str, command("register", recording, "-o", tmp_path / "out"))))
    environ = environment(MINILOOP_CACHE=tmp_path / "cache")
    done = subprocess.run(["sh", "-c", f"{words} {closed}"], cwd=tmp_path, env=environ, check=False)
    assert done.returncode == 0
    assert (tmp_path / "out" / "trajectory.txt").is_file()
