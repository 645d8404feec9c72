"""How far a batch has come: sessions, pairs a second, time left, failures so far."""

import time
from dataclasses import dataclass, field

from verify.batch.records import Failure


@dataclass(slots=True)
class Progress:
    """Counts; `watch` is told after each change."""

    sessions: int  # that were found
    kept: int = 0  # from an earlier batch
    again: list[str] = field(default_factory=list)  # measured again: their inputs have changed
    measured: int = 0
    pairs: int = 0  # measured now
    failures: list[Failure] = field(default_factory=list)
    begun: float = field(default_factory=time.monotonic)  # s

    def begin(self) -> None:
        """Count time from now on: what was loaded before says nothing of what is to come."""
        self.begun = time.monotonic()

    @property
    def done(self) -> int:
        """Sessions of which nothing more is to come."""
        return self.kept + self.measured + len(self.failures)

    @property
    def pairs_a_second(self) -> float | None:
        """Pairs a second since work began; None before the first."""
        spent = time.monotonic() - self.begun
        return self.pairs / spent if self.pairs and spent > 0 else None

    @property
    def time_left(self) -> float | None:
        """Seconds until the last session, if the rest is like those measured now."""
        worked = self.measured + len(self.failures)
        if not worked:
            return None
        return (time.monotonic() - self.begun) / worked * (self.sessions - self.done)
