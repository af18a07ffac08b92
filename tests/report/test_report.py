"""The page: what it says, that it needs nothing from outside, and that nothing from outside gets to run in it."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files

import cv2
import numpy as np
import pytest
from jinja2 import UndefinedError

from miniloop_cli.errors import InputError
from miniloop_cli.evaluation.evaluate import evaluate
from miniloop_cli.report.charts import KINDS
from miniloop_cli.report.page import write_report
from miniloop_cli.report.sections import edge_rows
from miniloop_cli.report.templating import render
from miniloop_cli.results.assessment import Level, judge
from miniloop_cli.results.columns import load
from miniloop_cli.results.facts import runs
from miniloop_cli.results.ply import read_ply, write_ply
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.scene.sequence import Trajectory

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class Finished(Store):
    """A store where everything has been made already."""

    def cached(self, artifact, inputs, make):
        return super().cached(artifact, inputs, make=None)


def written(results, sequence=None, store=Store):
    """The report of a results folder, with pictures that are kept beside the folder."""
    return write_report(load(results, sequence), store(results.parent / "kept"))


class Page(HTMLParser):
    """Elements with their attributes, and the visible text."""

    def __init__(self, html):
        super().__init__()
        self.elements, self.text, self.open = [], "", []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self.open.append(tag)

    def handle_endtag(self, tag):
        if tag in self.open:
            while self.open.pop() != tag:
                pass

    def handle_data(self, data):
        if not {"script", "style"} & set(self.open):
            self.text += data

    def count(self, tag):
        return sum(name == tag for name, _ in self.elements)


@pytest.mark.slow
def test_pictures_are_kept(run):
    first = written(run.results, run.sequence).read_bytes()
    assert written(run.results, run.sequence, Finished).read_bytes() == first
    points, colors = read_ply(run.results / "cloud.ply")
    write_ply(run.results / "cloud.ply", points, 255 - colors)
    changed = written(run.results, run.sequence).read_bytes()
    write_ply(run.results / "cloud.ply", points, colors)
    assert changed != first
    assert written(run.results, run.sequence).read_bytes() == first


def test_edges_of_frames_that_the_recording_does_not_have_are_shown_without_pictures(run):
    fewer = replace(run.sequence, frames=run.sequence.frames[:3])
    assert Page(written(run.results, fewer).read_text()).count("img") < 12


def test_everything_is_on_the_page(run):
    path = written(run.results, run.sequence)
    assert path == run.results / "report.html"
    page = Page(path.read_text())
    assert "7 of 8 frames are registered" in page.text
    titles = ["Trajectory", "Model", "Overlap", "Edges", "Worst edges", "Frames", "Run", "Timings", "Camera"]
    for title in titles:
        assert title in page.text
    assert "Against the ground truth: position error 0.00 cm RMSE" in page.text
    assert "took a camera" in page.text
    assert page.count("img") == 2 + 9 + 1  # the model twice, every verified edge, the frame without a pose
    assert page.count("svg") == 2 + 2 + 1 + 3
    assert path.stat().st_size < 5e6


def test_nothing_comes_from_outside_and_nothing_foreign_runs(run):
    page = Page(written(run.results, run.sequence).read_text())
    assert page.count("script") == 2 + 4 + 1  # the rows of the edge table, the page's own, the 3D view's data and own
    assert "b" not in {tag for tag, _ in page.elements}
    assert '<script>document.title="owned"</script>' in page.text  # shown, not run
    for tag, attributes in page.elements:
        assert not any(name.startswith("on") for name in attributes), tag
        for name in ("src", "href"):
            assert attributes.get(name, "data:image/").startswith("data:image/")
    html = written(run.results).read_text().replace("http://www.w3.org/1999/xhtml", "")  # a name, not an address
    assert not re.search(r"url\(|@import|https?://", html)


def test_names_stay_names(run):
    """Markup, what closes an attribute, an entity, a template's own braces and bytes that are no text."""
    name = "<script>alert(1)</script>'\"><img src=x onerror=alert(1)> &lt; {{ 7 * 7 }} \udcff"
    camera = replace(run.sequence.camera, source=name)
    sequence = replace(run.sequence, name=name, camera=camera, notes=(name,))
    (run.results / "summary.json").write_text(json.dumps({"recording": name}))
    plain = Page(written(run.results, replace(run.sequence, notes=("a note",))).read_text())
    page = Page(written(run.results, sequence).read_text(encoding="utf-8"))
    assert [(tag, list(attributes)) for tag, attributes in page.elements] == [
        (tag, list(attributes)) for tag, attributes in plain.elements
    ]
    # In title and heading, and as the camera's source, a note and a value of summary.json.
    assert page.text.count(name.encode("utf-8", "backslashreplace").decode()) == 5


def test_the_rows_of_the_edge_table_are_data(run):
    html = written(run.results).read_text()
    payload = re.search(r'<script type="application/json" id="edge-rows">(.*?)</script>', html, re.DOTALL)[1]
    assert json.loads(payload) == edge_rows(load(run.results).edges)
    assert any('"><script>' in str(row) for row in json.loads(payload))
    assert not set("<>&'") & set(payload)


def test_a_template_shows_only_what_it_is_given():
    with pytest.raises(UndefinedError, match="worst_edges"):
        render("worst_edges.html")


def test_only_files_of_the_package_are_not_escaped():
    templates = [path.read_text(encoding="utf-8") for path in (files("miniloop_cli.report") / "templates").iterdir()]
    exempt = re.findall(r"\w+ *\| *safe|autoescape|Markup", "".join(templates))
    assert sorted(set(exempt)) == ["script|safe", "style|safe", "viewer|safe"]


@pytest.mark.slow
def test_templates_are_loaded_when_a_report_is_written():
    code = "import sys, miniloop_cli.api, miniloop_cli.report; sys.exit('jinja2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_same_run_gives_the_same_bytes(run):
    first = written(run.results, run.sequence).read_bytes()
    assert written(run.results, run.sequence).read_bytes() == first


def test_a_run_without_any_pose_still_says_why(run):
    for name in ("trajectory.txt", "cloud.ply", "inliers.npz", "summary.json", "config.yaml", "log.txt"):
        (run.results / name).unlink()
    header = (run.results / "edges.csv").read_text().splitlines()[0]
    (run.results / "edges.csv").write_text(header + "\n")
    frames = (
        (run.results / "frames.csv")
        .read_text()
        .replace(",1,0,registered,", ",0,-1,few_features,no depth")
        .replace(",500,", ",20,")
    )
    (run.results / "frames.csv").write_text(frames)
    page = Page(written(run.results, run.sequence).read_text())
    assert "It did not work: 0 of 8 frames are registered." in page.text
    assert "7 frames without a pose (0–4, 6–7): no depth" in page.text
    assert "The frames have few features (median 20)" in page.text
    assert "No two frames share enough matches" in page.text


def test_only_a_trajectory_is_enough(run):
    for path in run.results.iterdir():
        if path.name != "trajectory.txt":
            path.unlink()
    page = Page(written(run.results).read_text())
    assert "7 of 7 frames" in page.text


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("edges.csv", b"i,j,timestamp_i,timestamp_j\n0,1.5,1,2\n"),
        ("edges.csv", b"i,j,timestamp_i,timestamp_j\n-1,1,1,2\n"),
        ("edges.csv", b"i,j,timestamp_i,timestamp_j,matches\n0,1,1,2,many\n"),
        ("frames.csv", b"index,timestamp\n0\n"),
        ("frames.csv", b"index,timestamp\n0,\xff\n"),
        ("inliers.npz", b"no archive"),
        ("inliers.npz", b""),
        ("summary.json", b"{"),
        ("trajectory.txt", b"1 2 3\n"),
    ],
)
def test_malformed_files_are_named(run, name, content):
    (run.results / name).write_bytes(content)
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        written(run.results, run.sequence)
    assert not (run.results / "report.html").exists()


def test_inliers_of_another_run_are_refused(run):
    np.savez(run.results / "inliers.npz", offsets=np.array([0, 1]), px_i=np.zeros((1, 2)), px_j=np.zeros((1, 2)))
    with pytest.raises(InputError, match="do not fit"):
        written(run.results)


def test_objects_in_inliers_are_never_unpickled(run):
    np.savez(run.results / "inliers.npz", offsets=np.array([{}], object), px_i=np.zeros(1), px_j=np.zeros(1))
    with pytest.raises(InputError, match=r"inliers\.npz"):
        written(run.results)


def test_a_broken_image_leaves_out_its_pictures_only(run):
    for frame in run.sequence.frames[:3]:
        frame.color.path.write_bytes(b"")
    page = Page(written(run.results, run.sequence).read_text())
    assert 3 < page.count("img") < 12


def test_verdicts(run):
    assert judge(load(run.results).columns).level == Level.DOUBTFUL
    text = (run.results / "frames.csv").read_text()
    (run.results / "frames.csv").write_text(text.replace(",0,-1,", ",1,0,"))
    assert judge(load(run.results).columns).level == Level.GOOD
    (run.results / "frames.csv").write_text(text.replace(",1,0,", ",0,-1,"))
    assert judge(load(run.results).columns).level == Level.BAD
    (run.results / "frames.csv").write_text(text.replace(",0,-1,", ",1,0,"))
    edges = (run.results / "edges.csv").read_text().replace("verified,,,0.", "verified,,,9.")
    (run.results / "edges.csv").write_text(edges)
    verdict = judge(load(run.results).columns)
    assert verdict.level == Level.DOUBTFUL
    assert "the edges disagree with the poses as a whole" in verdict.headline
    assert any("depth_scale" in advice for advice in verdict.advice)


def test_poses_far_from_the_ground_truth_did_not_simply_work(run):
    frames = run.results / "frames.csv"
    frames.write_text(frames.read_text().replace(",0,-1,", ",1,0,"))
    data, poses = load(run.results), load(run.results).results.trajectory
    assert judge(data.columns, evaluate(poses, poses)).level == Level.GOOD
    T = poses.T_world_cam.copy()
    T[:, :3, 3] *= 1.2  # as a wrong depth scale makes them, which nothing else shows
    verdict = judge(data.columns, evaluate(Trajectory(poses.timestamps_s, T), poses))
    assert verdict.level == Level.DOUBTFUL
    assert verdict.headline.startswith("It worked, but the ground truth contradicts the poses")


def test_what_inspection_finds_stands_in_the_report_of_a_run_that_went_badly(run):
    for frame in run.sequence.frames[:3]:
        frame.depth.path.write_bytes(b"")
    page = Page(written(run.results, run.sequence).read_text())
    assert "What looks wrong with the recording" in page.text
    assert "3 of 8 frames cannot be used" in page.text and "copy or convert them again" in page.text
    assert "What looks wrong" not in Page(written(run.results).read_text()).text


def test_solvers_have_colours_of_their_own():
    assert len({KINDS[name] for name in ("cycle5", "cycle4", "cycle3", "pairwise", "guided")}) == 5


def test_a_verified_edge_that_contradicts_the_poses_makes_a_run_doubtful(run):
    frames = (run.results / "frames.csv").read_text().replace(",0,-1,no_matches,", ",1,0,registered,")
    (run.results / "frames.csv").write_text(frames)
    assert judge(load(run.results).columns).level == Level.GOOD
    edges = (run.results / "edges.csv").read_text().replace("verified,,,0.1,", "verified,,,73.0,", 1)
    (run.results / "edges.csv").write_text(edges)
    found = judge(load(run.results).columns)
    assert found.level == Level.DOUBTFUL
    assert found.reasons[0].startswith("1 verified edge contradicts the poses (the worst: 0–")
    assert "by 73.0 deg" in found.reasons[0] and found.reasons[0] in found.headline


def test_frames_with_the_same_trouble_belong_together(run):
    text = (run.results / "frames.csv").read_text().splitlines()
    reasons = ("its only overlap was not verified (5 inliers)", "none of 3 overlaps was verified (best: 4 inliers)")
    lost = ",0,-1,not_verified,"
    text[1:3] = [line.replace(",1,0,registered,", lost) + why for line, why in zip(text[1:3], reasons, strict=True)]
    (run.results / "frames.csv").write_text("\n".join(text) + "\n")
    assert "2 frames without a pose (0–1): no edge was verified." in judge(load(run.results).columns).facts


def test_an_assumption_that_the_recording_contradicts_is_a_doubt(run):
    summary = json.loads((run.results / "summary.json").read_text())
    doubt = {"kind": "contradicted", "text": "depth_scale 1000 is assumed, its steps say 5000"}
    summary["notes"] = [doubt, {"kind": "assumed", "text": "a camera"}, 7, {"kind": ["contradicted"], "text": "no"}]
    (run.results / "summary.json").write_text(json.dumps(summary))
    verdict = judge(load(run.results).columns)
    assert verdict.level == Level.DOUBTFUL
    assert "but the recording contradicts what was assumed about it" in verdict.headline
    assert verdict.reasons[-1] == "depth_scale 1000 is assumed, its steps say 5000"


def test_a_recording_of_which_most_images_are_dropped_is_a_doubt(run):
    summary = json.loads((run.results / "summary.json").read_text())
    summary["notes"] = [{"kind": "most dropped", "text": "8 pairs from 90 colour and 90 depth images"}]
    (run.results / "summary.json").write_text(json.dumps(summary))
    verdict = judge(load(run.results).columns)
    assert verdict.level == Level.DOUBTFUL
    assert verdict.reasons[-2:] == (
        "most images of the recording are not used",
        "8 pairs from 90 colour and 90 depth images",
    )


@pytest.mark.parametrize("kind", ["unproven", "impossible motion", "ambiguous"])
def test_what_may_be_otherwise_is_a_doubt_and_a_fact(run, kind):
    summary = json.loads((run.results / "summary.json").read_text())
    summary["notes"] = [{"kind": kind, "text": "between frames 3 and 4 something is odd"}]
    (run.results / "summary.json").write_text(json.dumps(summary))
    verdict = judge(load(run.results).columns)
    assert verdict.level == Level.DOUBTFUL and verdict.reasons[-1] == "between frames 3 and 4 something is odd"
    assert "Between frames 3 and 4 something is odd." in verdict.facts
    summary["notes"] = [{"kind": "proven", "text": "no other arrangement is better"}]
    (run.results / "summary.json").write_text(json.dumps(summary))
    assert verdict.reasons[-1] not in judge(load(run.results).columns).reasons


def test_what_became_of_gravity_is_told(run):
    summary = json.loads((run.results / "summary.json").read_text())
    summary["notes"] = [
        {"kind": "assumed", "text": "took a camera"},
        {"kind": "prior", "text": "gravity is not used: it is far off"},
        {"kind": "prior", "text": 7},
    ]
    (run.results / "summary.json").write_text(json.dumps(summary))
    facts = judge(load(run.results).columns).facts
    assert "Gravity is not used: it is far off." in facts
    assert not any("took a camera" in fact for fact in facts)


@pytest.mark.parametrize(("rejection", "advice"), [("looks_different", "Masks"), ("few_inliers", "overlap more")])
def test_advice_follows_the_reasons_of_rejected_pairs(run, rejection, advice):
    rows = (run.results / "edges.csv").read_text().replace(",verified,,,", f",rejected,{rejection},,")
    (run.results / "edges.csv").write_text(rows)
    frames = (run.results / "frames.csv").read_text().replace(",1,0,", ",0,-1,")
    (run.results / "frames.csv").write_text(frames)
    assert any(advice in text for text in judge(load(run.results).columns).advice)


def test_separate_pieces_are_told(run):
    text = (run.results / "frames.csv").read_text().splitlines()
    text[-2:] = [line.replace(",1,0,", ",0,1,") for line in text[-2:]]
    (run.results / "frames.csv").write_text("\n".join(text) + "\n")
    verdict = judge(load(run.results).columns)
    assert "5 of 8 frames are registered; 2 more form 1 separate piece." in verdict.headline
    assert any("No verified edge joins the pieces" in advice for advice in verdict.advice)


def test_runs():
    assert runs(np.array([0, 2, 3, 4, 9])) == "0, 2–4, 9"
    assert runs(np.array([0, 2, 4, 6]), most=2) == "0, 2 and 2 more runs"


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_in_a_browser(run, tmp_path):
    path = written(run.results, run.sequence)
    # A copy that sorts by inliers as a reader would, and then shows one frame's edges.
    clicks = "document.querySelectorAll('th button')[5].click();"
    clicks += "const only=document.getElementById('only');only.value='3';only.dispatchEvent(new Event('input'));"
    clicked = tmp_path / "clicked.html"
    clicked.write_text(path.read_text().replace("</body>", f"<script>{clicks}</script></body>"))
    home = f"--user-data-dir={tmp_path / 'profile'}"
    alone = ["--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"]
    browser = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", *alone, home, "--window-size=500,2400"]
    done = subprocess.run(
        [*browser, "--enable-logging=stderr", "--dump-dom", clicked.as_uri()],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    rows = re.search(r'id="edge-table".*?<tbody>(.*?)</tbody>', done.stdout, re.DOTALL).group(1)
    cells = [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", rows)]
    expected = sorted((e["inliers"] for e in run.edges if 3 in (e["i"], e["j"])), reverse=True)
    assert [int(row[5]) for row in cells] == expected
    assert "<title>a room &lt;b&gt;" in done.stdout  # no foreign script has changed it
    assert "Content Security Policy" not in done.stderr
    assert "Uncaught" not in done.stderr
    picture = tmp_path / "page.png"
    command = [*browser, "--hide-scrollbars", f"--screenshot={picture}", path.as_uri()]
    subprocess.run(command, capture_output=True, check=True, timeout=120)
    seen = cv2.imread(str(picture))
    assert seen.shape == (2400, 500, 3)
    assert (seen.reshape(-1, 3) == (11, 142, 224)).all(axis=1).any()  # the verdict's amber bar
    assert (seen[:, -3:] >= 240).all()  # nothing sticks out to the right of a phone's screen
