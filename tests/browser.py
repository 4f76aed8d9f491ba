"""A headless Chromium for tests, spoken to over pipes; every wait has an end."""

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time

import pytest

FLAGS = (
    "--headless=new --no-sandbox --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --disable-default-apps --disable-extensions --hide-scrollbars "
    "--use-angle=swiftshader --enable-unsafe-swiftshader --disable-dev-shm-usage --remote-debugging-pipe"
).split()


def find_chromium() -> str:
    """Find the browser; skips the test without one, fails if CDM_PIN_REQUIRE_BROWSER=1."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if path := shutil.which(name):
            return path
    if os.environ.get("CDM_PIN_REQUIRE_BROWSER") == "1":
        pytest.fail("CDM_PIN_REQUIRE_BROWSER=1, but there is no chromium")
    pytest.skip("no chromium; install it to run the browser tests (apt-get install chromium)")


class Browser:
    """One page: `visit`, `evaluate`, `wait_for`, `screenshot`; `requests` lists every address it asked for."""

    def __init__(self, width: int = 500, height: int = 400, scale: float = 1.0):
        self.profile = tempfile.mkdtemp(prefix="cdm-pin-browser-")
        to_child, self.out = os.pipe()
        self.into, from_child = os.pipe()
        command = [find_chromium(), *FLAGS, f"--user-data-dir={self.profile}", f"--window-size={width},{height}"]

        def place_pipes():
            a, b = os.dup(to_child), os.dup(from_child)
            os.dup2(a, 3)
            os.dup2(b, 4)

        quiet = subprocess.DEVNULL
        self.process = subprocess.Popen(
            [*command, "about:blank"],
            stdin=quiet, stdout=quiet, stderr=quiet, close_fds=False, preexec_fn=place_pipes,
        )  # fmt: skip
        os.close(to_child)
        os.close(from_child)
        self.buffer, self.count, self.session = b"", 0, None
        self.requests, self.log = [], []
        page = next(t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        self.session = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)["sessionId"]
        for domain in ("Network", "Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        size = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def call(self, method: str, **params):
        self.count += 1
        message = {"id": self.count, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.out, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + 30
        while time.monotonic() < end:
            answer = self._read(end)
            if answer.get("id") == self.count:
                assert "error" not in answer, answer
                return answer["result"]
        raise TimeoutError(method)

    def _read(self, end: float) -> dict:
        while b"\0" not in self.buffer:
            if not select.select([self.into], [], [], max(0.0, end - time.monotonic()))[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self.into, 1 << 20)
            if not part:
                raise RuntimeError("the browser ended")
            self.buffer += part
        text, self.buffer = self.buffer.split(b"\0", 1)
        message = json.loads(text)
        params = message.get("params", {})
        if message.get("method") == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        if message.get("method") == "Network.webSocketCreated":
            self.requests.append(params["url"])
        if message.get("method") == "Runtime.exceptionThrown":
            self.log.append(params["exceptionDetails"].get("exception", {}).get("description", str(params)))
        if message.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.log.append(params["entry"]["text"])
        return message

    def visit(self, url: str) -> None:
        """Open a page, with an empty page in between, so that `requests` and `log` are of this one only."""
        self.call("Page.navigate", url="about:blank")
        self.wait_for("location.href === 'about:blank' && document.readyState === 'complete'")
        self.requests.clear()
        self.log.clear()
        self.call("Page.navigate", url=url)

    def evaluate(self, expression: str):
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait_for(self, expression: str, seconds: float = 30.0) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            result = self.call("Runtime.evaluate", expression=f"!!({expression})", returnByValue=True)
            if "exceptionDetails" not in result and result["result"].get("value"):
                return
            time.sleep(0.05)
        raise TimeoutError(f"{expression} did not come true; the page logged {self.log}")

    def screenshot(self) -> bytes:
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def close(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self.out)
        os.close(self.into)
        shutil.rmtree(self.profile, ignore_errors=True)

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()
