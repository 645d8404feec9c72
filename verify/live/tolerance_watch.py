"""The plain tolerance, with a guard band for what the instrument itself leaves in doubt."""

import itertools
import math
from dataclasses import replace

import numpy as np

from verify.distributions import norm_isf
from verify.live.alarms import Alarm, in_degrees
from verify.live.joint_row import JointRow
from verify.records import Array

AVERAGED = 0.5  # s of errors that the tolerance is held against: one pair alone is noise
SETTLED = 2  # of these times before the average is believed
RETURN = 0.9  # of the tolerance: below it the alarm ends, so that it does not flutter


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
        looks = 3600.0 / AVERAGED * len(tolerance)
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
        self._seen = 0.0

    def take(self, row: JointRow, inflation: float, now: float) -> list[Alarm]:
        """Watch one row; alarms that are new or have ended."""
        elapsed = 1 / self._rate if self._t is None else row.t - self._t
        self._t = row.t
        self._seen += elapsed
        self._average(row, 1.0 - math.exp(-elapsed / AVERAGED), inflation)
        if self._seen < SETTLED * AVERAGED:
            return []
        mean = np.divide(
            self._mean, self._weight, out=np.zeros(self._joints), where=self._weight > 0
        )
        known = self._weight > 0.5  # most of the average is of this joint
        doubt = np.sqrt(self._random / np.maximum(self._weight, 1e-9) ** 2 + self._systematic)
        alarms = []
        for j in np.flatnonzero(known).tolist():
            over = abs(mean[j]) - self.guard * doubt[j] > self._tolerance[j]
            back = abs(mean[j]) < RETURN * self._tolerance[j]
            if over and j not in self._standing:
                self._standing[j] = self._raised(j, float(mean[j]), float(doubt[j]), row, now)
                alarms.append(self._standing[j])
            elif back and j in self._standing:
                alarms.append(replace(self._standing.pop(j), ended=now))
        return alarms

    def _average(self, row: JointRow, share: float, inflation: float) -> None:
        told = ~np.isnan(row.single) & ~np.isnan(row.uncertainty)
        evidence = row.evidence
        if evidence is None:
            return
        inverse = np.linalg.pinv(evidence.jacobian, rcond=1e-9)
        spread = evidence.noise + evidence.alignment
        random = np.einsum("ij,jk,ik->i", inverse, spread, inverse) * inflation
        whole = np.where(told, np.nan_to_num(row.uncertainty) ** 2, 0.0)
        systematic = np.maximum(whole - random / inflation, 0.0)
        keep = 1.0 - share
        self._mean = keep * self._mean + share * np.where(told, np.nan_to_num(row.single), 0.0)
        self._weight = keep * self._weight + share * told
        self._random = keep**2 * self._random + share**2 * np.where(told, random, 0.0)
        self._systematic = np.where(told, systematic, self._systematic)

    def _raised(self, j: int, mean: float, doubt: float, row: JointRow, now: float) -> Alarm:
        text = (
            f"Joint {j + 1} reads {in_degrees(mean, doubt)} off, "
            f"beyond its tolerance of {math.degrees(self._tolerance[j]):g}°."
        )
        return Alarm(next(self._numbers), "tolerance", now, row.t, text, (j + 1,), mean, doubt)
