"""Alarms of joint errors: a change, and a tolerance that is exceeded.

CUSUM sums find a change of any size that stands out of the noise, with a stated rate of false
alarms. The tolerance, with a guard band for the instrument's own uncertainty, finds errors that
were there from the beginning or grew slowly.
"""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.comparison import pseudo_inverse
from verify.core.records import Array
from verify.core.statistics import norm_isf
from verify.live.alarms.change_detection import (
    ChangeAttribution,
    Cusum,
    alarm_threshold,
    attribute_change,
)
from verify.live.alarms.innovations import InnovationFilter
from verify.live.joint_row import Evidence, JointRow
from verify.live.protocols import Alarm, format_error_deg

AVERAGING_TIME = 0.5  # s of errors that the tolerance is held against: one pair alone is noise
SETTLING_RATIO = 2  # of these times before the average is believed
RESET_RATIO = 0.9  # of the tolerance: below it the alarm ends, so that it does not flutter


class ToleranceWatch:
    """Holds each joint's error, averaged over half a second, against its tolerance.

    The guard band is z standard uncertainties, everything stated included; z is what leaves an
    error that stands exactly at its tolerance no more false alarms than stated.
    """

    def __init__(
        self,
        tolerance: Array,
        false_alarms_per_hour: float,
        numbers: "itertools.count[int]",
        rate: float,
    ) -> None:
        self._tolerance, self._numbers, self._rate = tolerance, numbers, rate
        looks = 3600.0 / AVERAGING_TIME * len(tolerance)
        self.guard = float(norm_isf(min(false_alarms_per_hour / looks, 0.05)))
        self._standing: dict[int, Alarm] = {}
        self._joints = len(tolerance)
        self.restart()

    def restart(self) -> None:
        """Forget the averages; alarms that stand stay until the error is seen to be back."""
        self._mean = np.zeros(self._joints)
        self._weight = np.zeros(self._joints)  # of a mean that began from nothing
        self._random = np.zeros(self._joints)  # variance of the mean from what varies
        self._systematic = np.zeros(self._joints)
        self._t: float | None = None
        self._duration = 0.0

    def take(self, row: JointRow, evidence: Evidence, inflation: float, now: float) -> list[Alarm]:
        """Watch one row; alarms that are new or have ended."""
        elapsed = 1 / self._rate if self._t is None else row.t - self._t
        self._t = row.t
        self._duration += elapsed
        self._average(row, evidence, 1.0 - math.exp(-elapsed / AVERAGING_TIME), inflation)
        if self._duration < SETTLING_RATIO * AVERAGING_TIME:
            return []
        mean = np.divide(
            self._mean, self._weight, out=np.zeros(self._joints), where=self._weight > 0
        )
        determined = self._weight > 0.5  # most of the average is of this joint
        doubt = np.sqrt(self._random / np.maximum(self._weight, 1e-9) ** 2 + self._systematic)
        alarms = []
        for j in np.flatnonzero(determined).tolist():
            over = abs(mean[j]) - self.guard * doubt[j] > self._tolerance[j]
            back = abs(mean[j]) < RESET_RATIO * self._tolerance[j]
            if over and j not in self._standing:
                self._standing[j] = self._raised(j, float(mean[j]), float(doubt[j]), row, now)
                alarms.append(self._standing[j])
            elif back and j in self._standing:
                alarms.append(replace(self._standing.pop(j), ended=now))
        return alarms

    def _average(self, row: JointRow, evidence: Evidence, share: float, inflation: float) -> None:
        valid = ~np.isnan(row.single) & ~np.isnan(row.uncertainty)
        inverse = pseudo_inverse(evidence.jacobian)
        spread = evidence.noise + evidence.alignment
        random = np.einsum("ij,jk,ik->i", inverse, spread, inverse) * inflation
        whole = np.where(valid, np.nan_to_num(row.uncertainty) ** 2, 0.0)
        systematic = np.maximum(whole - random / inflation, 0.0)
        keep = 1.0 - share
        self._mean = keep * self._mean + share * np.where(valid, np.nan_to_num(row.single), 0.0)
        self._weight = keep * self._weight + share * valid
        self._random = keep**2 * self._random + share**2 * np.where(valid, random, 0.0)
        self._systematic = np.where(valid, systematic, self._systematic)

    def _raised(self, j: int, mean: float, doubt: float, row: JointRow, now: float) -> Alarm:
        text = (  # an average: while the error still grows, it lags
            f"Joint {j + 1} reads {format_error_deg(mean, doubt)} off, averaged over "
            f"{AVERAGING_TIME:g} s, beyond its tolerance of {math.degrees(self._tolerance[j]):g}°."
        )
        return Alarm(next(self._numbers), "tolerance", now, row.t, text, (j + 1,), mean, doubt)


MAX_ONSET_PAIRS = 30  # pairs after which the sum of an initial fault has left zero
REVIEW_PAIRS = (2, 5, 12, 30)  # pairs after an alarm, which may tell its rivals apart
REPEAT_TIME = 60.0  # s for which it is not said again that no joint alone explains the readings
MAX_PAUSE = 2.0  # s without pairs after which sums and averages begin anew


@dataclass(frozen=True, slots=True)
class AlarmLimits:
    """When an alarm is raised."""

    false_alarms_per_hour: float
    rate: float  # pairs a second
    tolerance: Array | None  # (j,), rad


class JointAlarms:
    """Watches the joints' errors, pair by pair."""

    def __init__(self, joints: int, limits: AlarmLimits, numbers: "itertools.count[int]") -> None:
        self._numbers = numbers
        self._innovations = InnovationFilter(joints)
        # half of the false alarms are the sums' to spend, half the tolerance's
        share = limits.false_alarms_per_hour / (1 if limits.tolerance is None else 2)
        self._cusum = Cusum(joints, alarm_threshold(share, limits.rate, joints))
        self._joints = joints
        self._change: ChangeAttribution | None = None
        self._alarm: Alarm | None = None
        self._from_start = False
        self._followed = self._begun = 0
        self._quiet_until = -math.inf
        self._changed = False
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
        """Watch one row at `now`, s since the epoch; alarms that are new, revised, or ended."""
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
            alarms += self._tolerance.take(
                row, row.evidence, float(np.max(self._innovations.factors)), now
            )
        return alarms

    def _changes(self, row: JointRow, now: float) -> list[Alarm]:
        """A change that is new; once more when the pairs that follow tell more; then done."""
        if self._change is None:
            if not self._cusum.exceeded:
                return []
            early = self._cusum.count - self._cusum.begun < MAX_ONSET_PAIRS
            self._from_start = early and not self._changed
            self._begun = self._cusum.begun
            change = self._attribute()
            if not change.alone and row.t < self._quiet_until:
                self._accept(change)
                return []
            return [self._tell(change, row, now)]
        self._followed += 1
        self._begun += 1
        if self._followed not in REVIEW_PAIRS:
            return []
        before, change = self._change, self._attribute()
        alarm = self._tell(change, row, now)
        last = self._followed == REVIEW_PAIRS[-1]
        if last:
            self._accept(change)
            self._quiet_until = -math.inf if change.alone else row.t + REPEAT_TIME
        named_anew = alarm.joints != tuple(j + 1 for j in (before.joint, *before.rivals))
        return [alarm] if last or named_anew else []

    def _attribute(self) -> ChangeAttribution:
        self._change = attribute_change(self._innovations, self._joints, self._begun)
        return self._change

    def _accept(self, change: ChangeAttribution) -> None:
        """Take the change for known, and look out for the next one."""
        self._innovations.accept((change.joint, *change.rivals), change.pairs)
        self._restart()
        self._changed = True

    def _restart(self) -> None:
        self._cusum.restart()
        self._changed = False  # since it began anew
        self._change, self._alarm = None, None
        self._followed = self._begun = 0

    def _tell(self, change: ChangeAttribution, row: JointRow, now: float) -> Alarm:
        """Word a change: a new alarm, or the one told, revised."""
        joints = tuple(j + 1 for j in (change.joint, *change.rivals))
        size = format_error_deg(change.size, change.standard_uncertainty)
        if not change.alone:
            text = (
                "The readings do not follow the motion in the pictures, and no joint explains it "
                f"alone, joint {joints[0]} most: check that they are this arm's, and the clock"
            )
        elif not change.constant:
            text = f"Joint {joints[0]} reads off the measured angle by an error that varies"
        elif self._from_start:
            text = f"Joint {joints[0]} reads {size} off the measured angle, from the beginning"
        else:
            text = (
                f"The reading of joint {joints[0]} has changed by {size} against the measured angle"
            )
        if change.rivals and change.alone:
            others = " or ".join(str(j) for j in joints[1:])
            text += f"; not separable from joint {others}"
        self._alarm = replace(
            self._alarm or Alarm(next(self._numbers), "change", now, row.t, ""),
            text=text + ".",
            joints=joints,
            error=change.size if change.constant else None,
            standard_uncertainty=change.standard_uncertainty if change.constant else None,
            revised=self._alarm is not None,
        )
        return self._alarm

    def _begin_anew_after_a_break(self, row: JointRow) -> None:
        segment = row.clock.segment if row.clock is not None else None
        paused = self._last is not None and row.t - self._last > MAX_PAUSE
        if paused or segment != self._segment:
            self._restart()
            if self._tolerance is not None:
                self._tolerance.restart()
        if segment != self._segment and self._segment is not None:
            self._innovations.reset()
        self._segment, self._last = segment, row.t
