"""Firefox through WebDriver BiDi, and the engine of Safari (WebKitGTK) through WebDriver, both drawing in software.

No package drives them that is not installed with the others of the tests: BiDi is JSON over a WebSocket, WebDriver JSON
over HTTP.
"""

import asyncio
import base64
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
WEBKIT = shutil.which("WebKitWebDriver")
MINI_BROWSER = next(map(str, Path("/usr/lib").glob("*/webkit2gtk-4.*/MiniBrowser")), None)
XVFB = shutil.which("Xvfb")
PATIENCE_S = 120
PREFERENCES = {
    "webgl.force-enabled": True,
    "datareporting.policy.dataSubmissionEnabled": False,
    "app.update.enabled": False,
    "browser.shell.checkDefaultBrowser": False,
    "browser.startup.page": 0,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
}


class _Page:
    """What tests do with a page, in terms of `run`, which each browser has."""

    def until(self, script):
        give_up = time.monotonic() + PATIENCE_S
        while not self.run(script):
            if time.monotonic() > give_up:
                raise TimeoutError(script)
            time.sleep(0.1)

    def open(self, address):
        self.navigate(address)
        self.until("document.readyState === 'complete' && document.getElementById('viewer')?.dataset.ready")

    def settle(self):
        self.run("new Promise(done => setTimeout(done, 350))")
        self.until("(({ stage, pace }) => !pace.moving && !stage.pending)(document.getElementById('viewer').view)")

    def click(self, x, y):
        self.actions([self.move(x, y), {"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}])

    def drag(self, start, end, steps=6):
        moves = [
            self.move(*(a + (b - a) * k / steps for a, b in zip(start, end, strict=True))) for k in range(steps + 1)
        ]
        self.actions([moves[0], {"type": "pointerDown", "button": 0}, *moves[1:], {"type": "pointerUp", "button": 0}])

    def key(self, key):
        self.act(
            [{"type": "key", "id": "keys", "actions": [{"type": kind, "value": key} for kind in ("keyDown", "keyUp")]}]
        )

    def move(self, x, y):
        return {"type": "pointerMove", "x": round(x), "y": round(y), "duration": 20}

    def actions(self, actions):
        self.act([{"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": actions}])

    def screenshot(self, path):
        Path(path).write_bytes(base64.b64decode(self.picture()))
        return path

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


class Screen:
    """A screen in memory."""

    def __init__(self, width, height):
        read, write = os.pipe()
        size = f"{width + 100}x{height + 200}x24"
        command = [XVFB, "-displayfd", str(write), "-screen", "0", size]
        self.process = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL, start_new_session=True)
        os.close(write)
        with os.fdopen(read) as file:
            self.display = f":{file.readline().strip()}"

    def environment(self, home):
        own = {"DISPLAY": self.display, "HOME": home, "XDG_RUNTIME_DIR": home, "LIBGL_ALWAYS_SOFTWARE": "1"}
        return os.environ | own

    def close(self):
        end(self.process)


def end(process):
    """End a program and what it started."""
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


class Firefox(_Page):
    """One page of Firefox on a screen in memory: headless it has no WebGL.

    `problems` are what the console and the page's scripts complained of.
    """

    def __init__(self, width=1200, height=900):
        from tornado.websocket import websocket_connect

        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        lines = [f'user_pref("{name}", {json.dumps(value)});' for name, value in PREFERENCES.items()]
        Path(self.folder.name, "user.js").write_text("\n".join(lines))
        command = [FIREFOX, "--no-remote", "--remote-debugging-port", "0", "--profile", self.folder.name]
        self.screen = Screen(width, height)
        environment = self.screen.environment(self.folder.name)
        self.process = subprocess.Popen(
            command,
            env=environment,
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        address = None
        for line in self.process.stderr:
            if found := re.search(r"BiDi listening on (ws://\S+)", line):
                address = found[1]
                break
        self.loop, self.last, self.problems = asyncio.new_event_loop(), 0, []
        self.socket = self.loop.run_until_complete(
            asyncio.wait_for(self._connect(websocket_connect, f"{address}/session"), PATIENCE_S)
        )
        self.call("session.new", capabilities={})
        self.call("session.subscribe", events=["log.entryAdded"])
        self.context = self.call("browsingContext.getTree")["contexts"][0]["context"]
        self.call("browsingContext.setViewport", context=self.context, viewport={"width": width, "height": height})

    async def _connect(self, connect, address):
        return await connect(address, max_message_size=1 << 28)

    def close(self):
        end(self.process)
        self.screen.close()
        self.process.stderr.close()
        self.loop.close()
        self.folder.cleanup()

    def call(self, method, **params):
        async def exchange():
            self.last += 1
            await self.socket.write_message(json.dumps({"id": self.last, "method": method, "params": params}))
            while True:
                answer = json.loads(await self.socket.read_message())
                if answer.get("id") == self.last:
                    return answer
                if answer.get("method") == "log.entryAdded" and answer["params"]["level"] in ("error", "warn"):
                    self.problems.append(answer["params"]["text"])

        answer = self.loop.run_until_complete(asyncio.wait_for(exchange(), PATIENCE_S))
        if answer["type"] == "error":
            raise RuntimeError(f"{method}: {answer['message']}")
        return answer["result"]

    def run(self, script):
        """The value of an expression; a promise is awaited."""
        asked = f"(async () => JSON.stringify(await ({script})) ?? 'null')()"
        target = {"context": self.context}
        found = self.call("script.evaluate", expression=asked, target=target, awaitPromise=True)
        if found["type"] == "exception":
            raise RuntimeError(found["exceptionDetails"]["text"])
        return json.loads(found["result"]["value"])

    def navigate(self, address):
        self.call("browsingContext.navigate", context=self.context, url=address, wait="complete")

    def act(self, actions):
        self.call("input.performActions", context=self.context, actions=actions)

    def picture(self):
        return self.call("browsingContext.captureScreenshot", context=self.context)["data"]


class WebKit(_Page):
    """One page of WebKitGTK's MiniBrowser on a screen in memory. WebDriver tells nothing of the console."""

    problems = ()

    def __init__(self, width=1200, height=900):
        self.screen = Screen(width, height)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        environment = self.screen.environment(self.folder.name)
        environment |= {"WEBKIT_DISABLE_SANDBOX_THIS_IS_DANGEROUS": "1", "NO_AT_BRIDGE": "1"}
        self.process = subprocess.Popen(
            [WEBKIT, f"--port={self.port}"], env=environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        options = {"binary": MINI_BROWSER, "args": ["--automation"]}
        capabilities = {"alwaysMatch": {"webkitgtk:browserOptions": options}}
        self.session = ""
        give_up = time.monotonic() + 20
        while True:
            try:
                self.session = f"/session/{self.call('POST', '/session', capabilities=capabilities)['sessionId']}"
                break
            except (ConnectionError, urllib.error.URLError) as error:
                if isinstance(error, urllib.error.HTTPError) or time.monotonic() > give_up:
                    self.close()
                    raise
                time.sleep(0.1)
        self.call("POST", "/timeouts", script=1000 * PATIENCE_S, pageLoad=1000 * PATIENCE_S)
        self.call("POST", "/window/rect", width=width, height=height)

    def close(self):
        end(self.process)
        self.screen.close()
        self.folder.cleanup()

    def call(self, method, path, **params):
        data = json.dumps(params).encode() if method == "POST" else None
        address = f"http://127.0.0.1:{self.port}{self.session}{path}"
        request = urllib.request.Request(address, data, {"Content-Type": "application/json"}, method=method)
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
            return json.loads(answer.read())["value"]

    def run(self, script):
        """The value of an expression; a promise is awaited."""
        told = "v => done(v ?? null), e => done('failed: ' + e)"
        asked = f"const done = arguments[0]; Promise.resolve({script}).then({told})"
        return self.call("POST", "/execute/async", script=asked, args=[])

    def navigate(self, address):
        self.call("POST", "/url", url=address)

    def act(self, actions):
        self.call("POST", "/actions", actions=actions)

    def picture(self):
        return self.call("GET", "/screenshot")
