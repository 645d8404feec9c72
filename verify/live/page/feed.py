"""The page's feed: sends a run's state to the page's server process, ten times a second.

A thread of its own receives what viewers send: neither a picture that is being sent nor a slow
viewer delays it.
"""

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol

from verify.core.processes import ChildLateError, ChildLostError, ChildProcess
from verify.errors import InputError
from verify.live.page.access import DEFAULT_PORT, LOOPBACK, check_access
from verify.live.page.server import ViewerMessages, serve

FEED_PERIOD = 0.1  # s: faster than eyes follow; pictures too
MAX_DELAY = 0.05  # s more, for a moment in which nobody is kept from something more urgent
STATE_PERIOD = 0.5  # s
START_TIMEOUT = 60.0  # s: a process that imports its modules on a busy machine
JOIN_TIMEOUT = 2.0  # s


class PageSource(Protocol):
    """What a mode of the program has to show. Called from the feed's thread."""

    def hello(self) -> dict[str, Any]:
        """What never changes: mode, names, how the scene is built."""

    def rows(self) -> list[dict[str, Any]]:
        """What has come since the last call."""

    def state(self) -> dict[str, Any]:
        """How everything is."""

    def alarms(self) -> Sequence[dict[str, Any]]:
        """All alarms that are remembered, newest first."""

    def pictures(self) -> Sequence[tuple[int, dict[str, Any], bytes]]:
        """Newest pictures: side, what was found, JPEG. Asked for only while somebody looks."""

    def metrics(self) -> str:
        """The same figures as text for Prometheus."""


class Page:
    """A page that is being served, at a port of this computer (0 takes a free one).

    Another address than loopback needs a token, which viewers must show. `commands`: what viewers
    may ask for, by its word, and what is then done; `inputs`: what they may say more about, by its
    first word, called with what follows that word. Both are called in a thread of their own, and
    have to be quick. `moment` waits, for so many s at most, until what there is to tell holds
    nobody up.

    Raises:
        InputError: the port is taken, or the address is open to others without a token.
    """

    def __init__(
        self,
        source: PageSource,
        port: int = DEFAULT_PORT,
        address: str = LOOPBACK,
        token: str | None = None,
        commands: Mapping[str, Callable[[], None]] | None = None,
        inputs: Mapping[str, Callable[[str], None]] | None = None,
        moment: Callable[[float], object] | None = None,
    ) -> None:
        self._source, self._moment = source, moment
        self._commands, self._inputs = dict(commands or {}), dict(inputs or {})
        self._access = check_access(address, port, token)
        messages = ViewerMessages(frozenset(self._commands), frozenset(self._inputs))
        self._server: ChildProcess[Any, Any] = ChildProcess(
            serve, self._access, messages, name="page"
        )
        self._wait_until_ready()
        self.viewers = 0  # how many look on
        self.trouble = ""
        self._stop = threading.Event()
        self._receiver = threading.Thread(target=self._receive, name="page-receive", daemon=True)
        self._sender = threading.Thread(target=self._feed, name="page", daemon=True)
        self._receiver.start()
        self._sender.start()

    @property
    def url(self) -> str:
        """What to open in a browser."""
        access = self._access
        token = "" if access.token is None else f"?token={access.token}"
        return f"http://{access.host}:{access.port}/{token}"

    def close(self) -> None:
        """Send what is left, and end the server."""
        self._stop.set()
        self._sender.join(JOIN_TIMEOUT)
        self._server.stop(JOIN_TIMEOUT)
        self._receiver.join(JOIN_TIMEOUT)

    def _wait_until_ready(self) -> None:
        try:
            port = self._server.wait_until_ready(START_TIMEOUT)
        except ChildLostError as error:
            self._server.stop(0.0)
            late = isinstance(error, ChildLateError)
            found = "it does not start" if late else str(error)
            place = f"--page, {self._access.address}:{self._access.port}"
            remedy = "Choose another one: --page-port 8700, or --page-address."
            remedy = "Try again when this machine is less busy." if late else remedy
            raise InputError(place, f"the page cannot be served: {found}", "", remedy) from error
        self._access = replace(self._access, port=port)

    def _feed(self) -> None:
        """Send until stopped; a page that is lost does not stop the run."""
        try:
            self._server.send(("hello", _text("hello", self._source.hello())))
            due = 0.0
            while not self._stop.is_set():
                begin = time.monotonic()
                self._send_news(full=begin >= due)
                due = begin + STATE_PERIOD if begin >= due else due
                self._stop.wait(max(FEED_PERIOD - (time.monotonic() - begin), FEED_PERIOD / 10))
                if self._moment is not None and not self._stop.is_set():
                    self._moment(MAX_DELAY)
            self._send_news(full=True)
        except ChildLostError as error:
            self.trouble = f"the page is gone: {error}"

    def _send_news(self, *, full: bool) -> None:
        rows = self._source.rows()
        if rows:
            self._server.send(("rows", [json.dumps(row, allow_nan=False) for row in rows]))
        if full:
            self._server.send(("state", _text("state", self._source.state())))
            self._server.send(("alarms", _text("alarms", {"alarms": list(self._source.alarms())})))
            self._server.send(("metrics", self._source.metrics()))
        if self.viewers:
            for side, found, jpeg in self._source.pictures():
                text = json.dumps(found, allow_nan=False).encode()
                # the side's number, the length of what was found, that as JSON, the JPEG
                message = bytes([side]) + len(text).to_bytes(4, "big") + text + jpeg
                self._server.send(("picture", side, message))

    def _receive(self) -> None:
        """Act on the server's messages until it ends."""
        with suppress(ChildLostError):
            while True:
                kind, value = self._server.receive(None)
                try:
                    self._act(kind, value)
                except Exception as error:  # the next message may be a stop
                    self.trouble = f"the page asked for what could not be done: {error}"

    def _act(self, kind: str, value: Any) -> None:
        if kind == "viewers":
            self.viewers = value
        elif kind == "command":
            self._commands[value]()
        else:
            word, more = value
            self._inputs[word](more)


def _text(kind: str, fields: dict[str, Any]) -> str:
    return json.dumps({"type": kind, **fields}, ensure_ascii=False, allow_nan=False)
