"""A recording of 10,000 frames in the 3D view: it opens, steps and turns, and what it holds does not grow."""

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from long_result import write_long_result

from miniloop_cli.report.page import write_report
from miniloop_cli.report.viewer.shown import show_result
from miniloop_cli.results.columns import load
from miniloop_cli.runtime.artifact_store import Store

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")]
VIEW = "document.getElementById('viewer').view"
FRAMES = 10_000


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    return write_long_result(tmp_path_factory.mktemp("long") / "result", FRAMES, 150_000)


def held(browser):
    """(bytes of the script, elements, geometries, textures) once what can be freed is freed."""
    browser.settle()
    browser.call("HeapProfiler.collectGarbage")
    metrics = {one["name"]: one["value"] for one in browser.call("Performance.getMetrics")["metrics"]}
    memory = f"{VIEW}.stage.renderer.info.memory"
    drawn = browser.run(f"[{memory}.geometries, {memory}.textures]")
    elements = browser.run("document.getElementsByTagName('*').length")
    return np.array([metrics["JSHeapUsedSize"], elements, *drawn])


def test_ten_thousand_frames_in_a_report(long, tmp_path):
    path = write_report(load(long), Store(tmp_path))
    assert path.stat().st_size < 20e6
    with Browser(1000, 800) as browser:
        browser.open(path.as_uri())
        assert browser.run("document.getElementsByTagName('*').length") < 40_000
        browser.call("Performance.enable")

        def a_look_around(seed):
            """Turns, selects frames all over the recording, opens edges with their images, changes what is shown."""
            browser.run(
                f"(async () => {{ const v = {VIEW}, pause = ms => new Promise(done => setTimeout(done, ms));"
                "const change = (name, value) => { const e = document.getElementById(`v-${name}`); e.value = value;"
                "e.dispatchEvent(new Event('change')); };"
                f"for (let k = 0; k < 40; k++) {{ v.navigation.around(0.3, 0); v.pace.moved();"
                f"v.selection.set(({seed} * 997 + k * 251) % {FRAMES}, null); await pause(5); }}"
                f"for (let k = 0; k < 40; k++) {{ v.selection.set(null, ({seed} * 31 + k * 241) % v.edges.all.length);"
                "await pause(5); }"
                "for (const mode of ['verified', 'all', 'none', 'selected'])"
                "{ change('edge-mode', mode); await pause(5); }"
                "for (const by of ['speed', 'sigma_m', '']) { change('path-color', by); await pause(5); }"
                "v.selection.set(null, null); v.navigation.overview(); })()"
            )

        a_look_around(0)
        first = held(browser)
        for seed in (1, 2, 3):
            a_look_around(seed)
        last = held(browser)
        assert (last[1:] <= first[1:]).all(), (first, last)
        assert last[0] < first[0] + 2e6
        assert browser.problems == []


def test_the_server_has_an_image_of_every_frame(long):
    shown = show_result(load(long))
    assert shown.values["images"]
    for k in (0, 1, 7777, FRAMES - 1):
        kind, image = shown.answer(f"frame/{k}.jpg")
        assert kind == "image/jpeg" and image[:2] == b"\xff\xd8"
