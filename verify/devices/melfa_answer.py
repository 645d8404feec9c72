"""Where an answer of a MELFA controller ends: CR, CR LF, NUL, or nothing but silence."""

import re
from dataclasses import dataclass

from verify.devices.lines import LONGEST
from verify.devices.link import Chunk

QUIET = 0.05  # s without a byte: an answer that has no end mark is over
_END = re.compile(rb"[\r\n\0]")


@dataclass(frozen=True, slots=True)
class Answered:
    """One answer, whole or not, and when it was in hand."""

    data: bytes
    t: float  # s, host's monotonic clock


class AnswerBuffer:
    """Collects bytes until an answer has come."""

    def __init__(self) -> None:
        self._data = b""
        self._t = 0.0

    @property
    def empty(self) -> bool:
        """Whether nothing is left over."""
        return not self._data.strip(b"\r\n\0")

    def clear(self) -> None:
        """Forget what has come."""
        self._data = b""

    def feed(self, chunk: Chunk | None, now: float) -> Answered | None:
        """Add bytes, or none; get the answer once it is over."""
        if chunk is not None:
            self._data = (self._data + chunk.data).lstrip(b"\r\n\0")[-LONGEST:]
            self._t = chunk.t
        end = _END.search(self._data)
        if end is not None:
            answer, self._data = self._data[: end.start()], self._data[end.end() :]
        elif self._data and now - self._t > QUIET:
            answer, self._data = self._data, b""
        else:
            return None
        return Answered(answer, self._t)
