"""Alarms when no pair is measured for a while, most fit no pose, or a device gives nothing."""

import itertools
import math
from collections import Counter, defaultdict, deque
from dataclasses import replace
from itertools import pairwise
from statistics import median

from verify.live.joint_row import JointRow
from verify.live.protocols import Alarm

LOSS_TIMEOUT = 1.0  # s without a measured pair
MAX_FITS, MIN_FITS = 30, 10  # pairs with spots: the latest ones, and how few show that most misfit
BEGIN_SHARE, END_SHARE = 1 / 2, 2 / 3  # of them that fit a pose: fewer, and so many again


class TargetWatch:
    """Raises an alarm when no pair was measured for `lost_after` s, or most misfit; says why.

    `misfit`: most pairs fit no pose. Then those that fit one do by chance: their errors are wrong.
    """

    def __init__(self, lost_after: float, numbers: "itertools.count[int]") -> None:
        self._after, self._numbers, self._measured_at = lost_after, numbers, math.inf
        self._why: Counter[str] = Counter()
        self._standing: Alarm | None = None
        self._fits: deque[bool] = deque(maxlen=MAX_FITS)
        self.misfit = False

    def take(self, row: JointRow, t: float, now: float) -> list[Alarm]:
        """Watch one row; t is the host's monotonic clock, now s since the epoch."""
        measured = row.status == "measured"
        if measured or row.status in MISFITS:
            self._fits.append(measured)
        fits, count, before = sum(self._fits), len(self._fits), self.misfit
        least = (END_SHARE if before else BEGIN_SHARE) * count
        self.misfit = count >= MIN_FITS and fits < least
        if self.misfit and not before:
            alarm = self._standing or Alarm(next(self._numbers), "target", now, t, "")
            text = f"{count - fits} of the last {count} pairs fit no pose: {MISFIT_TEXT}"
            self._standing = replace(alarm, text=text, revised=self._standing is not None)
            return [self._standing]
        if not measured:
            self._why[row.status] += 1
            return self.look(t, now)
        self._measured_at = t
        self._why.clear()
        if self._standing is None or self.misfit:
            return []
        ended, self._standing = replace(self._standing, ended=now), None
        return [ended]

    def look(self, t: float, now: float) -> list[Alarm]:
        """Look without a row: where no pairs come there is no target either."""
        self._measured_at = min(self._measured_at, t)  # it begins with the first look
        if self._standing is not None or t - self._measured_at <= self._after:
            return []
        why = STATUS_TEXTS.get(self._why.most_common(1)[0][0], "") if self._why else NO_PAIRS
        spent = f"{t - self._measured_at:.1f} s"
        text = f"The robot has not been compared with its encoders for {spent}: {why}."
        self._standing = Alarm(next(self._numbers), "target", now, t, text)
        return [self._standing]


MISFITS = {"outlier", "ambiguous_leds"}
MISFIT_TEXT = (
    "joint errors are not judged. Probably LEDs are not where marker.toml has them; else a camera "
    "or an LED was moved, or there are lamps. End the watch: its report looks for the cause, and "
    "finds LEDs that are some millimetres off. Then measure their places again."
)
NO_PAIRS = "no pairs of pictures arrive"
STATUS_TEXTS = {
    "too_few_leds": "too few LEDs are visible",
    "ambiguous_leds": "the LEDs are not identified",
    "outlier": "no pose explains the detected spots",
    "unaligned": "the two pictures cannot be aligned in time",
    "no_encoder": "no encoder readings arrive",
    "unreachable": "the arm can reach none of the measured poses",
}


MISSED_PERIODS = 2.0  # of a device that gives less often than it may be silent
N_ARRIVALS = 8  # kept, to know a device's period by
TOL_ARRIVAL = 0.02  # s: the same arrival, told by its age at two instants


class DeviceWatch:
    """Raises an alarm for each device that gives nothing for `lost_after` s.

    A device that regularly gives less often than that is waited for longer, from its second
    reading on.
    """

    def __init__(self, lost_after: float, numbers: "itertools.count[int]") -> None:
        self._after, self._numbers, self._start = lost_after, numbers, math.inf
        self._standing: dict[str, Alarm] = {}
        self._arrivals: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=N_ARRIVALS))

    def take(
        self, device: str, age: float | None, sentence: str, t: float, now: float
    ) -> list[Alarm]:
        """Watch one device, which last gave something `age` s ago (None: never yet).

        `t` is the host's monotonic clock, s; `now` s since the epoch.
        """
        self._start = min(self._start, t)  # it begins with the first look
        silent = t - self._start if age is None else age
        arrivals, standing = self._arrivals[device], self._standing.get(device)
        if age is not None and (not arrivals or t - age > arrivals[-1] + TOL_ARRIVAL):
            arrivals.append(t - age)
        if silent > self.timeout(device) and standing is None:
            text = f"Nothing has come from the {device} for {silent:.1f} s: {sentence.rstrip('.')}."
            alarm = Alarm(next(self._numbers), "device", now, t, text, device=device)
            self._standing[device] = alarm
            return [alarm]
        if silent <= self.timeout(device) and standing is not None:
            return [replace(self._standing.pop(device), ended=now)]
        return []

    def timeout(self, device: str) -> float:
        """How long a device may give nothing, s."""
        periods = [later - earlier for earlier, later in pairwise(self._arrivals[device])]
        return max(self._after, MISSED_PERIODS * median(periods)) if periods else self._after
