"""The 3D view in a headless Chromium: it draws, turns, selects, measures and needs no mouse."""

import time

import numpy as np
import pytest
from browser import CHROMIUM, Browser

from miniloop_cli.report.page import write_report
from miniloop_cli.results.columns import load
from miniloop_cli.runtime.artifact_store import Store

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")]
VIEW = "document.getElementById('viewer').view"


def changed(before, after):
    """Share of the pixels that differ."""
    return (np.abs(before[..., :3].astype(int) - after[..., :3]) > 24).any(axis=-1).mean()


@pytest.fixture(scope="module")
def browser():
    with Browser(800, 600) as opened:
        yield opened


@pytest.fixture
def shown(run, browser):
    """The page of a run, open in the browser; some matches are kept of its rejected edges."""
    lost = [k for k, edge in enumerate(run.edges) if edge["verdict"] == "rejected"]
    kept = {"offsets": 3 * np.arange(len(lost) + 1), "px": np.full((3 * len(lost), 4), 50, np.uint16)}
    np.savez(run.results / "rejected.npz", edges=lost, agrees=np.tile([True, True, False], len(lost)), **kept)
    path = write_report(load(run.results, run.sequence), Store(run.results.parent / "kept"))
    browser.problems.clear()
    browser.open(path.as_uri())
    browser.run("document.getElementById('viewer').scrollIntoView()")
    browser.settle()
    yield browser
    assert browser.problems == []
    assert browser.run("document.title").startswith("a room <b>bold")  # no foreign script has changed it


def canvas(browser):
    box = browser.run("(() => { const b = document.getElementById('v-canvas').getBoundingClientRect();"
                      "return [b.left, b.top, b.width, b.height]; })()")  # fmt: skip
    return np.array(box)


def text(browser, name):
    return browser.run(f"document.getElementById('v-{name}').innerText")


def test_it_turns_and_selects_by_mouse(run, shown):
    first = shown.pixels()
    background = first[0, 0, :3].astype(int)
    drawn = (np.abs(first[..., :3].astype(int) - background) > 24).any(axis=-1)
    assert 0.005 < drawn.mean() < 0.9
    left, top, *_ = canvas(shown)
    shown.drag((left + 30, top + 30), (left + 230, top + 60))
    shown.settle()
    assert changed(first, shown.pixels()) > 0.005
    # A click on the pixel of a camera selects its frame; the link says so, and leads back to it.
    u, v, _ = shown.run(f"{VIEW}.stage.project({VIEW}.frames.position(3))")
    shown.click(left + u, top + v)
    shown.settle()
    chosen = shown.run(f"{VIEW}.selection.frame")
    assert chosen is not None
    assert text(shown, "details").startswith(f"Frame {chosen}")
    assert shown.run("location.hash") == f"#frame={chosen}"
    # The middle of an edge that is shown selects the edge.
    shown.run("(() => { const e = document.getElementById('v-edge-mode'); e.value = 'all';"
              "e.dispatchEvent(new Event('change')); })()")  # fmt: skip
    edge = shown.run(
        f"(() => {{ const v = {VIEW}; return v.edges.shown.find(e => {{ const [a, b] = v.edges.ends(e)"
        ".map(p => v.stage.project(p)); return Math.hypot(a[0] - b[0], a[1] - b[1]) > 80; }); })()"
    )
    ends = shown.run(f"{VIEW}.edges.ends({edge}).map(p => {VIEW}.stage.project(p))")
    shown.click(left + (ends[0][0] + ends[1][0]) / 2, top + (ends[0][1] + ends[1][1]) / 2)
    picked = shown.run(f"{VIEW}.selection.edge")
    assert picked is not None
    i, j = shown.run(f"[{VIEW}.edges.columns.i[{picked}], {VIEW}.edges.columns.j[{picked}]]")
    assert text(shown, "details").startswith(f"Edge {i}–{j}")
    shown.until("document.querySelector('#v-details figure canvas') !== null")
    assert "3 matches that agree" in text(shown, "details")


def test_a_keyboard_is_enough(run, shown):
    shown.run("document.getElementById('v-canvas').focus()")
    seen = [shown.pixels()]
    for key in ("ArrowLeft", "+", "t", "f", "g", "w", "Home"):
        shown.key(key)
        shown.settle()
        seen.append(shown.pixels())
        for _ in range(20):  # a busy machine draws late
            if changed(seen[-2], seen[-1]) > 0.002:
                break
            time.sleep(0.25)
            seen[-1] = shown.pixels()
        assert changed(seen[-2], seen[-1]) > 0.002, key
    assert changed(seen[0], seen[-1]) < 0.002  # Home leads back
    shown.key(".")
    shown.key(".")
    assert shown.run(f"{VIEW}.selection.frame") == 1
    assert "Frame 1 selected" in text(shown, "said")
    shown.key("Escape")
    assert shown.run(f"{VIEW}.selection.frame") is None
    shown.key("m")
    assert "Measuring" in text(shown, "said")

    points = np.array(shown.run(f"(() => {{ const p = []; {VIEW}.model.forEach((...q) => p.push(q)); return p; }})()"))
    for row, said in ((100, "First point set"), (900, "Distance")):
        # The cross is put on a point of the model.
        x, y, z = shown.run(f"[...{VIEW}.stage.toScene({points[row].tolist()})]")
        shown.run(f"{VIEW}.navigation.place = [{x}, {y} + 0.3, {z}, {x}, {y}, {z}]")
        shown.settle()
        shown.key("Enter")
        assert said in text(shown, "said")
    measured = np.array(shown.run(f"{VIEW}.ruler.points"))
    np.testing.assert_allclose(measured, points[[100, 900]], atol=0.02)
    assert f"Distance {np.linalg.norm(measured[0] - measured[1]):.2f} m" in text(shown, "said")


def test_a_link_leads_to_a_frame_and_names_stay_names(run, shown):
    shown.run("location.hash = '#frame=5'")
    shown.until(f"{VIEW}.selection.frame === 5")
    assert 'no match "><script>' in text(shown, "details")  # why it has no pose, as text
    shown.run("location.hash = '#edge=3-5'")
    shown.until(f"{VIEW}.selection.edge !== null")
    # A rejected edge: why, and what was matched.
    shown.until("document.querySelector('#v-details figure canvas') !== null")
    assert "2 of 15 matches that agree, in colours; 1 of 18 that do not, in red, dashed" in text(shown, "details")
    assert "verdict\nrejected" in text(shown, "details")
    assert '"><script>document.title' in text(shown, "details")
    for hostile in ("#frame=999", "#frame=-1", "#edge=1-1", "#edge=<script>", "#eye=1,2,NaN,4,5,6", "#%"):
        shown.run(f"location.hash = '{hostile}'")
        shown.settle()


def test_what_is_drawn_follows_its_controls(run, shown):
    def change(name, value):
        shown.run(f"(() => {{ const e = document.getElementById('v-{name}'); e.value = '{value}';"
                  "e.dispatchEvent(new Event('change')); e.dispatchEvent(new Event('input')); })()")  # fmt: skip
        shown.settle()
        return shown.pixels()

    whole = shown.pixels()
    shown.run("document.getElementById('v-slab').click()")
    assert changed(whole, change("slab-to", 30)) > 0.01
    shown.run("document.querySelector('#v-layers input').click()")  # without the model, which hides the cameras
    plain = change("edge-mode", "none")
    assert changed(whole, plain) > 0.01
    assert changed(plain, change("path-color", "speed")) > 1e-3
    assert "speed 0" in text(shown, "legend") and "m/s" in text(shown, "legend")
    verified = change("edge-mode", "verified")
    assert changed(plain, verified) > 1e-3
    assert changed(verified, change("edge-color", "solver")) > 1e-4
    assert "5-cycle" in text(shown, "legend")


def test_runs_without_poses_and_phones(run, browser, tmp_path):
    for name in ("trajectory.txt", "cloud.ply"):
        (run.results / name).unlink()
    frames = run.results / "frames.csv"
    frames.write_text(frames.read_text().replace(",1,0,registered,", ",0,-1,few_features,no depth"))
    path = write_report(load(run.results, run.sequence), Store(tmp_path / "kept"))
    browser.problems.clear()
    browser.call("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=2, mobile=True)
    try:
        browser.open(path.as_uri())
        assert "No frame has a pose" in text(browser, "said")
        browser.run("document.getElementById('v-next').click()")
        assert "no depth" in text(browser, "details")
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")  # nothing sticks out to the right
    finally:
        browser.call("Emulation.clearDeviceMetricsOverride")
    assert browser.problems == []
