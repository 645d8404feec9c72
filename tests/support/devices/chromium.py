"""Chromium without a window, driven over its DevTools protocol."""

import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
LIMIT = 30.0  # s, for anything to show


class Line:
    """Commands to the browser or a page, and what it tells by itself."""

    def __init__(self, line: ClientConnection) -> None:
        self._line = line
        self._number = 0
        self.complaints: list[str] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        self._line.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._line.recv(timeout=LIMIT))
            if message.get("id") == self._number:
                assert "error" not in message, message["error"]
                result: dict[str, Any] = message["result"]
                return result
            self._hear(message)

    def _hear(self, message: dict[str, Any]) -> None:
        words = message.get("params", {})
        if message["method"] == "Runtime.exceptionThrown":
            self.complaints.append(str(words["exceptionDetails"]))
        elif message["method"] == "Runtime.consoleAPICalled" and words["type"] == "error":
            self.complaints.append(str(words["args"]))
        elif message["method"] == "Log.entryAdded" and words["entry"]["level"] == "error":
            self.complaints.append(words["entry"]["text"])


class Tab(Line):
    """One page, which its user looks at."""

    def evaluate(self, expression: str) -> Any:
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def text(self, selector: str) -> str:
        """The text that a user sees there."""
        return str(self.evaluate(f"document.querySelector({json.dumps(selector)}).innerText"))

    def until(self, condition: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + LIMIT
        while not self.evaluate(f"Boolean({condition})"):
            assert time.monotonic() < end, condition
            time.sleep(0.03)

    def press(self, key: str) -> None:
        """Press a key: a character, or a name such as ArrowLeft."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)


@dataclass(frozen=True)
class Browser:
    """A browser that forgets everything from one page to the next."""

    host: str
    line: Line

    @contextmanager
    def open(
        self, url: str, width: int = 1300, height: int = 900, scheme: str = "light"
    ) -> Iterator[Tab]:
        """Look at a page through a window of a size, in CSS pixels."""
        context = self.line.call("Target.createBrowserContext")["browserContextId"]
        target = self.line.call("Target.createTarget", url="about:blank", browserContextId=context)
        page = f"ws://{self.host}/devtools/page/{target['targetId']}"
        with connect(page, max_size=None, proxy=None) as line:
            tab = Tab(line)
            for domain in ("Page", "Runtime", "Log"):
                tab.call(f"{domain}.enable")
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            tab.call("Emulation.setDeviceMetricsOverride", **size)
            feature = {"name": "prefers-color-scheme", "value": scheme}
            tab.call("Emulation.setEmulatedMedia", features=[feature])
            tab.call("Emulation.setFocusEmulationEnabled", enabled=True)
            tab.call("Page.navigate", url=url)
            yield tab
        self.line.call("Target.disposeBrowserContext", browserContextId=context)


def phone_sections(tab: Tab, scheme: str) -> list[tuple[float, float]]:
    """Tops and bottoms of the page's sections, px: none beside the screen, none over another."""
    assert tab.evaluate("document.documentElement.scrollWidth") <= 360
    assert tab.evaluate("document.documentElement.dataset.theme") == scheme
    boxes = tab.evaluate(
        "[...document.querySelectorAll('main > section')].filter(s => !s.hidden)"
        ".map(s => s.getBoundingClientRect()).map(b => [b.top, b.bottom])"
    )
    for above, below in pairwise(sorted(boxes)):
        assert above[1] <= below[0]
    return [(top, bottom) for top, bottom in boxes]


@contextmanager
def launched(profile: Path) -> Iterator[Browser]:
    """Start the browser, end it; `profile` is a folder that it may fill. Skip without Chromium."""
    if PROGRAM is None:
        pytest.skip("needs Chromium")
    # what it draws, without a graphics card, must not cost the live runs beside it their pictures
    aside = ("nice", "-n", "10") if shutil.which("nice") else ()
    arguments = ("--headless", "--no-sandbox", "--hide-scrollbars", "--remote-debugging-port=0")
    process = subprocess.Popen(
        [*aside, PROGRAM, *arguments, f"--user-data-dir={profile}", "about:blank"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        host, path = _address(profile)
        with connect(f"ws://{host}{path}", max_size=None, proxy=None) as line:
            yield Browser(host, Line(line))
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(10)


def _address(profile: Path) -> tuple[str, str]:
    """Where it listens: it writes that into its folder once it does."""
    output, end = profile / "DevToolsActivePort", time.monotonic() + LIMIT
    while not (output.exists() and "\n" in output.read_text()):
        assert time.monotonic() < end, "Chromium does not start"
        time.sleep(0.03)
    port, path = output.read_text().split("\n")[:2]
    return f"127.0.0.1:{port}", path
