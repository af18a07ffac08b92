"""The documentation: no dead links, commands and settings that exist, code that runs, pages up to date."""

import importlib.util
import re
import runpy

import click
import numpy as np
import pytest
from command_line import FRAMES, ROOT
from plugin_package import install
from scipy.spatial.transform import Rotation

from benchmarks.__main__ import benchmarks
from miniloop_cli.api import evaluate, register
from miniloop_cli.bench.problems import random_problems
from miniloop_cli.cli.config import allowed
from miniloop_cli.cli.main import cli
from miniloop_cli.config import Settings
from miniloop_cli.datasets import open_sequence, read_ground_truth, read_scan
from miniloop_cli.export.model import Model
from miniloop_cli.feature_types import FEATURE_TYPES
from miniloop_cli.presets import keys
from miniloop_cli.results.folder import Results

ROOTS = {"miniloop": cli, "python -m benchmarks": benchmarks}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES_BESIDE = [
    ROOT / name for name in ("BENCHMARK.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md")
]


def anchors(text):
    """Ids of the headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, *PAGES_BESIDE], ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        if target.startswith(("http:", "https:")):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        assert file.exists(), target
        if anchor:
            assert anchor in anchors(file.read_text(encoding="utf-8")), target


def test_every_page_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in (ROOT / "docs").rglob("*.md"):
        assert page.relative_to(ROOT / "docs").as_posix() in navigation, page


@pytest.mark.parametrize("page", [*PAGES, *PAGES_BESIDE], ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_and_their_options_exist(page):
    for program, line in re.findall(rf"({'|'.join(ROOTS)}) ([a-z][^`\n|>]*)", page.read_text(encoding="utf-8")):
        words, node = line.split("#")[0].split("&&")[0].split(), ROOTS[program]
        if program == "miniloop" and words[0] not in cli.lazy:
            continue  # prose: "miniloop takes ..."
        while isinstance(node, click.Group) and words and re.fullmatch("[a-z][a-z-]*", words[0]):
            node, words = node.get_command(click.Context(node), words[0]), words[1:]
            assert node is not None, line
        known = {option for parameter in node.params for option in parameter.opts} | {"--help", "--debug"}
        used = {re.match(r"-{1,2}[a-zA-Z-]+", word)[0] for word in words if re.match("-{1,2}[a-zA-Z]", word)}
        assert used <= known, line


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.name != "figures.md"], ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_settings_that_are_named_exist(page):
    sections = {key.partition(".")[0] for key in keys() if "." in key}
    text = page.read_text(encoding="utf-8")
    for key in re.findall(rf"(?:`|--set )((?:{'|'.join(sections)})\.[a-z_0-9]+)\b(?!\()", text):
        assert key in keys() or key.endswith((".py", ".csv", ".ply", ".txt")), key


def test_settings_page_is_up_to_date():
    made = runpy.run_path(str(ROOT / "docs" / "make_settings.py"))["page"]()
    assert (ROOT / "docs" / "settings.md").read_text(encoding="utf-8") == made, "run python docs/make_settings.py"


def text_of(name):
    """The block of developers.md that is marked so."""
    text = (ROOT / "docs" / "developers.md").read_text(encoding="utf-8")
    return re.search(rf"<!-- test: {name} -->\n```\w+\n(.*?)```", text, re.DOTALL)[1]


def block(name, folder):
    """The Python block of developers.md that is marked so, as a module saved in `folder`: numba asks for its file."""
    path = folder / f"developers_{name}.py"
    path.write_text(text_of(name), encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_layout_of_the_docs(recording, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(
        install(tmp_path / "site", text_of("layout package"), "robot_layout", text_of("layout"))
    )
    room = tmp_path / "room"
    room.mkdir()
    for old, new in (("rgb", "image"), ("depth", "range")):
        for k, path in enumerate(sorted((recording / old).glob("*.png"))):
            (room / f"{new}-{k:04d}.png").write_bytes(path.read_bytes())
    (room / "lens.txt").write_text("262.5 262.5 159.5 119.5 320 240\n")
    assert read_ground_truth(open_sequence(room)) is None
    (room / "truth.txt").write_text("0 1 2 3 0 0 0 1\n")
    sequence = open_sequence(room)
    assert read_ground_truth(sequence).T_world_cam[0, :3, 3].tolist() == [1, 2, 3]
    assert (sequence.layout, len(sequence.frames), sequence.camera.source) == ("robot", FRAMES, "lens.txt")
    same = read_scan(open_sequence(recording), 3)
    scan = read_scan(sequence, 3)
    assert np.array_equal(scan.color, same.color)
    np.testing.assert_allclose(scan.depth_m, 5 * same.depth_m, rtol=1e-6)  # 5000 units a metre, read as 1000


@pytest.mark.slow
def test_the_feature_of_the_docs(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(FEATURE_TYPES, "kaze", None)  # and gone again after the test
    block("feature", tmp_path)
    assert allowed(keys()["features.type"]).endswith(", brisk, kaze")
    assert Settings.model_json_schema()["$defs"]["Features"]["properties"]["type"]["enum"][-1] == "kaze"
    run = register(recording, tmp_path / "out", overrides=("features.type=kaze",), jobs=1, quiet=True)
    assert len(run.poses.registered) == FRAMES
    assert evaluate(tmp_path / "out", recording).numbers["ate_rmse_m"] < 0.01


@pytest.mark.slow
def test_the_solver_of_the_docs(tmp_path):
    solver = block("solver", tmp_path).svd3
    p, q, T = random_problems(np.random.default_rng(0), solver.matches, 200)
    found, counts = solver.solve_batch(p, q)
    assert (counts == 1).all()
    np.testing.assert_allclose(found[:, 0], T[:, :, :3], atol=1e-9)
    p[0] = q[0] = 0.5
    found, counts = solver.solve_batch(p, q)
    assert counts[0] == 0
    assert not found[0].any()


@pytest.mark.slow
def test_the_export_of_the_docs(registered, tmp_path):
    results = Results(registered.folder)
    (path,) = block("export", tmp_path).write_euroc(Model(results), tmp_path / "out")
    rows = np.loadtxt(path, delimiter=",")
    np.testing.assert_allclose(rows[:, 0] * 1e-9, results.trajectory.timestamps_s, atol=1e-6)
    np.testing.assert_allclose(rows[:, 1:4], results.trajectory.T_world_cam[:, :3, 3], atol=1e-8)
    turned = np.stack([Rotation.from_quat(np.roll(q, -1)).as_matrix() for q in rows[:, 4:]])
    np.testing.assert_allclose(turned, results.trajectory.T_world_cam[:, :3, :3], atol=1e-7)


def test_python_blocks_are_python():
    for page in PAGES:
        for code in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            lines = code if not code.startswith("    ") else "x = {\n" + code + "}\n"
            compile(lines, page.name, "exec")
