"""One joint of one arm over time: state, trend, control limits, and outlying sessions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from verify.core.records import Array
from verify.core.statistics import chi2_isf, t_isf
from verify.fleet.trends import changes
from verify.fleet.trends.series import JointSeries

MIN_UNEXPLAINED = 3.0  # times what is stated: sessions that scatter more are not said to be steady
MIN_SESSIONS_TO_ASSESS = 2 * changes.MIN_SESSIONS  # sessions, below which changes are not assessed


@dataclass(frozen=True, slots=True)
class JointAssessment:
    """What a joint's sessions say together."""

    course: changes.JointTrend
    half: Array  # (n,), degrees: how far from its place a session lies if nothing changed
    scattered: bool  # far beyond what is stated, and by more than chance

    @property
    def state(self) -> str:
        """One word: steady, scattered, unclear, step, drift, several, change (step or drift)."""
        kinds = {change_kind(c) for c in self.course.changes}
        if not kinds:
            quiet = "unclear" if self.course.unclear else "steady"
            return "scattered" if self.scattered else quiet
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

    `false_alarm` is the chance of a false change or odd session.
    """
    course = changes.find_changes(series, false_alarm)
    series = course.series
    z = t_isf(false_alarm / len(series) / 2, series.degrees_of_freedom)
    # half the distance between the control limits, as wide as each session's uncertainty
    half = z * np.sqrt(series.scatter**2 + course.reference_uncertainty**2)
    degrees = series.degrees_of_freedom
    scattered = series.excess > MIN_UNEXPLAINED and bool(
        series.excess**2 > chi2_isf(false_alarm, degrees) / degrees
    )
    return JointAssessment(course, half, scattered)


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
    course, series = judged.course, judged.course.series
    fitted = np.where(course.odd, np.nan, course.fitted + course.shift)
    reference = course.reference + course.shift
    columns = (
        series.arm, series.joint, series.session, series.t, series.error, series.scatter, fitted,
        reference, reference - judged.half, reference + judged.half, course.odd, series.group,
    )  # fmt: skip
    return pd.DataFrame(dict(zip(POINT_COLUMNS, columns, strict=True)))


def change_rows(judged: JointAssessment) -> list[tuple[Any, ...]]:
    """One row a change, as `CHANGE_COLUMNS` names them."""
    rows = []
    series = judged.course.series
    t, group = series.t, series.group
    for one in judged.course.changes:
        step, place = one.term.kind == "step", one.term.place
        rows.append((
            series.arm, series.joint, change_kind(one), one.term.kind,
            series.session[place], t[place], t[place - 1 if step else place],
            t[one.earliest], t[one.latest], one.size, one.standard_uncertainty,
            "deg" if step else "deg/month", one.clearer_by,
            # whether a step may fall on a new calibration
            step and bool(group[one.earliest - 1] != group[one.latest]),
        ))  # fmt: skip
    return rows
