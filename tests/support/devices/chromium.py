"""Chromium without a window, driven by Playwright."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import pytest
from playwright import sync_api

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
LIMIT_MS = 30_000.0  # for anything to show


@dataclass(frozen=True)
class Tab:
    """One page, which its user looks at, and the errors that it reports by itself."""

    page: sync_api.Page
    complaints: list[str] = field(default_factory=list)

    def evaluate(self, expression: str) -> Any:
        return self.page.evaluate(expression)

    def text(self, selector: str) -> str:
        """The text that a user sees there."""
        return self.page.locator(selector).first.inner_text()

    def until(self, condition: str) -> None:
        """Wait until an expression is true."""
        self.page.wait_for_function(f"() => Boolean({condition})", polling=30)

    def press(self, key: str) -> None:
        """Press a key: a character, or a name such as ArrowLeft or Shift+ArrowLeft."""
        self.page.keyboard.press(key)


@dataclass(frozen=True)
class Browser:
    """A browser that forgets everything from one page to the next."""

    program: sync_api.Browser

    @contextmanager
    def open(
        self,
        url: str,
        width: int = 1300,
        height: int = 900,
        scheme: Literal["light", "dark"] = "light",
    ) -> Iterator[Tab]:
        """Look at a page through a window of a size, in CSS pixels."""
        size = sync_api.ViewportSize(width=width, height=height)
        with self.program.new_context(viewport=size, color_scheme=scheme) as context:
            context.set_default_timeout(LIMIT_MS)
            tab = Tab(context.new_page())
            tab.page.on("pageerror", lambda error: tab.complaints.append(str(error)))
            tab.page.on("console", lambda line: _keep_error(tab, line))
            tab.page.goto(url)
            yield tab


def _keep_error(tab: Tab, line: sync_api.ConsoleMessage) -> None:
    if line.type == "error":
        tab.complaints.append(line.text)


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
def launched(folder: Path) -> Iterator[Browser]:
    """Start the browser, end it; `folder` may be filled. Skip without Chromium."""
    if PROGRAM is None:
        pytest.skip("needs Chromium")
    # what it draws, without a graphics card, must not cost the live runs beside it their pictures
    start = folder / "chromium"
    start.write_text(f'#!/bin/sh\nexec nice -n 10 "{PROGRAM}" "$@"\n')
    start.chmod(0o700)
    with sync_api.sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--hide-scrollbars"]
        yield Browser(playwright.chromium.launch(executable_path=start, args=arguments))
