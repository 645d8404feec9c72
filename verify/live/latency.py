"""How long results take, as percentiles: of the last while, and of the whole run."""

from collections import deque
from dataclasses import dataclass

import numpy as np

KEPT = 1800  # results: a minute at 30 pairs a second
BIN, BINS = 1e-4, 20_000  # s, and how many: what took longer than 2 s counts as that


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Half and 99 of 100 results take so long at most, s; None before the first result."""

    p50: float | None
    p99: float | None


class Latency:
    """Collects how long each result took."""

    def __init__(self) -> None:
        self._values: deque[float] = deque(maxlen=KEPT)
        self._counts = np.zeros(BINS, dtype=np.int64)  # a whole run's memory must not grow

    def add(self, seconds: float) -> None:
        """Take one."""
        self._values.append(seconds)
        self._counts[min(max(int(seconds / BIN), 0), BINS - 1)] += 1

    def percentiles(self) -> Percentiles:
        """Say how long they took in the last while."""
        values = list(self._values)
        if not values:
            return Percentiles(None, None)
        p50, p99 = np.percentile(values, [50, 99]).tolist()
        return Percentiles(p50, p99)

    def of_all(self) -> Percentiles:
        """Say how long they took in the whole run, to a tenth of a millisecond."""
        until = np.cumsum(self._counts)
        if not until[-1]:
            return Percentiles(None, None)
        p50, p99 = ((int(np.searchsorted(until, q * until[-1])) + 1) * BIN for q in (0.5, 0.99))
        return Percentiles(p50, p99)
