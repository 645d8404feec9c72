"""The time of simulated devices: the host's clock, or a multiple of it."""

import time
from collections.abc import Callable


class SimClock:
    """Runs `speed` times as fast as the host's monotonic clock, and agrees with it at the start.

    Args:
        speed: times real time.
        now: the host's monotonic clock, s.
        sleep: waits for so many s.
    """

    def __init__(
        self,
        speed: float = 1.0,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._speed, self._now, self._sleep = speed, now, sleep
        self.began = now()

    def now(self) -> float:
        """The simulated instant, s."""
        return self.began + (self._now() - self.began) * self._speed

    def wait_until(self, t: float, limit: float) -> bool:
        """Wait for a simulated instant, for at most `limit` s of the host's; whether it is there.

        The limit is the host's time because it is the caller's patience.
        """
        rest = (t - self.now()) / self._speed
        if rest > 0:
            self._sleep(min(rest, limit))
        return rest <= limit
