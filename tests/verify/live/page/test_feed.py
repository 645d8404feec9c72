"""What comes back from viewers: whole words, words with more behind them, and nothing else."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from websockets.sync.client import connect

from tests.support.processes import wait_until
from verify.live.page.feed import Page

LIMIT = 20.0  # s


NOTHING: Any = SimpleNamespace(  # a source that has nothing to show
    hello=lambda: {"mode": "run"}, rows=list, state=dict, alarms=tuple, pictures=tuple, metrics=str,
)  # fmt: skip


def own(page: Page) -> Any:
    host = page.url.removeprefix("http://").rstrip("/")
    return connect(f"ws://{host}/live", origin=f"http://{host}", max_queue=None)


@contextmanager
def line_to(page: Page) -> Iterator[Any]:
    try:
        with own(page) as line:
            yield line
    finally:
        page.close()


@pytest.mark.realtime
def test_offered_requests_arrive_in_order_and_no_others() -> None:
    requests: list[str] = []
    ended = threading.Event()
    page = Page(
        NOTHING, 0,
        commands={"stop": lambda: requests.append("stop"), "end": ended.set},
        inputs={"go": lambda more: requests.append(f"go:{more}")},
    )  # fmt: skip
    with line_to(page) as line:
        for text in ("stop", "stop now", "go 1 2", "go", "gone", "Stop", "\nstop", "stop", "end"):
            line.send(text)
        assert ended.wait(LIMIT)
        line.send(b"stop")  # no page sends bytes: the connection is closed
        wait_until(lambda: not page.viewers, LIMIT)
    assert requests == ["stop", "go:1 2", "go:", "stop"]


@pytest.mark.realtime
def test_a_failing_request_does_not_block_the_next() -> None:
    ended = threading.Event()

    def fail() -> None:
        raise RuntimeError("it cannot be done")

    page = Page(NOTHING, 0, commands={"fail": fail, "stop": ended.set})
    with line_to(page) as line:
        line.send("fail")
        line.send("stop")
        assert ended.wait(LIMIT)
    assert "cannot be done" in page.trouble


@pytest.mark.realtime
def test_a_too_long_message_ends_that_connection_alone() -> None:
    ended = threading.Event()
    page = Page(NOTHING, 0, commands={"stop": ended.set}, inputs={"go": lambda _: None})
    with line_to(page) as line:
        with own(page) as other:
            other.send("go " + "1" * 10_000)
        line.send("stop")
        assert ended.wait(LIMIT)
