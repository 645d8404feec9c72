"""What comes back from viewers: whole words, words with more behind them, and nothing else."""

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest
from websockets.sync.client import connect

from verify.live.page.feed import Page

LIMIT = 20.0  # s


class Nothing:
    """A source that has nothing to show."""

    def hello(self) -> dict[str, Any]:
        return {"mode": "run"}

    def rows(self) -> list[dict[str, Any]]:
        return []

    def state(self) -> dict[str, Any]:
        return {}

    def alarms(self) -> Sequence[dict[str, Any]]:
        return ()

    def pictures(self) -> Sequence[tuple[int, dict[str, Any], bytes]]:
        return ()

    def metrics(self) -> str:
        return ""


@contextmanager
def line_to(page: Page) -> Iterator[Any]:
    host = page.url.removeprefix("http://").rstrip("/")
    try:
        with connect(f"ws://{host}/live", origin=f"http://{host}", max_queue=None) as line:
            yield line
    finally:
        page.close()


@pytest.mark.realtime
def test_offered_requests_arrive_in_order_and_no_others() -> None:
    heard: list[str] = []
    ended = threading.Event()
    page = Page(
        Nothing(), 0,
        asked={"stop": lambda: heard.append("stop"), "end": ended.set},
        given={"go": lambda more: heard.append(f"go:{more}")},
    )  # fmt: skip
    with line_to(page) as line:
        for text in ("stop", "stop now", "go 1 2", "go", "gone", "Stop", "\nstop", "stop", "end"):
            line.send(text)
        assert ended.wait(LIMIT)
        line.send(b"stop")  # no page sends bytes: the connection is closed
        end = time.monotonic() + LIMIT
        while page.viewers:
            assert time.monotonic() < end
            time.sleep(0.01)
    assert heard == ["stop", "go:1 2", "go:", "stop"]


@pytest.mark.realtime
def test_a_failing_request_does_not_block_the_next() -> None:
    ended = threading.Event()

    def fail() -> None:
        raise RuntimeError("it cannot be done")

    page = Page(Nothing(), 0, asked={"fail": fail, "stop": ended.set})
    with line_to(page) as line:
        line.send("fail")
        line.send("stop")
        assert ended.wait(LIMIT)
    assert "cannot be done" in page.trouble


@pytest.mark.realtime
def test_a_too_long_message_ends_that_connection_alone() -> None:
    ended = threading.Event()
    page = Page(Nothing(), 0, asked={"stop": ended.set}, given={"go": lambda _: None})
    with line_to(page) as line:
        host = page.url.removeprefix("http://").rstrip("/")
        with connect(f"ws://{host}/live", origin=f"http://{host}", max_queue=None) as other:
            other.send("go " + "1" * 10_000)
        line.send("stop")
        assert ended.wait(LIMIT)
