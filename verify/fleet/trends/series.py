"""The mean errors of one joint over time, with generalised least squares for shared calibrations.

V = diag(scatter²) + one block a calibration, shared² in every place: an error of the rig moves all
its sessions alike. Each block is a diagonal plus a rank of one, so V⁻¹ is applied in one pass.

Source: Sherman and Morrison, Annals of Mathematical Statistics 21(1), 1950.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
import pandas as pd

from verify.core.records import Array, Flags, Index
from verify.core.statistics import norm_isf, t_isf

SECONDS_PER_DAY = 86_400.0  # s
DAYS_PER_MONTH = 365.25 / 12  # days
MIN_SESSIONS_FOR_SCATTER = 5  # sessions from which the scatter between them is looked at
NORMAL_MEDIAN = 0.6745  # of |z|
_BY_SESSION = ("t", "error", "own", "shared", "group")  # arrays of a series


@dataclass(frozen=True, slots=True)
class JointSeries:
    """One joint of one arm, n sessions in order of time; degrees, as in the tables."""

    arm: str
    joint: int
    session: tuple[str, ...]
    t: Array  # (n,), days since 1970
    error: Array  # (n,), mean error
    own: Array  # (n,), standard uncertainty that every session draws anew, as stated
    shared: Array  # (n,), standard uncertainty that sessions of one calibration share
    group: Index  # (n,), sessions with the same number share a calibration
    excess: float = 1.0  # factor on `own`: how far the sessions scatter beyond it
    about: int = 0  # coefficients of the level about which that was found; 0: of neighbours

    def __len__(self) -> int:
        """Count the sessions."""
        return len(self.t)

    @property
    def scatter(self) -> Array:
        """Standard deviation of each session against its neighbours, (n,)."""
        return self.excess * self.own

    @property
    def degrees_of_freedom(self) -> float:
        """Of `scatter`: infinite where it is as stated, or that of neighbours."""
        return float(len(self) - self.about) if self.about and self.excess > 1.0 else np.inf

    def chosen(self, which: Flags) -> "JointSeries":
        """Keep the sessions that `which` (n,) marks."""
        arrays = {name: getattr(self, name)[which] for name in _BY_SESSION}
        return replace(self, session=tuple(compress(self.session, which)), **arrays)


def series_of(sessions: pd.DataFrame, arm: str, joint: int) -> JointSeries:
    """Take the series of one joint (from 1) from an arm's dated sessions that have a figure."""
    name = f"q{joint}"
    valid = sessions["started"].notna() & sessions[f"{name}_mean_error_deg"].notna()
    valid &= sessions[f"{name}_standard_uncertainty_deg"].fillna(0) > 0
    rows = sessions[valid].sort_values(["started", "session"], kind="stable")
    since = rows["started"] - pd.Timestamp(0, tz="UTC")
    full = _numbers(rows, f"{name}_standard_uncertainty_deg")
    own = np.fmin(_numbers(rows, f"{name}_session_uncertainty_deg"), full)
    own = np.where(own > 0, own, full)  # not separated: all of it may differ between sessions
    found = JointSeries(
        arm=arm,
        joint=joint,
        session=tuple(rows["session"]),
        t=np.asarray(since.dt.total_seconds(), dtype=np.float64) / SECONDS_PER_DAY,
        error=_numbers(rows, f"{name}_mean_error_deg"),
        own=own,
        shared=np.sqrt(np.maximum(full**2 - own**2, 0.0)),
        group=pd.factorize(rows["calibration"])[0].astype(np.int64),
    )
    return _with_excess(found)


def _with_excess(series: JointSeries) -> JointSeries:
    """Look whether sessions scatter beyond what they state, whatever a steady drift adds.

    By how far each lies from the line through those before and after. Source: Gasser, Sroka and
    Jennen-Steinmetz, Biometrika 73(3), 1986.
    """
    if len(series) < MIN_SESSIONS_FOR_SCATTER:
        return series
    gap, since = series.t[2:] - series.t[:-2], np.diff(series.t)[:-1]
    later = np.divide(since, gap, out=np.full_like(gap, 0.5), where=gap > 0)
    share = np.stack([later - 1, np.ones_like(gap), -later])
    error, own, shared, group = (
        np.stack([values[:-2], values[1:-1], values[2:]])
        for values in (series.error, series.own, series.shared, series.group)
    )
    alike = group[:, None] == group
    common = np.sum((share * shared)[:, None] * (share * shared) * alike, axis=(0, 1))
    apart = np.sum(share * error, axis=0) / np.sqrt(np.sum((share * own) ** 2, axis=0) + common)
    return replace(series, excess=max(float(np.median(np.abs(apart))) / NORMAL_MEDIAN, 1.0))


def _numbers(rows: pd.DataFrame, name: str) -> Array:
    return rows[name].to_numpy(dtype=float, na_value=np.nan)


MAX_STEPS_EXCESS = 8  # of which one does where no calibrations are shared
MIN_COLUMN_SHARE = 1e-9  # of a column that is left beside the others: less is rounding


def apply_inverse_covariance(series: JointSeries, columns: Array) -> Array:
    """Apply V⁻¹ to columns (n, m)."""
    weight = 1 / series.scatter**2
    result: Array = columns * weight[:, None]
    for inside, square in _calibration_blocks(series):
        share = square / (1 + square * weight[inside].sum())
        total = result[inside].sum(axis=0)
        result[inside] -= share * weight[inside][:, None] * total
    return result


def _calibration_blocks(series: JointSeries) -> Iterator[tuple[Flags, float]]:
    """Each calibration's sessions, and the variance that they share."""
    for group in np.unique(series.group):
        inside = series.group == group
        yield inside, float(np.mean(series.shared[inside] ** 2))


@dataclass(frozen=True, slots=True)
class SeriesFit:
    """A linear model of one series."""

    coefficients: Array  # (p,)
    covariance: Array  # (p, p)
    chi2: float
    fitted: Array  # (n,)
    residual_weighted: Array  # (n,), V⁻¹ (y - fitted)
    shift: Array  # (n,), estimated contribution of each session's calibration


def fit(series: JointSeries, design: Array) -> SeriesFit:
    """Fit columns (n, p) of full rank."""
    by_weight = apply_inverse_covariance(series, design)
    covariance = np.asarray(np.linalg.inv(design.T @ by_weight), dtype=np.float64)
    coefficients = covariance @ (by_weight.T @ series.error)
    fitted = design @ coefficients
    residual = series.error - fitted
    residual_weighted = apply_inverse_covariance(series, residual[:, None])[:, 0]
    shift = np.zeros(len(series))
    for inside, square in _calibration_blocks(series):
        shift[inside] = square * residual_weighted[inside].sum()  # its best linear prediction
    chi2 = float(residual @ residual_weighted)
    return SeriesFit(coefficients, covariance, chi2, fitted, residual_weighted, shift)


def scattered_about(series: JointSeries, design: Array) -> JointSeries:
    """The same with the excess that is left about a level, of columns (n, p)."""
    left = len(series) - design.shape[1]
    for _ in range(MAX_STEPS_EXCESS if left > 0 else 0):
        excess = max(series.excess * float(np.sqrt(fit(series, design).chi2 / left)), 1.0)
        series = replace(series, excess=excess, about=design.shape[1])
    return series


def scan(series: JointSeries, months: Array, design: Array, found: SeriesFit) -> dict[str, Array]:
    """What a step, a drift, or an error of one session would take off χ² beside a fit; (n,) each.

    A step at k is 1 from session k on; a drift at k is the time since session k, from there on. All
    products of such columns with V⁻¹ are sums over the sessions from k on. `months` (n,) is the
    sessions' time, in order, `design` (n, p) holds the columns of the fit.
    """
    alone = series.scatter**-2  # of V⁻¹ the diagonal
    for inside, square in _calibration_blocks(series):
        alone[inside] -= square * alone[inside] ** 2 / (1 + square * alone[inside].sum())
    weighted = apply_inverse_covariance(series, design)
    columns = np.column_stack([found.residual_weighted, weighted])
    sums = zip(_tail_sums(months[:, None], columns), _squares(series, months), strict=True)
    step, drift = (_gain(tail[:, 0], tail[:, 1:], own, found) for tail, own in sums)
    odd = _gain(found.residual_weighted, weighted, alone, found)
    return {"step": step, "drift": drift, "odd": odd}


def _tail_sums(t: Array, values: Array) -> tuple[Array, Array]:
    """Σ v and Σ (t - t_k) v over the sessions from each k on."""
    plain = _suffix_sums(values)
    return plain, _suffix_sums(t * values) - t * plain


def _squares(series: JointSeries, months: Array) -> tuple[Array, Array]:
    """Σ c V⁻¹ c for the step and the drift at each k."""
    weight = 1 / series.scatter**2
    plain, first = _suffix_sums(weight), _suffix_sums(weight * months)
    second = _suffix_sums(weight * months**2) - months * (2 * first - months * plain)
    for inside, square in _calibration_blocks(series):
        part = np.where(inside, weight, 0.0)
        share = square / (1 + square * part.sum())
        steps, drifts = _tail_sums(months, part)
        plain, second = plain - share * steps**2, second - share * drifts**2
    return plain, second


def _gain(signal: Array, common: Array, own: Array, found: SeriesFit) -> Array:
    left = own - np.einsum("np,pq,nq->n", common, found.covariance, common)
    there = left > MIN_COLUMN_SHARE * own
    return np.where(there, signal**2 / np.where(there, left, 1.0), 0.0)


def _suffix_sums(values: Array) -> Array:
    """Sums from each place to the end."""
    return np.cumsum(values[::-1], axis=0)[::-1]


@dataclass(frozen=True, slots=True)
class Contrast:
    """One joint's level in two sets of sessions, degrees; uncertainties are standard ones."""

    sessions: tuple[int, int]
    level: tuple[float, float]
    difference: float  # second less first
    standard_uncertainty: float  # of the difference: what both share drops out
    limit: float  # of |difference|, beyond which it is shown; infinite with one session a side
    expected: float  # of |difference|, beyond which the stated uncertainties do not explain it


def contrast(series: JointSeries, second: Flags, false_alarm: float) -> Contrast:
    """Compare the sessions that are `second` (n,) with the others; neither set is empty.

    `false_alarm` is the chance that a difference is shown where there is none, however far sessions
    scatter: by what is left about either side's level (t test), never less than what is stated.
    """
    counts, left = (int((~second).sum()), int(second.sum())), len(series) - 2
    design = np.column_stack([np.ones(len(series)), second.astype(float)])
    stated = fit(replace(series, excess=1.0), design).covariance[1, 1]
    found = fit(scattered_about(series, design), design)
    first, difference = found.coefficients.tolist()
    u = float(np.sqrt(found.covariance[1, 1]))
    limit = float(t_isf(false_alarm / 2, left)) * u if left else np.inf
    expected = float(norm_isf(false_alarm / 2) * np.sqrt(stated))
    return Contrast(counts, (first, first + difference), difference, u, limit, expected)
