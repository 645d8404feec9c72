"""The recorder: every pair is on the disk before it is measured, unless the disk is too slow.

One thread writes in order of arrival: pairs unencoded at first, and encoded once they have been
measured. The measurement waits for it a few milliseconds at most: a disk that refuses or lags ends
the recording, never the measurement.
"""

import re
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from verify.devices.protocols import CapturedPair, EncoderReading
from verify.errors import InputError, defect_text
from verify.live.recording import session

WRITE_TIMEOUT = 0.02  # s: a pair is measured after it, on the disk or not
# a pair's encoding would take the time of its measurement: until that is through, or so long
MAX_ENCODING_DELAY = 0.1  # s from its coming
MAX_LAG = 0.8  # s behind, and the recording ends: a kill must not cost a second
READING_LEAD = 1.0  # s of readings before the first pair: they bracket it
JOIN_TIMEOUT = 10.0  # s: files that are being written are finished


@dataclass(frozen=True, slots=True)
class RecorderState:
    """Counts of a recording, of all its folders, and a sentence for people."""

    recording: bool
    folders: tuple[Path, ...]  # one for each segment of the controller's clock
    pairs: int  # on the disk
    readings: int
    dropped: int  # pairs whose times did not rise
    late: int  # pairs that were measured before they were on the disk
    trouble: str  # why it has ended before its time; empty: it has not
    sentence: str


@dataclass(frozen=True, slots=True)
class _WriteItem:
    """Something to write."""

    content: CapturedPair | EncoderReading
    came: float  # s, host's monotonic clock
    done: threading.Event = field(default_factory=threading.Event)


class SessionRecorder:
    """Writes what a run sees as sessions that can be measured again.

    A controller's clock that starts anew starts a new session folder, named for strftime: one
    session has one clock offset. A folder is made with its first pair, by `make`. A pair waits
    `write_timeout` s for the disk; `max_lag` s behind, the recording ends.
    """

    def __init__(
        self,
        parent: Path,
        name: str,
        facts: session.SessionFacts,
        make: Callable[..., session.SessionWriter] = session.SessionWriter,
        *,
        write_timeout: float = WRITE_TIMEOUT,
        max_lag: float = MAX_LAG,
    ) -> None:
        self._write_timeout, self._max_lag = write_timeout, max_lag
        self._parent, self._name, self._facts, self._make = parent, name, facts, make
        self._items: deque[_WriteItem] = deque()
        # pairs that are on the disk as they are, and when they came; the writing thread's own
        self._aside: deque[tuple[CapturedPair, float]] = deque()
        self._wake = threading.Condition()
        self._closing = False
        self._trouble = ""  # why the recording has ended
        self._current: session.SessionWriter | None = None
        self._folders: list[Path] = []
        self._segment: int | None = None
        self._early: deque[EncoderReading] = deque()
        self._pairs = self._readings = self._late = 0
        self._numbered = self._dropped = 0
        self._through = -1  # number of the last pair that was measured and compared
        self._last = (float("-inf"), float("-inf"))
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    def keep(
        self,
        pairs: Iterator[CapturedPair],
        meanwhile: Callable[[CapturedPair], None] = lambda _: None,
    ) -> Iterator[CapturedPair]:
        """Record pairs as they pass; each is on the disk before it comes out.

        JPEGs go to the file as they are. `meanwhile` is called with each pair while it is being
        written; it must compute nothing from it that outlives a kill. Pairs come out numbered from
        0, as the recording has them; those whose times do not rise are left out.
        """
        for pair in pairs:
            if pair.t_left <= self._last[0] or pair.t_right <= self._last[1]:
                self._dropped += 1
                continue
            self._last = (pair.t_left, pair.t_right)
            written = replace(
                session.pair_as_written(pair, self._facts.turning), frame=self._numbered
            )
            self._numbered += 1
            item = self._hand_over(written)
            meanwhile(written)
            if item is not None and not item.done.wait(self._write_timeout):
                self._late += 1
            yield written

    def through(self, frame: int) -> None:
        """Report that a pair is measured and compared: now there is time to encode it."""
        with self._wake:
            self._through = frame
            self._wake.notify()

    def reading(self, reading: EncoderReading) -> EncoderReading:
        """Record a reading; gives it as the recording has it."""
        written = session.reading_as_written(reading)
        self._hand_over(written)
        return written

    def state(self) -> RecorderState:
        """Describe the recording."""
        recording = not (self._trouble or self._closing)
        counts = (self._pairs, self._readings, self._dropped, self._late)
        folders = tuple(self._folders)
        return RecorderState(recording, folders, *counts, self._trouble, self._sentence())

    def close(self) -> None:
        """Write what is under way and close the session."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(JOIN_TIMEOUT)
        if self._thread.is_alive():
            self._trouble = self._trouble or "the disk does not answer; the session stays open"

    def _sentence(self) -> str:
        whole = f"{self._pairs} pairs are whole"
        if self._trouble:
            return f"recording has stopped: {self._trouble}; {whole}"
        if self._closing:
            return f"recording closed: {whole}"
        if not self._folders:
            return "recording begins with the first pair"
        late = f"; {self._late} were measured before they were on the disk" if self._late else ""
        return f"recording to {self._folders[-1]}: {whole}{late}"

    def _hand_over(self, content: CapturedPair | EncoderReading) -> _WriteItem | None:
        now = time.monotonic()
        with self._wake:
            late = self._items and now - self._items[0].came > self._max_lag
            if late and not self._trouble:
                lag = f"{self._max_lag:g} s behind"
                self._trouble = f"{self._parent}: disk or processor too slow, {lag}"
            if self._trouble or self._closing:
                return None
            item = _WriteItem(content, now)
            self._items.append(item)
            self._wake.notify()
        return item

    def _write(self) -> None:
        """Write items until the end, then close; runs in its own thread."""
        while self._wait():
            if not self._items:
                self._guarded(self._encode)
                continue
            item = self._items[0]
            if not self._trouble:
                self._guarded(partial(self._put, item))
            with self._wake:
                self._items.popleft()  # only now: its age is how far the disk lags
            item.done.set()
        self._guarded(self._close_part)

    def _wait(self) -> bool:
        """Wait for an item, or until a pair is to be encoded; False at the end."""
        with self._wake:
            while not self._items:
                if self._aside:
                    rest = self._due() - time.monotonic()
                    if rest <= 0 or self._closing:
                        return True
                    self._wake.wait(rest)
                elif self._closing:
                    return False
                else:
                    self._wake.wait()
            return True

    def _due(self) -> float:
        """When to encode the oldest pair that was set aside, s, host's monotonic clock."""
        pair, came = self._aside[0]
        return came + (MAX_ENCODING_DELAY if pair.frame > self._through else 0.0)

    def _guarded(self, action: Callable[[], None]) -> None:
        """Do something with the disk; whatever goes wrong ends the recording and nothing else."""
        try:
            action()
        except (OSError, InputError) as error:
            folder = self._folders[-1] if self._folders else self._parent
            self._fail(session.write_error_text(folder, error))
        except Exception as error:  # a defect of ours must not stop an alarm
            self._fail(defect_text(error))

    def _fail(self, why: str) -> None:
        self._trouble = self._trouble or why
        self._aside.clear()
        part, self._current = self._current, None
        if part is not None:
            self._guarded(part.close)

    def _put(self, item: _WriteItem) -> None:
        if isinstance(item.content, EncoderReading):
            self._put_reading(item.content)
        else:
            self._put_pair(item.content, item.came)

    def _put_pair(self, pair: CapturedPair, came: float) -> None:
        if self._current is not None and not self._current.fits(pair):
            self._close_part()  # a camera has changed its format
        if self._current is None:
            self._current = self._begin(pair)
        part = self._current
        while self._aside and not part.room:
            self._encode()
        if part.set_aside(pair):
            self._aside.append((pair, came))
            return
        while self._aside:
            self._encode()
        part.add_pair(pair)
        self._pairs += 1

    def _encode(self) -> None:
        """Encode the oldest pair that was set aside."""
        if self._current is None:
            raise RuntimeError("a pair was set aside in a session that is closed")
        self._current.add_pair(self._aside[0][0])
        self._aside.popleft()
        self._pairs += 1

    def _put_reading(self, reading: EncoderReading) -> None:
        if reading.segment != self._segment:
            self._segment = reading.segment
            self._early.clear()
            if self._current is not None and self._current.readings:
                self._close_part()
        if self._current is not None:
            self._readings += self._current.add_reading(reading)
            return
        self._early.append(reading)
        while self._early[0].t_host < reading.t_host - READING_LEAD:
            self._early.popleft()

    def _begin(self, pair: CapturedPair) -> session.SessionWriter:
        started = datetime.now(UTC).replace(microsecond=0)
        local = started.astimezone()
        # mark by mark: strftime takes no other text than UTF-8, and a folder's name may be
        name = re.sub("%[-_0^#]?.", lambda mark: local.strftime(mark[0]), self._name)
        folder = session.new_folder(self._parent, name)
        try:
            part = self._make(folder, self._facts, started, pair)
        except (OSError, InputError):
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self._folders.append(folder)
        while self._early:
            self._readings += part.add_reading(self._early.popleft())
        return part

    def _close_part(self) -> None:
        while self._aside:
            self._encode()
        part, self._current = self._current, None
        if part is not None:
            part.close()
