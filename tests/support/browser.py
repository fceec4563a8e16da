"""A headless Chromium for tests of pages, spoken to over its own protocol (CDP).

Nothing is installed: whoever has no Chromium skips these tests.
"""

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

NAMES = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"),
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)
_START_S, _WAIT_S = 60.0, 180.0
_FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"),
    *("--no-first-run", "--disable-extensions", "--disable-background-networking"),
    # Requests to the network fail at once; those to this machine do not.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    # WebGL, in software.
    *("--disable-dev-shm-usage", "--enable-unsafe-swiftshader"),
    "--remote-debugging-port=0",
)
_KEYS = {"Tab": 9, "Enter": 13, "ArrowDown": 40}


class Page:
    """One page of a browser."""

    def __init__(self, socket: Any, tabs: str = "") -> None:
        self._socket = socket
        self._tabs = tabs
        self._last = 0
        self.events: list[dict[str, Any]] = []

    def ask(self, method: str, **parameters: object) -> dict[str, Any]:
        """Send a command and return the answer; events are kept."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": parameters}
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=_START_S))
            if answer.get("id") == self._last:
                assert "error" not in answer, answer["error"]
                result: dict[str, Any] = answer["result"]
                return result
            self.events.append(answer)

    @contextmanager
    def tab(self) -> Iterator["Page"]:
        """Open another tab of the same browser."""
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        with _page_at(self._tabs, target) as page:
            yield page

    def type(self, text: str) -> None:
        """Type into what has the focus, all at once."""
        self.ask("Input.insertText", text=text)

    def run(self, expression: str) -> Any:
        """Return the value of an expression of JavaScript."""
        answer = self.ask(
            "Runtime.evaluate",
            expression=expression,
            awaitPromise=True,
            returnByValue=True,
            userGesture=True,
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, expression: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + _WAIT_S
        while not self.run(f"Boolean({expression})"):
            assert time.monotonic() < end, f"never true: {expression}"
            time.sleep(0.02)

    def open(self, address: str) -> None:
        """Load a page and wait until its scripts have run."""
        self.ask("Page.navigate", url="about:blank")
        self.ask("Page.navigate", url=address)
        self.wait_for("location.href != 'about:blank'")
        self.wait_for("document.readyState == 'complete'")

    def resize(self, width: int, height: int = 900) -> None:
        """Set the size of the window [px]."""
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def prefer(self, scheme: str) -> None:
        """Ask for ``"light"`` or ``"dark"`` colors."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.ask("Emulation.setEmulatedMedia", features=features)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press the left button at a place [px], move to another, and let go."""
        (x, y), (to_x, to_y) = start, end
        self._mouse("mouseMoved", x, y, 0)
        self._mouse("mousePressed", x, y, 1)
        for part in (0.2, 0.4, 0.6, 0.8, 1.0):
            at = x + part * (to_x - x), y + part * (to_y - y)
            self._mouse("mouseMoved", *at, 1)
            time.sleep(0.06)
        self._mouse("mouseReleased", to_x, to_y, 0)

    def _mouse(self, what: str, x: float, y: float, buttons: int) -> None:
        button = "none" if what == "mouseMoved" and not buttons else "left"
        self.ask(
            "Input.dispatchMouseEvent",
            type=what, x=x, y=y, button=button, buttons=buttons, clickCount=1,
        )  # fmt: skip

    def press(self, key: str) -> None:
        """Press and release a key."""
        more: dict[str, object] = {"key": key, "code": key}
        if key in _KEYS:
            more["windowsVirtualKeyCode"] = _KEYS[key]
        if len(key) == 1:
            more["text"] = key
        elif key == "Enter":
            more["text"] = "\r"
        self.ask("Input.dispatchKeyEvent", type="keyDown", **more)
        self.ask("Input.dispatchKeyEvent", type="keyUp", **more)

    def screenshot(self, path: Path, *, full: bool = False) -> None:
        """Save what is seen as PNG."""
        answer = self.ask("Page.captureScreenshot", captureBeyondViewport=full)
        path.write_bytes(base64.b64decode(answer["data"]))


def find_chromium() -> str | None:
    """Return a Chromium's command, if there is one; ``CHROMIUM`` may name it."""
    named = os.environ.get("CHROMIUM")
    return named or next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def page_in_chromium(folder: Path) -> Iterator[Page]:
    """Start a browser with its profile in a folder, and end it afterwards."""
    command = find_chromium()
    if command is None:
        pytest.skip(f"no Chromium found; looked for {', '.join(NAMES)}")
    client = pytest.importorskip("websockets.sync.client")
    profile = folder / "chromium"
    process = subprocess.Popen(
        [command, *_FLAGS, f"--user-data-dir={profile}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        port, browser = _port(process, profile)
        with client.connect(f"ws://127.0.0.1:{port}{browser}", **_WIDE) as socket:
            root = Page(socket)
            found = root.ask("Target.getTargets")["targetInfos"]
            target = next(one["targetId"] for one in found if one["type"] == "page")
            with _page_at(f"ws://127.0.0.1:{port}/devtools/page", target) as page:
                yield page
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=5.0)
        if process.poll() is None:
            process.kill()
            process.wait()


@contextmanager
def _page_at(tabs: str, target: str) -> Iterator[Page]:
    client = pytest.importorskip("websockets.sync.client")
    with client.connect(f"{tabs}/{target}", **_WIDE) as socket:
        page = Page(socket, tabs)
        for domain in ("Page", "Runtime", "Network"):
            page.ask(f"{domain}.enable")
        yield page


_WIDE: dict[str, Any] = {
    "max_size": None,
    "proxy": None,
    "compression": None,
    "open_timeout": _START_S,
}


def _port(process: "subprocess.Popen[bytes]", profile: Path) -> tuple[int, str]:
    """Return port and path of the browser, which it writes into its profile."""
    note = profile / "DevToolsActivePort"
    end = time.monotonic() + _START_S
    while time.monotonic() < end:
        assert process.poll() is None, "Chromium ended at once"
        if note.exists() and len(lines := note.read_text().split()) == 2:
            return int(lines[0]), lines[1]
        time.sleep(0.02)
    raise AssertionError("Chromium did not start")
