"""Chromium without a window, driven over its DevTools protocol: pages are opened, clicked and looked at."""

import base64
import contextlib
import itertools
import json
import os
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

#: A machine's own network is not asked for anything, and nothing is asked of a user.
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--no-default-browser-check",
    "--disable-dev-shm-usage", "--force-color-profile=srgb", "--hide-scrollbars",
)  # fmt: skip
#: How long a page may take for anything, s: machines of tests are slow.
PATIENCE_S = 60.0


class Page:
    """One page; what its console says as an error, and what it asks a network for, is kept."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.errors: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the protocol."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if message.get("id") == number:
                assert "error" not in message, f"{method}: {message['error']}"
                return dict(message["result"])
            self._heard(message.get("method"), message.get("params", {}))

    def _heard(self, method: str | None, params: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled" and params["type"] in {"error", "warning", "assert"}:
            self.errors.append(" ".join(str(one.get("value", one)) for one in params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] in {"error", "warning"}:
            self.errors.append(params["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])

    def js(self, expression: str) -> Any:
        """The value of an expression in the page; a promise is awaited."""
        result = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + PATIENCE_S
        while not self.js(f"Boolean({expression})"):
            assert time.monotonic() < end, f"never true: {expression}; errors: {self.errors}"
            time.sleep(0.02)

    def drawn(self) -> None:
        """Wait until what was asked for is drawn: for two frames."""
        self.js("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))).then(() => 0)")

    def size(self, width: int, height: int) -> None:
        """The size of the window, px."""
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def open(self, path: Path, fragment: str = "") -> None:
        """Open a file, anew."""
        self.send("Page.navigate", url="about:blank")
        self.send("Page.navigate", url=f"{path.as_uri()}{fragment}")
        self.until("document.readyState === 'complete' && location.href !== 'about:blank'")

    def click(self, x: float, y: float) -> None:
        """Press and release the left button."""
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, key: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=key)

    def picture(self, path: Path) -> Path:
        """Save what is seen as PNG."""
        path.write_bytes(base64.b64decode(self.send("Page.captureScreenshot", format="png")["data"]))
        return path


@contextlib.contextmanager
def chromium(folder: Path) -> Iterator[Page]:
    """A page of a browser of its own, whose files lie in an empty folder."""
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("chromium is not installed: sh setup.sh tests")
    command = [program, *QUIET, "--remote-debugging-port=0", f"--user-data-dir={folder}", "about:blank"]
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = {**os.environ, "HOME": str(folder)}
    with subprocess.Popen(command, env=environment, **quiet) as browser:  # type: ignore[call-overload]
        try:
            with connect(_address(folder / "DevToolsActivePort", browser), max_size=None, proxy=None) as socket:
                yield Page(socket)
        finally:
            browser.terminate()


def _address(said: Path, browser: "subprocess.Popen[bytes]") -> str:
    """Where the first page listens, once the browser has written its port."""
    end = time.monotonic() + PATIENCE_S
    while not (said.is_file() and "\n" in said.read_text()):
        assert browser.poll() is None, f"chromium ended with {browser.returncode}"
        assert time.monotonic() < end, "chromium does not start"
        time.sleep(0.05)
    port = int(said.read_text().split()[0])
    local = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    while True:
        with local.open(f"http://127.0.0.1:{port}/json/list", timeout=PATIENCE_S) as answer:
            pages = [one for one in json.load(answer) if one["type"] == "page"]
        if pages:
            return str(pages[0]["webSocketDebuggerUrl"])
        assert time.monotonic() < end, "chromium opens no page"
