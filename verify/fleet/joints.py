"""One joint of one arm judged over time: state, course, control limits, odd sessions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from verify.distributions import t_isf
from verify.fleet.changes import CLEARLY, LEAST, Change, Course, follow
from verify.fleet.outlying import outlying
from verify.fleet.series import Series
from verify.records import Array

FEWEST = 2 * LEAST  # sessions, below which nothing is said of changes


@dataclass(frozen=True, slots=True)
class Judged:
    """What a joint's sessions say together."""

    series: Series
    odd: NDArray[np.bool_]  # (n,), sessions that stand apart
    course: Course  # of the others
    ordinary: NDArray[np.int64]  # (m,), the others' places in the series
    half: Array  # (n,), degrees: how far from its place a session lies if nothing changed

    @property
    def state(self) -> str:
        """One word: steady, step, drift, several or change (a step or a drift)."""
        kinds = {kind(c) for c in self.course.changes}
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


def kind(change: Change) -> str:
    """Name a change; `change` where the data do not tell a step from a drift."""
    return change.term.kind if change.clearer_by >= CLEARLY else "change"


def judge(series: Series, false_alarm: float) -> Judged:
    """Judge a joint.

    Args:
        series: `FEWEST` sessions or more.
        false_alarm: the chance of a false change, and that of a false odd session.
    """
    odd = outlying(series, false_alarm)
    course = follow(series.chosen(~odd), false_alarm)
    return Judged(series, odd, course, np.flatnonzero(~odd), _half(series, course, false_alarm))


def _half(series: Series, course: Course, false_alarm: float) -> Array:
    """Half the distance between the control limits, as wide as each session's uncertainty."""
    z = t_isf(false_alarm / len(series) / 2, series.degrees_of_freedom)
    half: Array = z * np.sqrt(series.scatter**2 + course.reference_uncertainty**2)
    return half


def points(judged: Judged) -> pd.DataFrame:
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


def changes(judged: Judged) -> list[dict[str, Any]]:
    """One row a change: kind, date, size."""
    rows = []
    for one in judged.course.changes:
        step = one.term.kind == "step"
        first = judged.ordinary[one.term.place]
        rows.append(
            {
                "arm": judged.series.arm,
                "joint": judged.series.joint,
                "kind": kind(one),
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
                "recalibrated": step and _recalibrated(judged, one),
            }
        )
    return rows


def _recalibrated(judged: Judged, one: Change) -> bool:
    """Tell whether a step may fall on a new calibration."""
    group = judged.series.group[judged.ordinary]
    return bool(group[one.earliest - 1] != group[one.latest])
