"""The report from disk and `miniloop view` in Firefox and in the engine of Safari, where they are installed."""

import threading

import numpy as np
import pytest
from other_browsers import FIREFOX, MINI_BROWSER, WEBKIT, XVFB, Firefox, WebKit

from miniloop_cli.report.page import write_report
from miniloop_cli.report.viewer.server import ViewServer
from miniloop_cli.report.viewer.shown import show_result
from miniloop_cli.results.columns import load
from miniloop_cli.runtime.artifact_store import Store

VIEW = "document.getElementById('viewer').view"
PIXELS = f"(() => {{ const {{ stage }} = {VIEW}; stage.draw(performance.now()); return stage.canvas.toDataURL(); }})()"
NO_FIREFOX = pytest.mark.skipif(not (FIREFOX and XVFB), reason="firefox-esr or xvfb is not installed")
NO_WEBKIT = pytest.mark.skipif(not (WEBKIT and MINI_BROWSER and XVFB), reason="webkit2gtk-driver is not installed")

pytestmark = pytest.mark.slow


@pytest.fixture(
    scope="module",
    params=[pytest.param(Firefox, marks=NO_FIREFOX), pytest.param(WebKit, marks=NO_WEBKIT)],
    ids=["firefox", "webkit"],
)
def browser(request):
    with request.param(1000, 800) as opened:
        yield opened


def looked_at(browser):
    """Turns, selects by click and key, and sees the images of an edge: what each browser must be able to do."""
    browser.run("document.getElementById('viewer').scrollIntoView()")
    browser.settle()
    left, top = browser.run(
        "(() => { const b = document.getElementById('v-canvas').getBoundingClientRect(); return [b.left, b.top]; })()"
    )
    before = browser.run(PIXELS)
    browser.drag((left + 30, top + 30), (left + 230, top + 60))
    browser.settle()
    assert browser.run(PIXELS) != before
    u, v, _ = browser.run(f"{VIEW}.stage.project({VIEW}.frames.position(3))")
    browser.click(left + u, top + v)
    browser.settle()
    chosen = browser.run(f"{VIEW}.selection.frame")
    assert chosen is not None
    browser.key(".")
    assert browser.run(f"{VIEW}.selection.frame") == chosen + 1
    browser.run("location.hash = '#edge=1-2'")
    browser.until("document.getElementById('v-details').innerText.startsWith('Edge 1–2')")
    browser.until("document.querySelector('#v-details figure canvas')?.width > 0")
    assert list(browser.problems) == []


def test_a_report_opens_from_disk(run, browser):
    path = write_report(load(run.results, run.sequence), Store(run.results.parent / "kept"))
    browser.open(path.as_uri())
    assert browser.run("document.getElementById('viewer').dataset.ready") == "true"
    assert np.isfinite(browser.run(f"{VIEW}.model.count"))
    looked_at(browser)


def test_a_result_is_served(run, browser):
    server = ViewServer(show_result(load(run.results, run.sequence)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        browser.open(server.address)
        assert browser.run("document.getElementById('viewer').dataset.ready") == "true"
        looked_at(browser)
    finally:
        server.shutdown()
        server.server_close()
