"""A headless Chromium that draws WebGL in software, driven through its debugging pipe."""

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
ALONE = ["--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"]
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PATIENCE_S = 120


class Browser:
    """One page; `problems` are what the console and the page's scripts complained of."""

    def __init__(self, width=1200, height=900):
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_browser, from_browser = os.pipe(), os.pipe()
        # Chromium reads from file 3 and writes to file 4; high numbers first, so that neither is overwritten.
        ends = [os.dup(to_browser[0]), os.dup(from_browser[1])]

        def connect():
            high = [os.dup(end) for end in ends]
            high = [os.dup(end) if end < 5 else end for end in high]
            os.dup2(high[0], 3)
            os.dup2(high[1], 4)

        profile, size = f"--user-data-dir={self.folder.name}", f"--window-size={width},{height}"
        own = [CHROMIUM, "--headless", "--no-sandbox", "--remote-debugging-pipe", profile, size]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        # preexec_fn: nothing else gives a program files of these numbers.
        self.process = subprocess.Popen(
            [*own, *ALONE, *SOFTWARE_GL],
            preexec_fn=connect,  # noqa: PLW1509
            close_fds=False,
            **quiet,
        )
        for end in (*ends, to_browser[0], from_browser[1]):
            os.close(end)
        self.write, self.read = to_browser[1], from_browser[0]
        self.buffer, self.last, self.problems, self.session = b"", 0, [], None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        os.close(self.write)
        os.close(self.read)
        self.folder.cleanup()

    def call(self, method, **params):
        self.last += 1
        message = {"id": self.last, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.write, json.dumps(message).encode() + b"\0")
        until = time.monotonic() + PATIENCE_S
        while True:
            while b"\0" not in self.buffer:
                ready, _, _ = select.select([self.read], [], [], max(until - time.monotonic(), 0))
                if not ready:
                    raise TimeoutError(method)
                self.buffer += os.read(self.read, 1 << 20)
            line, _, self.buffer = self.buffer.partition(b"\0")
            answer = json.loads(line)
            if answer.get("id") == self.last:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self._note(answer)

    def _note(self, event):
        params = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.problems.append(details.get("exception", {}).get("description", details["text"]))
        elif event.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.problems.append(params["entry"]["text"])
        elif event.get("method") == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
            self.problems.append(" ".join(str(arg.get("value", arg.get("description"))) for arg in params["args"]))

    def run(self, script):
        """The value of an expression; a promise is awaited."""
        found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"]["exception"]["description"])
        return found["result"].get("value")

    def until(self, script):
        """Waits for an expression to be true."""
        give_up = time.monotonic() + PATIENCE_S
        while not self.run(script):
            if time.monotonic() > give_up:
                raise TimeoutError(script)
            time.sleep(0.05)

    def open(self, address):
        self.call("Page.navigate", url=address)
        self.until("document.readyState === 'complete' && document.getElementById('viewer')?.dataset.ready")

    def settle(self):
        """Waits until the view has been drawn at rest."""
        self.run("new Promise(done => setTimeout(done, 350))")
        self.until("(({ stage, pace }) => !pace.moving && !stage.pending)(document.getElementById('viewer').view)")

    def pixels(self):
        """What the canvas shows, as an RGBA array."""
        size = self.run(
            "(() => { const { stage } = document.getElementById('viewer').view; stage.sharpen(1);"
            "stage.draw(performance.now());"
            "const gl = stage.renderer.getContext(); const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight];"
            "const data = new Uint8Array(4 * w * h); gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, data);"
            "let text = ''; for (let k = 0; k < data.length; k += 32768)"
            "text += String.fromCharCode(...data.subarray(k, k + 32768)); return [w, h, btoa(text)]; })()"
        )
        return np.frombuffer(base64.b64decode(size[2]), np.uint8).reshape(size[1], size[0], 4)[::-1]

    def key(self, key, shift=False):
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, modifiers=8 * shift)

    def mouse(self, kind, x, y, button="left"):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=1, clickCount=1)

    def click(self, x, y):
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)

    def drag(self, start, end, steps=6):
        self.mouse("mousePressed", *start)
        for k in range(1, steps + 1):
            self.mouse("mouseMoved", *(a + (b - a) * k / steps for a, b in zip(start, end, strict=True)))
        self.mouse("mouseReleased", *end)

    def screenshot(self, path):
        path = Path(path)
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
        return path
