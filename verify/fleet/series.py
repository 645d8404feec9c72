"""One joint over time: its mean error in each session, and how well each is known."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from verify.records import Array

DAY = 86_400.0  # s
MONTH = 365.25 / 12  # days
ENOUGH = 5  # sessions from which the scatter between them is looked at
NORMAL_MEDIAN = 0.6745  # of |z|
EFFICIENCY = 0.25  # of the scatter's estimate: a median (0.37) of successive differences (2/3)


@dataclass(frozen=True, slots=True)
class Series:
    """One joint of one arm, n sessions in order of time; degrees, as in the tables."""

    arm: str
    joint: int
    session: tuple[str, ...]
    t: Array  # (n,), days since 1970
    error: Array  # (n,), mean error
    own: Array  # (n,), standard uncertainty that every session draws anew, as stated
    shared: Array  # (n,), standard uncertainty that sessions of one calibration share
    group: NDArray[np.int64]  # (n,), sessions with the same number share a calibration
    excess: float = 1.0  # factor on `own`: how far the sessions scatter beyond it

    def __len__(self) -> int:
        """Count the sessions."""
        return len(self.t)

    @property
    def scatter(self) -> Array:
        """Standard deviation of each session against its neighbours, (n,)."""
        return self.excess * self.own

    @property
    def degrees_of_freedom(self) -> float:
        """Of `scatter`: infinite where the stated uncertainties explain it."""
        return np.inf if self.excess == 1.0 else max(EFFICIENCY * len(self), 1.0)

    def chosen(self, which: NDArray[np.bool_]) -> "Series":
        """Some of the sessions."""
        return Series(
            self.arm,
            self.joint,
            tuple(np.array(self.session, dtype=object)[which].tolist()),
            self.t[which],
            self.error[which],
            self.own[which],
            self.shared[which],
            self.group[which],
            self.excess,
        )


def series_of(sessions: pd.DataFrame, arm: str, joint: int) -> Series:
    """Take one joint's series from an arm's dated sessions; those without a figure are left out.

    Args:
        sessions: the arm's rows of sessions.parquet.
        arm: its name.
        joint: from 1.
    """
    name = f"q{joint}"
    known = sessions["started"].notna() & sessions[f"{name}_mean_error_deg"].notna()
    known &= sessions[f"{name}_standard_uncertainty_deg"].fillna(0) > 0
    rows = sessions[known].sort_values(["started", "session"], kind="stable")
    full = _numbers(rows, f"{name}_standard_uncertainty_deg")
    own = np.fmin(_numbers(rows, f"{name}_session_uncertainty_deg"), full)
    own = np.where(own > 0, own, full)  # not told apart: all of it may differ between sessions
    found = Series(
        arm=arm,
        joint=joint,
        session=tuple(rows["session"]),
        t=_days(rows),
        error=_numbers(rows, f"{name}_mean_error_deg"),
        own=own,
        shared=np.sqrt(np.maximum(full**2 - own**2, 0.0)),
        group=pd.factorize(rows["calibration"])[0].astype(np.int64),
    )
    return _with_excess(found)


def _with_excess(series: Series) -> Series:
    """Look whether sessions scatter beyond what they state, by how neighbours in time differ."""
    if len(series) < ENOUGH:
        return series
    variance = series.own**2
    other = np.diff(series.group) != 0
    between = np.where(other, series.shared[1:] ** 2 + series.shared[:-1] ** 2, 0.0)
    step = np.diff(series.error) / np.sqrt(variance[1:] + variance[:-1] + between)
    factor = float(np.median(np.abs(step))) / NORMAL_MEDIAN
    if factor <= 1.0:
        return series
    parts = {name: getattr(series, name) for name in Series.__slots__}
    return Series(**parts | {"excess": factor})


def _numbers(rows: pd.DataFrame, name: str) -> Array:
    values: Array = rows[name].to_numpy(dtype=float, na_value=np.nan)
    return values


def _days(rows: pd.DataFrame) -> Array:
    since = rows["started"] - pd.Timestamp(0, tz="UTC")
    return np.asarray(since.dt.total_seconds(), dtype=np.float64) / DAY
