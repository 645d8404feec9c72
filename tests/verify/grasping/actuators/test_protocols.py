"""A port that is opened beside the loop: its state while it is retried."""

import threading
from collections.abc import Callable

import pytest

from verify.devices.ports import Port
from verify.grasping.actuators.protocols import BackgroundOpener


def attempted(opening: BackgroundOpener, over: Callable[[str], bool]) -> str:
    for _ in range(1000):
        try:
            opening()
        except OSError as problem:
            if over(str(problem)):
                return str(problem)
    return "never"


@pytest.mark.realtime
def test_the_last_refusal_is_reported_while_the_next_attempt_hangs() -> None:
    hangs, count = threading.Event(), [0]

    def open_port() -> Port:
        count[0] += 1
        if count[0] > 1:
            hangs.wait(5.0)
        raise ConnectionRefusedError(111, "nobody listens there")

    opening = BackgroundOpener(open_port)
    try:
        assert "nobody listens" in attempted(opening, lambda message: "nobody" in message)
        with pytest.raises(ConnectionRefusedError, match="nobody listens"):
            opening()  # the second attempt hangs
        assert count[0] <= 2
    finally:
        hangs.set()
        opening.close()


@pytest.mark.realtime
def test_a_port_that_opens_too_late_is_closed_again() -> None:
    closed, may_open = threading.Event(), threading.Event()

    class Late:
        close = closed.set

    def opening() -> Port:
        may_open.wait(5.0)
        return Late()  # type: ignore[return-value]

    slow = BackgroundOpener(opening)
    with pytest.raises(OSError, match="being opened"):
        slow()
    slow.close()
    may_open.set()
    assert closed.wait(5.0)
