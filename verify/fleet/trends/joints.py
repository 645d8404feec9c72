"""One joint of one arm over time: state, trend, control limits, and outlying sessions."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from verify.core.records import Array, Flags, Index
from verify.core.statistics import chi2_isf, t_isf
from verify.fleet.trends import changes
from verify.fleet.trends.series import JointSeries

N_NEIGHBOURS = 3  # sessions on either side that one is held against
MEDIAN_VARIANCE = {1: 1.0, 2: 0.5, 3: 0.449}  # of so many, in that of one (normal)


def find_outliers(series: JointSeries, false_alarm: float) -> Flags:
    """Tell which of a joint's sessions, two or more, stand apart from both sides, (n,).

    `false_alarm` is the chance that any is named where all are alike.
    """
    n = len(series)
    apart = np.zeros(n, dtype=bool)
    limit = t_isf(false_alarm / n / 2, series.degrees_of_freedom)
    for i in range(n):
        sides = [slice(max(i - N_NEIGHBOURS, 0), i), slice(i + 1, i + 1 + N_NEIGHBOURS)]
        away = [_distance(series, i, side) for side in sides if len(series.t[side])]
        if len(away) == 1:  # at an end a drift leads away from all others
            away.append(_distance_from_line(series, i, sides[0] if i else sides[1]))
        apart[i] = min(away) > limit or max(away) < -limit  # between both sides, it is a drift's
    return apart


def _distance(series: JointSeries, i: int, side: slice) -> float:
    """How far a session lies from the median of its neighbours, in standard uncertainties."""
    share = MEDIAN_VARIANCE[len(series.t[side])]
    variance = series.scatter[i] ** 2 + share * np.max(series.scatter[side]) ** 2
    variance += _calibration_variance(series, i, side)
    return float((series.error[i] - np.median(series.error[side])) / np.sqrt(variance))


def _distance_from_line(series: JointSeries, i: int, side: slice) -> float:
    """How far it lies from the line through its neighbours, likewise."""
    lever = series.t[side] - series.t[i]
    if np.ptp(lever) == 0:
        return _distance(series, i, side)
    weight = np.linalg.pinv(np.column_stack([np.ones_like(lever), lever]))[0]
    variance = series.scatter[i] ** 2 + np.sum((weight * series.scatter[side]) ** 2)
    variance += np.sum(weight**2) * _calibration_variance(series, i, side)
    return float((series.error[i] - weight @ series.error[side]) / np.sqrt(variance))


def _calibration_variance(series: JointSeries, i: int, side: slice) -> float:
    if np.all(series.group[side] == series.group[i]):
        return 0.0
    return float(series.shared[i] ** 2 + np.max(series.shared[side]) ** 2)


MIN_UNEXPLAINED = 3.0  # times what is stated: sessions that scatter more are not said to be steady
MIN_SESSIONS_TO_ASSESS = 2 * changes.MIN_SESSIONS  # sessions, below which changes are not assessed


@dataclass(frozen=True, slots=True)
class JointAssessment:
    """What a joint's sessions say together."""

    series: JointSeries
    odd: Flags  # (n,), sessions that stand apart
    course: changes.JointTrend  # of the others
    ordinary: Index  # (m,), the others' places in the series
    half: Array  # (n,), degrees: how far from its place a session lies if nothing changed
    scattered: bool  # far beyond what is stated, and by more than chance

    @property
    def state(self) -> str:
        """One word: steady, scattered, step, drift, several or change (a step or a drift)."""
        kinds = {change_kind(c) for c in self.course.changes}
        if not kinds:
            return "scattered" if self.scattered else "steady"
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


def change_kind(change: changes.TrendChange) -> str:
    """Name a change; `change` where the data do not tell a step from a drift."""
    return change.term.kind if change.clearer_by >= changes.MIN_BIC_DIFFERENCE else "change"


def assess_joint(series: JointSeries, false_alarm: float) -> JointAssessment:
    """Judge a joint by `MIN_SESSIONS_TO_ASSESS` sessions or more.

    `false_alarm` is the chance of a false change, and that of a false odd session.
    """
    odd = find_outliers(series, false_alarm)
    course = changes.find_changes(series.chosen(~odd), false_alarm)
    series = replace(series, excess=course.series.excess, about=course.series.about)
    z = t_isf(false_alarm / len(series) / 2, series.degrees_of_freedom)
    # half the distance between the control limits, as wide as each session's uncertainty
    half = z * np.sqrt(series.scatter**2 + course.reference_uncertainty**2)
    degrees = series.degrees_of_freedom
    scattered = series.excess > MIN_UNEXPLAINED and bool(
        series.excess**2 > chi2_isf(false_alarm, degrees) / degrees
    )
    return JointAssessment(series, odd, course, np.flatnonzero(~odd), half, scattered)


POINT_COLUMNS = [
    "arm", "joint", "session", "t_days", "error_deg", "u_deg", "fitted_deg", "reference_deg",
    "low_deg", "high_deg", "odd", "calibration",
]  # fmt: skip
CHANGE_COLUMNS = [
    "arm", "joint", "kind", "term", "session", "t_days", "before_t_days", "earliest_t_days",
    "latest_t_days", "size", "size_u", "unit", "clearer_by", "recalibrated",
]  # fmt: skip


def point_rows(judged: JointAssessment) -> pd.DataFrame:
    """One row a session, as `POINT_COLUMNS` names them."""
    series, course = judged.series, judged.course
    shift = np.full(len(series), np.nan)
    fitted = shift.copy()
    shift[judged.ordinary] = course.shift
    shift = pd.Series(shift).ffill().bfill().to_numpy(dtype=float)  # odd ones: their neighbours'
    fitted[judged.ordinary] = course.fitted + course.shift
    reference = course.reference + shift
    columns = (
        series.arm, series.joint, series.session, series.t, series.error, series.scatter, fitted,
        reference, reference - judged.half, reference + judged.half, judged.odd, series.group,
    )  # fmt: skip
    return pd.DataFrame(dict(zip(POINT_COLUMNS, columns, strict=True)))


def change_rows(judged: JointAssessment) -> list[tuple[Any, ...]]:
    """One row a change, as `CHANGE_COLUMNS` names them."""
    rows = []
    series, t = judged.series, judged.series.t[judged.ordinary]
    group = series.group[judged.ordinary]
    for one in judged.course.changes:
        step, place = one.term.kind == "step", one.term.place
        rows.append((
            series.arm, series.joint, change_kind(one), one.term.kind,
            series.session[judged.ordinary[place]], t[place], t[place - 1 if step else place],
            t[one.earliest], t[one.latest], one.size, one.standard_uncertainty,
            "deg" if step else "deg/month", one.clearer_by,
            # whether a step may fall on a new calibration
            step and bool(group[one.earliest - 1] != group[one.latest]),
        ))  # fmt: skip
    return rows
