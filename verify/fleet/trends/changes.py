"""Find steps, drifts and odd sessions of a joint over time, and date each to a session.

The level is a constant, plus steps at sessions, plus drifts that begin at sessions; an odd session
is off by itself. Terms are added while the best candidate is beyond what chance gives the best of
all candidates of all joints of the fleet (Bonferroni), each place is then optimised again beside
the others, and what does not stand by the scatter that is left is dropped (F test). A kind is named
where its fit beats the other kind's by ΔBIC ≥ 10.
"""

from dataclasses import dataclass, replace
from math import comb

import numpy as np

from verify.core.records import Array, Flags
from verify.core.statistics import chi2_isf, f_sf
from verify.fleet.trends.series import (
    DAYS_PER_MONTH,
    JointSeries,
    SeriesFit,
    fit,
    scan,
    scattered_about,
)

MIN_SESSIONS = 3  # sessions on either side of a change: one or two odd ones are no change
MAX_TERMS = 6
P_MISFIT = 0.1  # chance that a scatter that is right is doubted
MIN_BIC_DIFFERENCE = 10.0  # ΔBIC: odds of 150 to 1
MAX_CHI2_DATE = 6.63  # χ²(1), 99 %: how far a date may be from the best one


@dataclass(frozen=True, slots=True)
class TrendTerm:
    """A step at a session, a drift from a session on, or a session that is off alone."""

    kind: str  # step, drift, odd
    place: int  # index of the first session after a step; of the last before a drift; the odd one


@dataclass(frozen=True, slots=True)
class TrendChange:
    """A term that the data ask for."""

    term: TrendTerm
    size: float  # degrees; a drift's in degrees a month
    standard_uncertainty: float  # in the same unit
    earliest: int  # the first place that the data do not exclude (99 %), as `TrendTerm.place`
    latest: int
    clearer_by: float  # ΔBIC to the best fit with the other kind in its stead


@dataclass(frozen=True, slots=True)
class JointTrend:
    """The level of one joint over time."""

    changes: tuple[TrendChange, ...]  # in order of time
    odd: Flags  # (n,), sessions that stand apart: of no weight in the level
    fitted: Array  # (n,), degrees: the level
    shift: Array  # (n,), degrees: estimated contribution of each session's calibration
    level_uncertainty: float  # standard, of the last of `fitted`, calibrations included
    reference: float  # degrees: the level before any change
    reference_uncertainty: float  # standard, what calibrations share left out
    slope: float  # degrees a month, at the end
    slope_uncertainty: float
    series: JointSeries  # with the scatter by which it was judged
    unclear: bool  # more than the scatter that was expected, no change by the scatter there is


def find_changes(series: JointSeries, false_alarm: float) -> JointTrend:
    """Find the changes of one joint over three sessions or more: its level over time.

    `false_alarm` is the chance that anything is found where nothing changed, however far sessions
    scatter: what the stated scatter, or the neighbours', asks for counts if it is beyond chance by
    what it leaves, too (F test). The stated one may be wrong, and neighbours agree by chance.
    """
    every = candidates(series)
    if len(series) > MIN_SESSIONS:
        every += [TrendTerm("odd", k) for k in range(len(series))]
    sought = _find_terms(series, every, false_alarm)
    terms = _beyond_scatter(series, sought, every, false_alarm)
    if every and not terms:
        best = every[int(np.argmax(_candidate_worth(series, [], every)))]
        terms = _beyond_scatter(series, [best], every, false_alarm)
    found = fit(series, _design(series, terms)).chi2
    explained = found <= chi2_isf(P_MISFIT, max(len(series) - 1 - len(terms), 1))
    if not (series.excess == 1.0 and explained):
        series = scattered_about(series, _design(series, terms))
    return _course(series, terms, every, unclear=bool(sought) and not terms)


def _beyond_scatter(
    series: JointSeries, terms: list[TrendTerm], every: list[TrendTerm], false_alarm: float
) -> list[TrendTerm]:
    """Keep those that stand by the scatter that they leave: all together, and each beside the rest.

    The chance is shared out between the numbers of changes (1/2, 1/4, …) and of odd sessions (1/4,
    1/16, …), and all sets of so many candidates.
    """
    terms, n = list(terms), len(series)
    while terms:
        count, left = len(terms), n - 1 - len(terms)
        odd = sum(t.kind == "odd" for t in terms)
        sets = comb(len(every) - n, count - odd) * comb(n, odd) * 2 ** (count + odd)
        scattered = scattered_about(series, _design(series, terms))
        # what each one alone takes off
        lost = [
            _candidate_gains(scattered, [t for t in terms if t != one], [one])[0] for one in terms
        ]
        level, fitted = (fit(scattered, _design(series, some)).chi2 for some in ([], terms))
        together = f_sf((level - fitted) / count, count, left) * sets
        alone = f_sf(min(lost), 1, left) * 2 * max(n, len(every) - n)
        if left > 0 and max(together, alone) <= false_alarm:
            break
        del terms[int(np.argmin(lost))]
        terms = _refine(scattered, terms, every)
    return terms


def _course(
    series: JointSeries, terms: list[TrendTerm], every: list[TrendTerm], *, unclear: bool
) -> JointTrend:
    found = fit(series, _design(series, terms))
    places = [t.place for t in terms if t.kind == "odd"]
    every = [t for t in every if t.kind != "odd"]
    changes = [
        _change(series, terms, i, found, every) for i, t in enumerate(terms) if t.kind != "odd"
    ]
    level = _design(series, terms) * np.array([1.0, *(t.kind != "odd" for t in terms)])
    drifting = np.array([0.0, *(t.kind == "drift" for t in terms)])  # all drifts add up at the end
    alone = replace(series, shared=np.zeros(len(series)))  # what sessions share left out
    unshared = fit(alone, _design(alone, terms)).covariance
    return JointTrend(
        changes=tuple(sorted(changes, key=lambda c: (c.term.place, c.term.kind))),
        odd=np.isin(np.arange(len(series)), places),
        fitted=level @ found.coefficients,
        shift=found.shift,
        level_uncertainty=float(np.sqrt(level[-1] @ found.covariance @ level[-1])),
        reference=float(found.coefficients[0]),
        reference_uncertainty=float(np.sqrt(unshared[0, 0])),
        slope=float(drifting @ found.coefficients),
        slope_uncertainty=float(np.sqrt(drifting @ found.covariance @ drifting)),
        series=series,
        unclear=unclear,
    )


def candidates(series: JointSeries) -> list[TrendTerm]:
    """List every change of the level that a series could show."""
    n = len(series)
    steps = [
        TrendTerm("step", k)
        for k in range(MIN_SESSIONS, n - MIN_SESSIONS + 1)
        if series.t[k] > series.t[k - 1]  # sessions of one start have no order
    ]
    drifts = [
        TrendTerm("drift", k)
        for k in range(max(n - MIN_SESSIONS, 0))
        if (k == 0 or k >= MIN_SESSIONS) and series.t[k] < series.t[-1]  # time must pass
    ]
    return [*drifts, *steps] if n > MIN_SESSIONS else []


def _column(series: JointSeries, term: TrendTerm) -> Array:
    if term.kind != "drift":
        after = np.arange(len(series)) - term.place
        return (after >= 0 if term.kind == "step" else after == 0).astype(float)
    months = _months(series)
    return np.asarray(np.maximum(months - months[term.place], 0.0))


def _months(series: JointSeries) -> Array:
    """Time since the first session."""
    return np.asarray((series.t - series.t[0]) / DAYS_PER_MONTH)


def _design(series: JointSeries, terms: list[TrendTerm]) -> Array:
    return np.column_stack([np.ones(len(series)), *(_column(series, t) for t in terms)])


def _bic_penalties(series: JointSeries, terms: list[TrendTerm]) -> Array:
    """What each term's parameters cost (BIC): a size, and a place unless it is the beginning."""
    free = [1 if term == TrendTerm("drift", 0) else 2 for term in terms]
    return np.asarray(np.log(len(series)) * np.array(free, dtype=float))


def _find_terms(series: JointSeries, every: list[TrendTerm], false_alarm: float) -> list[TrendTerm]:
    """Add terms while they are beyond chance; look for each again beside the others."""
    chance = false_alarm / max(len(every), 1)
    threshold = float(chi2_isf(chance, 1))  # of χ², one candidate's
    terms: list[TrendTerm] = []
    for _ in range(MAX_TERMS if every else 0):
        gain = _candidate_gains(series, terms, every)
        if gain.max() < threshold:
            break
        worth = gain - _bic_penalties(series, every)
        terms = _refine(series, [*terms, every[int(np.argmax(worth))]], every)
    if len(terms) < 2:
        return terms
    # a drift that a repair ends: step by step one would climb it in many steps
    repaired = _refine(series, _drift_until_step(series, every), every)
    return min(terms, repaired, key=lambda some: _bic(series, some))


def _drift_until_step(series: JointSeries, every: list[TrendTerm]) -> list[TrendTerm]:
    """A drift from the beginning, taken back by a step with which it ends, where that fits best."""
    places = [t.place for t in every if t.kind == "step" and series.t[t.place - 1] > series.t[0]]
    places = [k for k in places if TrendTerm("drift", k) in every]
    choices = [[TrendTerm("drift", 0), TrendTerm("step", k), TrendTerm("drift", k)] for k in places]
    return min(choices, key=lambda some: _bic(series, some), default=[])


def _bic(series: JointSeries, terms: list[TrendTerm]) -> float:
    """BIC, up to a constant."""
    return fit(series, _design(series, terms)).chi2 + float(_bic_penalties(series, terms).sum())


def _refine(series: JointSeries, terms: list[TrendTerm], every: list[TrendTerm]) -> list[TrendTerm]:
    """Move each term to its best place and kind beside the others, until none moves."""
    for _ in range(2 * MAX_TERMS):  # each move takes χ² down: it ends by itself, soon
        before = list(terms)
        for i in range(len(terms)):
            others = list(dict.fromkeys(t for j, t in enumerate(terms) if j != i))
            terms[i] = every[int(np.argmax(_candidate_worth(series, others, every)))]
        if terms == before:
            break
    return list(dict.fromkeys(terms))


def _candidate_gains(series: JointSeries, terms: list[TrendTerm], every: list[TrendTerm]) -> Array:
    """What each candidate alone would take off χ² beside the terms."""
    design = _design(series, terms)
    tried = scan(series, _months(series), design, fit(series, design))
    return np.array([tried[term.kind][term.place] for term in every])


def _candidate_worth(series: JointSeries, terms: list[TrendTerm], every: list[TrendTerm]) -> Array:
    """That, less what its parameters cost (BIC)."""
    return _candidate_gains(series, terms, every) - _bic_penalties(series, every)


def _change(
    series: JointSeries,
    terms: list[TrendTerm],
    index: int,
    found: SeriesFit,
    every: list[TrendTerm],
) -> TrendChange:
    term = terms[index]
    gain = _candidate_gains(series, [t for t in terms if t != term], every)
    worth = gain - _bic_penalties(series, every)
    kind = np.array([t.kind == term.kind for t in every])
    place = np.array([t.place for t in every])
    own = every.index(term)
    dated = place[kind & (gain >= gain[own] - MAX_CHI2_DATE)]
    rival = worth[~kind].max(initial=-np.inf)
    return TrendChange(
        term=term,
        size=float(found.coefficients[index + 1]),
        standard_uncertainty=float(np.sqrt(found.covariance[index + 1, index + 1])),
        earliest=int(dated.min()),
        latest=int(dated.max()),
        clearer_by=float(worth[own] - rival),
    )
