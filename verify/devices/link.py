"""A port that opens itself, says in words why it cannot, and tries again."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from verify.devices.ports import ENDED, Port, in_words

WAIT = 0.02  # s: the longest that a reading call waits on an open line
TAKEN = "before it said anything: another program may have the line"
FIRST_RETRY, LAST_RETRY = 0.25, 4.0  # s: doubled from the one to the other

Now = Callable[[], float]


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that came together, and when."""

    data: bytes
    t: float  # s, host's monotonic clock, when they were in hand
    earliest: float  # s: before this they were not there


class Link:
    """Keeps one port open for a driver.

    Args:
        name: the port as the user wrote it, for sentences.
        open_port: opens it; raises OSError while that is not possible.
        now: the host's monotonic clock, s.
    """

    def __init__(self, name: str, open_port: Callable[[], Port], now: Now = time.monotonic) -> None:
        self.name = name
        self.now = now
        self.fault = "not opened yet"
        self.connections = 0  # drivers greet the device anew when this has risen
        self._open_port = open_port
        self._port: Port | None = None
        self._retry = FIRST_RETRY
        self._next_try = float("-inf")
        self._last_look = now()
        self._closed = False
        self._heard = False  # anything since the port was opened

    @property
    def connected(self) -> bool:
        """Whether the port is open."""
        return self._port is not None

    def receive(self, wait: float = WAIT) -> Chunk | None:
        """Take what has come, waiting for at most so long; opens the port where that is due."""
        if not self._opened(wait) or self._port is None:
            return None
        try:
            there = self._port.wait(0.0)
            earliest = self._last_look
            if not there:
                there = self._port.wait(wait)
                earliest = self.now()
            data = self._port.take() if there else b""
        except OSError as error:
            self._broken(error)
            return None
        self._last_look = self.now()
        self._heard |= bool(data)
        return Chunk(data, self._last_look, min(earliest, self._last_look)) if data else None

    def send(self, data: bytes) -> bool:
        """Send it; False if the line is not there or breaks."""
        if self._port is None:
            return False
        try:
            self._port.send(data)
        except OSError as error:
            self._broken(error)
            return False
        return True

    def drop(self, why: str) -> None:
        """Give the line up for now; it is tried again."""
        if self._port is not None:
            self._port.close()
        self._port, self.fault = None, why
        self._next_try = self.now() + self._retry

    def steady(self) -> None:
        """Note that good data come: the next break is mended at once again."""
        self._retry = FIRST_RETRY

    def close(self) -> None:
        """Close the port for good."""
        self._closed = True
        self.drop("closed")

    def _opened(self, wait: float) -> bool:
        if self._port is not None:
            return True
        now = self.now()
        if self._closed or now < self._next_try:
            time.sleep(wait)
            return False
        try:
            self._port = self._open_port()
        except OSError as error:
            self._retry = min(2 * self._retry, LAST_RETRY)
            self.drop(in_words(error))
            return False
        self.connections += 1
        self._last_look, self._heard = self.now(), False
        return True

    def _broken(self, error: OSError) -> None:
        why = in_words(error)
        self.drop(f"{why} {TAKEN}" if why == ENDED and not self._heard else why)
