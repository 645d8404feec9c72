"""Find the causes of a session's errors, and name those that the data cannot tell apart.

A dictionary of faults is fitted to the whitened errors beside everything that was fitted or stated;
the set of least cost is taken, and each of its members is named only if no rival explains as much
in its place. Pairs that follow no cause are listed and left out of the fit. A long session is
thinned: what explains less than a share of the misfit is not listed in any case.
"""

from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any

import numpy as np

import robots
from verify.analysis.comparison import Comparison
from verify.analysis.diagnosis import steps
from verify.analysis.diagnosis.causes import Cause, build_cause, merge_ambiguous
from verify.analysis.diagnosis.faults import Fault, Name, Turn, Wave, every_wave, waves_of
from verify.analysis.diagnosis.link_faults import fault_dictionary
from verify.analysis.diagnosis.search import FaultProducts, FaultSet, against_drifts, search_faults
from verify.analysis.joint_errors import ResolvedErrors, predict_errors, resolve_errors
from verify.analysis.least_squares import Whitener, solve
from verify.analysis.model import JointErrorModel, WhitenedColumns
from verify.core.records import Array, Flags, Index
from verify.core.rig import Rig
from verify.core.statistics import chi2_isf, chi2_ppf

UNPAIRED_FIELDS = ("rate_variance", "timed")  # of a comparison: not one a pair
P_OUTLIER = 1e-3  # chance of listing any pair of a session without outliers
MAX_OUTLIER_SHARE = 0.1  # of the pairs: more of them are no outliers, the fit lacks something
P_LACK_OF_FIT = 1e-3  # chance of doubting sound figures
MAX_ROUNDS = 6
MAX_CHANGES = 3  # sought before any other fault, so that pairs across them lie out
MAX_PAIRS = 2000  # of a session; of longer ones so many, evenly spread
TOL_MISFIT = 0.01  # of the misfit


def thin_model(model: JointErrorModel, chosen: Index) -> JointErrorModel:
    """The model of some pairs alone, `chosen` by their places, increasing."""
    rows = np.isin(model.white.pair, chosen)
    factors = tuple(model.white.factors[i] for i in chosen)
    pair = np.repeat(np.arange(len(factors)), [len(f) for f in factors])
    return replace(
        model,
        comparison=_select_pairs(model.comparison, chosen),
        white=Whitener(factors, pair.astype(np.int64)),
        xi=model.xi[rows],
        joints=model.joints[rows],
        hidden=model.hidden[rows],
        fitted=model.fitted[rows],
        seen=WhitenedColumns(*(getattr(model.seen, f.name)[rows] for f in fields(WhitenedColumns))),
        prior=model.prior[rows],
        prior_columns=model.prior_columns[chosen],
    )


def _select_pairs(comparison: Comparison, chosen: Index) -> Comparison:
    changes: dict[str, Any] = {}
    for field in fields(Comparison):
        value = getattr(comparison, field.name)
        if isinstance(value, tuple):
            changes[field.name] = tuple(value[i] for i in chosen)
        elif field.name not in UNPAIRED_FIELDS:
            changes[field.name] = value[chosen]
    return replace(comparison, **changes)


__all__ = ["Cause", "Diagnosis", "find_causes"]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What a session says of the causes of its errors."""

    causes: list[Cause]
    outlying: Index  # rows of the comparison that follow no cause
    misfit: float  # chi-squared a degree of freedom that the causes leave, where they lack; else 1
    products: FaultProducts

    @property
    def camera_turns(self) -> list[Turn]:
        """Turns of the cameras that are suspected, but those that begin in the session."""
        suspects = [c for cause in self.causes for c in (cause.candidates or (cause,))]
        lasting = [c.fault for c in suspects if c.fault.begin is None]
        return [(f.kind, f.variant) for f in lasting if f.kind in ("camera_turned", "camera_drift")]

    def straddling(self, t: Array) -> Index:
        """Pairs of t (n,), s, that lie out beside a change: readings of before and after meet."""
        begins = [c.fault.begin for c in self.causes if c.fault.begin is not None]
        beside = {k + i for k in np.searchsorted(t, begins).tolist() for i in (-1, 0)}
        return np.array([i for i in self.outlying.tolist() if i in beside], dtype=np.int64)


def find_causes(
    model: JointErrorModel,
    resolved: ResolvedErrors,
    arm: robots.Arm | None = None,
    rig: Rig | None = None,
) -> Diagnosis:
    """Find the set of causes that the data ask for, and say where they cannot tell which.

    Everything stated counts through the model's prior; from `resolved`, the smooth fit, pairs that
    lie outside are first told. The arm gives the link parameters that are tried; the rig says where
    the cameras stand, for the skew of their instants.
    """
    residual = model.xi - predict_errors(model, resolved)
    chosen = np.arange(len(model.comparison))
    if len(chosen) > MAX_PAIRS:
        chosen = np.linspace(0, len(chosen) - 1, MAX_PAIRS).round().astype(np.int64)
        residual = residual[np.isin(model.white.pair, chosen)]
        model = thin_model(model, chosen)
    faults = list(fault_dictionary(model, arm, rig))
    moving = steps.beginning_faults(model, faults)
    faults += steps.stated_steps(model, moving)
    outlying = _within(_outliers(model, residual), len(chosen))
    changes: list[Fault] = []
    for _ in range(MAX_CHANGES):
        scan = steps.StepScan(model, ~np.isin(model.white.pair, outlying))
        change = scan.strongest(moving, changes)
        if change is None:
            break
        changes.append(change)
        residual = model.xi - predict_errors(model, resolve_errors(model, changes))
        outlying = _within(_outliers(model, residual), len(chosen))
    # what one direction of travel shows, the smooth fit takes for outliers where few pairs have it
    starts = [outlying, outlying[:0]] if len(outlying) else [outlying]
    fit = min((_settle(model, faults, moving, start) for start in starts), key=lambda f: f.cost)
    causes = [build_cause(fit.products, fit.best, i) for i in fit.best]
    causes.sort(key=lambda c: -c.explains)
    # beside a wave that is found every number is tried; what is detectable is told of the usual
    usual = {(f.name, f.per_turn) for f in faults}
    tried = enumerate((f.name, f.per_turn) in usual for f in fit.products.faults)
    products = fit.products.subset([i for i, one in tried if one or i in fit.best])
    return Diagnosis(merge_ambiguous(causes), chosen[fit.outlying], fit.misfit, products)


@dataclass(frozen=True, slots=True)
class _Fit:
    """A set of faults beside the pairs that follow none."""

    products: FaultProducts
    best: FaultSet
    misfit: float
    outlying: Index
    cost: float  # of the pairs' likelihood, the faults listed and the pairs left out


def _settle(
    model: JointErrorModel, faults: list[Fault], moving: list[Fault], outlying: Index
) -> _Fit:
    """The best set and the outlying pairs that go with each other, from such pairs on."""
    for _ in range(MAX_ROUNDS):
        left_out, kept = outlying, ~np.isin(model.white.pair, outlying)
        products, best, misfit = _best_dated_set(model, faults, moving, kept)
        outlying = _outliers(model, _residual(model, products, best, kept))
        if np.array_equal(outlying, left_out):
            break
    limits = _outlier_limits(model)[left_out]
    cost = products.cost(best) + products.rows * np.log(misfit) + limits.sum()
    return _Fit(products, best, misfit, outlying, float(cost))


def explained_by(
    found: Diagnosis, model: JointErrorModel, arm: robots.Arm | None, rig: Rig | None
) -> list[Fault]:
    """The faults by which a diagnosis explains a session, for a model of all its pairs.

    Of causes that cannot be told apart all are taken: no verdict may rest on which it is.
    """
    listed = [[c.fault for c in cause.candidates] or [cause.fault] for cause in found.causes]
    wanted = {(f.name, f.per_turn, f.variant, f.begin): f for faults in listed for f in faults}
    missing = {key[:3] for key, f in wanted.items() if f.kind != "step"}
    lasting: dict[tuple[Name, int | None, int], Fault] = {}
    for key, f in wanted.items():
        if f.joint is not None and f.per_turn is not None:
            (lasting[key[:3]],) = waves_of(model, f.joint - 1, [f.per_turn], f.about)
    for fault in fault_dictionary(model, arm, rig) if len(lasting) < len(missing) else ():
        name = fault.name, fault.per_turn, fault.variant
        if name in missing:
            lasting.setdefault(name, fault)
        if len(lasting) == len(missing):  # all faults of a long session would fill its memory
            break
    moving = {f.name: f for f in steps.beginning_faults(model, lasting.values())}
    return [
        lasting[key[:3]]
        if fault.begin is None
        else steps.begun(
            model, moving[fault.name], int(np.searchsorted(model.comparison.t, fault.begin))
        )
        for key, fault in wanted.items()
    ]


def _within(outlying: Index, count: int) -> Index:
    """Outlying pairs without a run at either end of the session: there something has changed."""
    rest = np.setdiff1d(np.arange(count), outlying)
    before, after = rest.min(initial=count), rest.max(initial=-1)
    inside = (outlying > before) & (outlying < after)
    ends = (outlying < before) & (before < steps.MIN_PAIRS_BESIDE)
    ends |= (outlying > after) & (count - 1 - after < steps.MIN_PAIRS_BESIDE)
    isolated: Index = outlying[inside | ends]
    return isolated


def _best_dated_set(
    model: JointErrorModel, faults: list[Fault], moving: list[Fault], kept: Flags
) -> tuple[FaultProducts, FaultSet, float]:
    """The best set, of which those that begin in the session do so at their likeliest instants."""
    scan, tried = steps.StepScan(model, kept), list(faults)
    found: list[Fault] = []
    waves: dict[int, tuple[Wave, ...]] = {}
    for _ in range(MAX_ROUNDS):
        known = {(f.name, f.begin) for f in tried}
        new = {(f.name, f.begin): f for f in scan.likeliest(moving, found)}
        more = [f for key, f in new.items() if key not in known]
        if found and not more and not waves:
            break
        tried += more
        products, best, misfit = _best_set(model, _with_whole_waves(model, tried, waves), kept)
        before, found = found, [products.faults[i] for i in best]
        if [_key(f) for f in before] == [_key(f) for f in found]:
            break
        waves = _waves(products, best)
    return products, best, misfit


def _key(fault: Fault) -> tuple[Name, int | None, float | None]:
    return fault.name, fault.per_turn, fault.begin


def _waves(products: FaultProducts, best: FaultSet) -> dict[int, tuple[Wave, ...]]:
    """Waves of a set by their joint, from 1."""
    found: dict[int, tuple[Wave, ...]] = {}
    for i in best:
        fault = products.faults[i]
        if fault.joint is not None and fault.per_turn is not None:
            cosine, sine = products.estimate(best, i)[0].tolist()
            found[fault.joint] = (*found.get(fault.joint, ()), (fault.per_turn, cosine, sine))
    return found


def _with_whole_waves(
    model: JointErrorModel, tried: list[Fault], waves: dict[int, tuple[Wave, ...]]
) -> list[Fault]:
    """Faults with every number of waves of joints that have some: one sought is near it at best."""
    kept = [f for f in tried if f.joint not in waves or (f.per_turn or 1) == 1]
    return [*kept, *chain.from_iterable(every_wave(model, j - 1, w) for j, w in waves.items())]


def _best_set(
    model: JointErrorModel, faults: list[Fault], kept: Flags
) -> tuple[FaultProducts, FaultSet, float]:
    """The best set at the misfit that it leaves: a fit that lacks accuses nobody by its noise."""
    plain = FaultProducts.of(model, faults, kept)
    misfit = 1.0
    for _ in range(MAX_ROUNDS):
        products = plain.doubted(misfit)
        best = search_faults(products)
        degrees = products.rows - model.fitted.shape[1] - len(products.columns(best))
        left = plain.chi2(best)
        lacking = degrees > 0 and left > chi2_isf(P_LACK_OF_FIT, degrees)
        before, misfit = misfit, left / degrees if lacking else 1.0
        if misfit <= before * (1 + TOL_MISFIT):
            break
    return products, against_drifts(products, best), before


def _residual(
    model: JointErrorModel, products: FaultProducts, best: FaultSet, kept: Flags
) -> Array:
    """Whitened errors (r,) of all pairs less what the causes and all fitted and stated make."""
    named = [products.faults[i].columns for i in best]
    free = np.concatenate([model.fitted, *named], axis=1)
    fit = solve(free[kept], model.xi[kept], model.prior[kept])
    return model.xi - free @ fit.value - model.prior @ fit.held


def _outliers(model: JointErrorModel, residual: Array) -> Index:
    """Pairs (of the comparison) whose residual is too large for the others' scatter."""
    pair, count = model.white.pair, len(model.comparison)
    distance = np.bincount(pair, residual**2, minlength=count)
    known = np.bincount(pair, minlength=count)
    typical = chi2_ppf(0.5, np.maximum(known, 1))
    scatter = max(float(np.median(distance / typical)), 1.0)
    found = np.flatnonzero(distance > scatter * _outlier_limits(model))
    return found if len(found) <= MAX_OUTLIER_SHARE * count else found[:0]


def _outlier_limits(model: JointErrorModel) -> Array:
    """Chi-squared of each pair that chance reaches once in 1 / P_OUTLIER sessions, (n,)."""
    count = len(model.comparison)
    known = np.bincount(model.white.pair, minlength=count)
    return np.asarray(chi2_isf(P_OUTLIER / count, np.maximum(known, 1)))
