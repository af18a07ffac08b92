"""Damaged results folders: a MiniloopError in one line, or a page; never anything else."""

import json
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.evaluate import evaluate
from miniloop_cli.report import charts, sections
from miniloop_cli.report.templating import render
from miniloop_cli.report.viewer.scene import scene
from miniloop_cli.results.assessment import judge
from miniloop_cli.results.columns import load
from miniloop_cli.results.folder import Results
from miniloop_cli.results.g2o import read_g2o, write_g2o
from miniloop_cli.results.ply import read_ply

TEXTS = ["edges.csv", "frames.csv", "summary.json", "trajectory.txt", "graph.g2o"]
WORDS = [
    "nan",
    "-1",
    "1e400",
    "inf",
    "",
    "99999999999999999999",
    "1.5",
    "\n",
    ",",
    '"',
    "\x00",
    "é",
    "-",
    "null",
    "[",
    "{",
]
MANY = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def folder(run):
    graph = np.repeat(np.eye(4)[None], 2, 0)
    write_g2o(run.results / "graph.g2o", np.arange(2), graph, np.array([[0, 1]]), graph[:1], np.eye(6)[None])
    return run.results


def use(folder):
    """Everything that reads a results folder, short of the pictures."""
    results = Results(folder)
    data = load(folder)
    judge(data.columns)
    evaluation = evaluate(results.trajectory, results.trajectory, results.edge_stamps_s)
    for name, values in (
        ("trajectory", sections.trajectory(data, results.trajectory, evaluation)),
        ("overlap", sections.overlap(data)),
        ("edges", sections.edges(data)),
        ("frames", sections.frames(data)),
        ("run", sections.run(data)),
    ):
        if values is not None:
            render(f"{name}.html", **{name: values})
    charts.trajectory_charts(data, results.trajectory, None)
    json.dumps(scene(data, evaluation), allow_nan=False)
    read_g2o(folder / "graph.g2o")


@pytest.mark.slow
@MANY
@given(name=st.sampled_from(TEXTS), data=st.data())
def test_damaged_text(folder, tmp_path_factory, name, data):
    broken = tmp_path_factory.mktemp("broken")
    shutil.copytree(folder, broken, dirs_exist_ok=True)
    text = (folder / name).read_text()
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text)))
        cut = data.draw(st.integers(0, 12))
        text = text[:at] + data.draw(st.sampled_from(WORDS)) + text[at + cut :]
    (broken / name).write_text(text)
    try:
        use(broken)
    except MiniloopError as error:
        assert "\n" not in str(error)
    shutil.rmtree(broken)


@MANY
@given(name=st.sampled_from(["inliers.npz", "cloud.ply"]), data=st.data())
def test_damaged_binary(folder, tmp_path_factory, name, data):
    broken = tmp_path_factory.mktemp("broken")
    content = bytearray((folder / name).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, min(len(content), 400) - 1))] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.integers(0, len(content)))] if data.draw(st.booleans()) else content
    shutil.copytree(folder, broken, dirs_exist_ok=True)
    (broken / name).write_bytes(content)
    try:
        load(broken) if name == "inliers.npz" else read_ply(broken / name)
    except MiniloopError as error:
        assert "\n" not in str(error)
    shutil.rmtree(broken)
