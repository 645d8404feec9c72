"""How long results take, as percentiles over the last while."""

from collections import deque
from dataclasses import dataclass

import numpy as np

KEPT = 1800  # results: a minute at 30 pairs a second


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Of the last while, s; None before the first result."""

    p50: float | None
    p99: float | None


class Latency:
    """Collects how long each result took."""

    def __init__(self) -> None:
        self._values: deque[float] = deque(maxlen=KEPT)

    def add(self, seconds: float) -> None:
        """Take one."""
        self._values.append(seconds)

    def percentiles(self) -> Percentiles:
        """Say how long they take."""
        values = list(self._values)
        if not values:
            return Percentiles(None, None)
        p50, p99 = np.percentile(values, [50, 99]).tolist()
        return Percentiles(p50, p99)
