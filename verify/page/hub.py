"""What goes from the run to every viewer: the newest of everything, never a queue that grows."""

import asyncio
from collections import deque
from collections.abc import Callable

HISTORY = 1800  # rows for a viewer who comes later: a minute at 30 a second
WAITING = 200  # messages a viewer may lag behind; a browser that sleeps is let go


class Viewer:
    """One browser: text in order, of pictures only the newest a side."""

    def __init__(self) -> None:
        self._texts: deque[str] = deque()
        self._pictures: dict[int, bytes] = {}
        self._wake = asyncio.Event()
        self.lagging = False

    def text(self, message: str) -> None:
        """Put a message in line."""
        if len(self._texts) >= WAITING:
            self.lagging = True
        else:
            self._texts.append(message)
        self._wake.set()

    def picture(self, side: int, data: bytes) -> None:
        """Replace the picture that was not sent yet."""
        self._pictures[side] = data
        self._wake.set()

    async def next(self) -> list[str | bytes]:
        """Wait for something to send."""
        await self._wake.wait()
        self._wake.clear()
        messages: list[str | bytes] = [*self._texts, *self._pictures.values()]
        self._texts.clear()
        self._pictures.clear()
        return messages


class Hub:
    """All viewers, and what one who comes later has to know.

    Args:
        counted: told how many viewers there are whenever that changes.
    """

    def __init__(self, counted: Callable[[int], None]) -> None:
        self._viewers: set[Viewer] = set()
        self._counted = counted
        self._latest: dict[str, str] = {}  # by kind, of messages of which the newest is enough
        self._rows: deque[str] = deque(maxlen=HISTORY)
        self._pictures: dict[int, bytes] = {}
        self.metrics = ""

    def enter(self) -> Viewer:
        """Let a viewer in and tell it what there was."""
        viewer = Viewer()
        for kind in ("hello", "state", "alarms"):
            if kind in self._latest:
                viewer.text(self._latest[kind])
        if self._rows:
            viewer.text('{"type":"rows","past":true,"rows":[' + ",".join(self._rows) + "]}")
        for side, data in self._pictures.items():
            viewer.picture(side, data)
        self._viewers.add(viewer)
        self._counted(len(self._viewers))
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Forget a viewer."""
        self._viewers.discard(viewer)
        self._counted(len(self._viewers))

    def message(self, kind: str, text: str) -> None:
        """Pass on a message."""
        if kind == "metrics":
            self.metrics = text
            return
        if kind != "rows":
            self._latest[kind] = text
        if kind == "hello":
            self._rows.clear()
        for viewer in self._viewers:
            viewer.text(text)

    def rows(self, rows: list[str]) -> None:
        """Pass on rows, each an object in JSON."""
        self._rows.extend(rows)
        self.message("rows", '{"type":"rows","rows":[' + ",".join(rows) + "]}")

    def picture(self, side: int, data: bytes) -> None:
        """Pass on a picture with its LEDs."""
        self._pictures[side] = data
        for viewer in self._viewers:
            viewer.picture(side, data)
