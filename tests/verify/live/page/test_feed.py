"""What comes back from viewers: whole words, words with more behind them, and nothing else."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
from websockets.sync.client import connect

from verify.cli import watch
from verify.cli.options import PageOptions
from verify.io.session.keys import Tolerance
from verify.live.page.feed import Page
from verify.live.state import LiveState

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


def test_words_come_back_in_order_and_only_those_that_are_offered() -> None:
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
    assert heard == ["stop", "go:1 2", "go:", "stop"]


def test_a_word_that_fails_does_not_keep_the_next_from_being_heard() -> None:
    ended = threading.Event()

    def fail() -> None:
        raise RuntimeError("it cannot be done")

    page = Page(Nothing(), 0, asked={"fail": fail, "stop": ended.set})
    with line_to(page) as line:
        line.send("fail")
        line.send("stop")
        assert ended.wait(LIMIT)
    assert "cannot be done" in page.trouble


def test_a_line_that_is_too_long_ends_that_viewer_s_and_no_other_s() -> None:
    ended = threading.Event()
    page = Page(Nothing(), 0, asked={"stop": ended.set}, given={"go": lambda _: None})
    with line_to(page) as line:
        host = page.url.removeprefix("http://").rstrip("/")
        with connect(f"ws://{host}/live", origin=f"http://{host}", max_queue=None) as other:
            other.send("go " + "1" * 10_000)
        line.send("stop")
        assert ended.wait(LIMIT)


def test_the_page_of_a_run_is_given_nothing_to_ask_for(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[tuple[Any, ...], dict[str, Any]]] = []

    class Recorded:
        url = "http://127.0.0.1:1/"
        close: Callable[[], None] = staticmethod(lambda: None)

        def __init__(self, *given: Any, **named: Any) -> None:
            made.append((given, named))

    class Station:
        class alarm:  # noqa: N801
            prometheus = None

    monkeypatch.setattr(watch, "Page", Recorded)
    page = PageOptions(0, "127.0.0.1", None)
    wish = watch.RunOptions(None, Tolerance(None, None, None), None, page)
    with ExitStack() as stack:
        watch._serve(Station(), wish, Nothing(), LiveState(), stack)  # type: ignore[arg-type]
    ((given, named),) = made
    assert given[1:] == (0, "127.0.0.1", None)
    assert set(named) == {"moment"}  # no `asked`, no `given`
