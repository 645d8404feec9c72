"""A port that is opened beside the loop: its state while it is retried."""

import threading

import pytest

from verify.devices.ports import Port
from verify.grasping.actuators.protocols import BackgroundOpener


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
