"""Joint errors that deserve a person's attention: a change, and a tolerance that is exceeded.

CUSUM sums find a change of any size that stands out of the noise, with a stated rate of false
alarms. Beside them stands the plain tolerance with a guard band, for errors that were there from
the beginning or grew slowly.
"""

import itertools
from dataclasses import dataclass

from verify.live.alarms import Alarm, in_degrees
from verify.live.attribution import Change, attribute
from verify.live.cusum import Cusum, threshold
from verify.live.innovations import Innovations
from verify.live.joint_row import JointRow
from verify.live.tolerance_watch import ToleranceWatch
from verify.records import Array

LOST_AFTER = 1.0  # s without a measured pair
SOON = 30  # pairs: the sum of a fault that was there from the beginning has left zero by then
LOOKED_AGAIN = (2, 5, 12, 30)  # pairs after an alarm, which may tell its rivals apart
PAUSE = 2.0  # s without pairs after which sums and averages begin anew


@dataclass(frozen=True, slots=True)
class AlarmLimits:
    """When an alarm is raised."""

    false_alarms_per_hour: float
    rate: float  # pairs a second
    tolerance: Array | None  # (j,), rad
    lost_after: float = LOST_AFTER  # s


class JointAlarms:
    """Watches the joints' errors, pair by pair.

    Args:
        joints: how many.
        limits: when to raise an alarm.
        numbers: where alarms get their numbers from.
    """

    def __init__(self, joints: int, limits: AlarmLimits, numbers: "itertools.count[int]") -> None:
        self._limits, self._numbers = limits, numbers
        self._innovations = Innovations(joints)
        # half of the false alarms are the sums' to spend, half the tolerance's
        share = limits.false_alarms_per_hour / (1 if limits.tolerance is None else 2)
        self._cusum = Cusum(joints, threshold(share, limits.rate, joints))
        self._joints = joints
        self._told: Change | None = None
        self._alarm: Alarm | None = None
        self._from_start = False
        self._followed = self._begun = 0
        self._tolerance = (
            None
            if limits.tolerance is None
            else ToleranceWatch(limits.tolerance, share, numbers, limits.rate)
        )
        self._last: float | None = None
        self._segment: int | None = None

    @property
    def statistic(self) -> Array:
        """Each joint's sum as a share of what raises an alarm, (j,)."""
        share: Array = self._cusum.sums.max(axis=0) / self._cusum.limit
        return share

    def take(self, row: JointRow, now: float) -> list[Alarm]:
        """Watch one row.

        Args:
            row: the pair's outcome.
            now: s since the epoch.

        Returns:
            Alarms that are new, revised, or ended with it.
        """
        if row.evidence is None or row.clock is None:
            return []
        self._begin_anew_after_a_break(row)
        alarms: list[Alarm] = []
        clock = (row.clock.segment, row.clock.source, row.clock.version)
        innovation = self._innovations.take(row.t, row.evidence, clock)
        if innovation is not None:
            self._cusum.take(innovation)
            alarms += self._changes(row, now)
        if self._tolerance is not None:
            alarms += self._tolerance.take(row, self._innovations.inflation, now)
        return alarms

    def _changes(self, row: JointRow, now: float) -> list[Alarm]:
        """A change that is new; once more when the pairs that follow tell more; then done."""
        if self._told is None:
            if not self._cusum.exceeded:
                return []
            self._from_start = self._cusum.count - self._cusum.begun < SOON
            self._begun = self._cusum.begun
            return [self._tell(row, now)]
        self._followed += 1
        self._begun += 1
        if self._followed not in LOOKED_AGAIN:
            return []
        before = self._told
        alarm = self._tell(row, now)
        last = self._followed == LOOKED_AGAIN[-1]
        if last:
            change = self._told
            self._innovations.accept((change.joint, *change.rivals), change.pairs)
            self._restart()
        named_anew = alarm.joints != tuple(j + 1 for j in (before.joint, *before.rivals))
        return [alarm] if last or named_anew else []

    def _restart(self) -> None:
        self._cusum.restart()
        self._told, self._alarm = None, None
        self._followed = self._begun = 0

    def _tell(self, row: JointRow, now: float) -> Alarm:
        self._told = attribute(self._innovations, self._joints, self._begun)
        self._alarm = self._worded(self._told, row, now)
        return self._alarm

    def _begin_anew_after_a_break(self, row: JointRow) -> None:
        segment = row.clock.segment if row.clock is not None else None
        paused = self._last is not None and row.t - self._last > PAUSE
        if paused or segment != self._segment:
            self._restart()
            if self._tolerance is not None:
                self._tolerance.restart()
        if segment != self._segment and self._segment is not None:
            self._innovations.reset()
        self._segment, self._last = segment, row.t

    def _worded(self, change: Change, row: JointRow, now: float) -> Alarm:
        joints = tuple(j + 1 for j in (change.joint, *change.rivals))
        size = in_degrees(change.size, change.standard_uncertainty)
        if self._from_start:
            text = f"Joint {joints[0]} reads {size} off what is seen, from the beginning"
        else:
            text = f"The reading of joint {joints[0]} has changed by {size} against what is seen"
        if change.rivals:
            others = " or ".join(str(j) for j in joints[1:])
            text += f"; not told apart from joint {others}"
        first = self._alarm
        return Alarm(
            number=next(self._numbers) if first is None else first.number,
            kind="change",
            began=now if first is None else first.began,
            t=row.t,
            text=text + ".",
            joints=joints,
            error=change.size,
            standard_uncertainty=change.standard_uncertainty,
            revised=first is not None,
        )
