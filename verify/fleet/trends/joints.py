"""One joint of one arm over time: state, trend, control limits, and outlying sessions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from verify.core.records import Array
from verify.core.statistics import t_isf
from verify.fleet.trends.changes import (
    MIN_BIC_DIFFERENCE,
    MIN_SESSIONS,
    JointTrend,
    TrendChange,
    find_changes,
)
from verify.fleet.trends.series import JointSeries

N_NEIGHBOURS = 3  # sessions on either side that one is held against
MEDIAN_VARIANCE = {1: 1.0, 2: 0.5, 3: 0.449}  # of so many, in that of one (normal)


def find_outliers(series: JointSeries, false_alarm: float) -> NDArray[np.bool_]:
    """Tell which sessions stand apart from both sides, (n,).

    Args:
        series: one joint over time.
        false_alarm: the chance that any is named where all are alike.
    """
    n = len(series)
    apart = np.zeros(n, dtype=bool)
    if n <= N_NEIGHBOURS:
        return apart
    limit = t_isf(false_alarm / n / 2, series.degrees_of_freedom)
    for i in range(n):
        sides = [slice(max(i - N_NEIGHBOURS, 0), i), slice(i + 1, i + 1 + N_NEIGHBOURS)]
        there = [side for side in sides if len(series.t[side])]
        apart[i] = all(_distance(series, i, side) > limit for side in there)
    return apart


def _distance(series: JointSeries, i: int, side: slice) -> float:
    """How far a session lies from the median of its neighbours, in standard uncertainties."""
    share = MEDIAN_VARIANCE[len(series.t[side])]
    variance = series.scatter[i] ** 2 + share * np.max(series.scatter[side]) ** 2
    if np.any(series.group[side] != series.group[i]):
        variance += series.shared[i] ** 2 + np.max(series.shared[side]) ** 2
    return float(abs(series.error[i] - np.median(series.error[side])) / np.sqrt(variance))


MIN_SESSIONS_TO_ASSESS = 2 * MIN_SESSIONS  # sessions, below which nothing is said of changes


@dataclass(frozen=True, slots=True)
class JointAssessment:
    """What a joint's sessions say together."""

    series: JointSeries
    odd: NDArray[np.bool_]  # (n,), sessions that stand apart
    course: JointTrend  # of the others
    ordinary: NDArray[np.int64]  # (m,), the others' places in the series
    half: Array  # (n,), degrees: how far from its place a session lies if nothing changed

    @property
    def state(self) -> str:
        """One word: steady, step, drift, several or change (a step or a drift)."""
        kinds = {change_kind(c) for c in self.course.changes}
        if not kinds:
            return "steady"
        return kinds.pop() if len(self.course.changes) == 1 else "several"

    @property
    def level(self) -> tuple[float, float]:
        """Error now and its standard uncertainty, what calibrations share included, degrees."""
        return float(self.course.fitted[-1]), self.course.level_uncertainty

    @property
    def worse(self) -> bool:
        """Drifting away from zero, at the end."""
        slope, u = self.course.slope, self.course.slope_uncertainty
        return u > 0 and abs(slope) > 2 * u and slope * self.level[0] > 0


def change_kind(change: TrendChange) -> str:
    """Name a change; `change` where the data do not tell a step from a drift."""
    return change.term.kind if change.clearer_by >= MIN_BIC_DIFFERENCE else "change"


def assess_joint(series: JointSeries, false_alarm: float) -> JointAssessment:
    """Judge a joint.

    Args:
        series: `MIN_SESSIONS_TO_ASSESS` sessions or more.
        false_alarm: the chance of a false change, and that of a false odd session.
    """
    odd = find_outliers(series, false_alarm)
    course = find_changes(series.chosen(~odd), false_alarm)
    return JointAssessment(
        series, odd, course, np.flatnonzero(~odd), _control_half_width(series, course, false_alarm)
    )


def _control_half_width(series: JointSeries, course: JointTrend, false_alarm: float) -> Array:
    """Half the distance between the control limits, as wide as each session's uncertainty."""
    z = t_isf(false_alarm / len(series) / 2, series.degrees_of_freedom)
    half: Array = z * np.sqrt(series.scatter**2 + course.reference_uncertainty**2)
    return half


def point_rows(judged: JointAssessment) -> pd.DataFrame:
    """One row a session: error, limits, course; degrees."""
    series = judged.series
    course = judged.course
    shift = np.full(len(series), np.nan)
    fitted = shift.copy()
    shift[judged.ordinary] = course.shift
    shift = pd.Series(shift).ffill().bfill().to_numpy(dtype=float)  # odd ones: their neighbours'
    fitted[judged.ordinary] = course.fitted + course.shift
    reference = course.reference + shift
    return pd.DataFrame(
        {
            "arm": series.arm,
            "joint": series.joint,
            "session": series.session,
            "t_days": series.t,
            "error_deg": series.error,
            "u_deg": series.scatter,
            "fitted_deg": fitted,
            "reference_deg": reference,
            "low_deg": reference - judged.half,
            "high_deg": reference + judged.half,
            "odd": judged.odd,
            "calibration": series.group,
        }
    )


def change_rows(judged: JointAssessment) -> list[dict[str, Any]]:
    """One row a change: kind, date, size."""
    rows = []
    for one in judged.course.changes:
        step = one.term.kind == "step"
        first = judged.ordinary[one.term.place]
        rows.append(
            {
                "arm": judged.series.arm,
                "joint": judged.series.joint,
                "kind": change_kind(one),
                "term": one.term.kind,
                "session": judged.series.session[first],
                "t_days": judged.series.t[first],
                "before_t_days": judged.series.t[judged.ordinary[one.term.place - 1]]
                if step
                else judged.series.t[first],
                "earliest_t_days": judged.series.t[judged.ordinary[one.earliest]],
                "latest_t_days": judged.series.t[judged.ordinary[one.latest]],
                "size": one.size,
                "size_u": one.standard_uncertainty,
                "unit": "deg" if step else "deg/month",
                "clearer_by": one.clearer_by,
                "recalibrated": step and _is_recalibration(judged, one),
            }
        )
    return rows


def _is_recalibration(judged: JointAssessment, one: TrendChange) -> bool:
    """Tell whether a step may fall on a new calibration."""
    group = judged.series.group[judged.ordinary]
    return bool(group[one.earliest - 1] != group[one.latest])
