"""Plain lines, where there is no terminal to draw a table on: alarms, and how it goes."""

from collections.abc import Callable

import numpy as np

from verify.live.alarms import Alarm
from verify.live.joint_row import JointRow
from verify.records import Array

EVERY = 10.0  # s


class PlainLines:
    """Says alarms as they come, and the joint errors every ten seconds.

    Args:
        say: writes a line.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._due = float("-inf")

    def row(self, row: JointRow, statistic: Array) -> None:
        """Say one row in a while; `statistic` is for those who draw."""
        del statistic
        if row.t < self._due:
            return
        self._due = row.t + EVERY
        if row.status != "measured":
            self._say(f"pair {row.frame}: {row.status.replace('_', ' ')}")
            return
        errors = " ".join(
            f"{e:+.3f}" if np.isfinite(e) else "–" for e in np.rad2deg(row.error).tolist()
        )
        clock = "" if row.clock is None else f"; clock {row.clock.words()}"
        self._say(f"pair {row.frame}: joint errors {errors} deg{clock}")

    def alarm(self, alarm: Alarm) -> None:
        """Say an alarm, also when it is over."""
        over = "" if alarm.ended is None else " Over."
        self._say(f"ALARM {alarm.number}: {alarm.text}{over}")

    def close(self) -> None:
        """Nothing to end."""
