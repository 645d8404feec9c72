"""Which cause explains the errors: candidates fitted to the whitened errors, rivals compared.

A candidate is a column: what a unit of that fault would do to every pair. Constant offsets are
the first kind; others are added to `candidates` as they come. Every set of candidates is tried,
so that two faults together cannot pass for a third one.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import norm

from verify.judgement.model import Model
from verify.judgement.resolved import Resolved
from verify.records import Array
from verify.regression import left_over

FAMILY_FALSE_ALARM = 1e-3  # chance a candidate, shared out over all of them
LEAST_ADVANTAGE = 15.0  # in chi-squared over every rival with as many parameters
LEAST_SHARE = 0.01  # of the misfit: what explains less is no cause worth a name
RANK = 1e-8  # of a normalised Gram matrix: closer columns cannot be told apart at all


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fault that might be: kind, joint (1-based; None for a common one), effect of one unit."""

    kind: str
    joint: int | None
    unit: str
    column: Array  # (r,), whitened, a SI unit


@dataclass(frozen=True, slots=True)
class Cause:
    """A fault that the data single out, or several that they cannot tell apart."""

    kind: str  # offset, …, or ambiguous
    joint: int | None
    unit: str
    value: float  # SI
    standard_uncertainty: float
    explains: float
    candidates: tuple[Candidate, ...] = ()


def candidates(model: Model) -> list[Candidate]:
    """Every fault that is tried: so far a constant offset of each joint."""
    return [
        Candidate("offset", j + 1, "deg", model.offsets[:, j])
        for j in range(model.offsets.shape[1])
    ]


def diagnose(model: Model, resolved: Resolved) -> list[Cause]:
    """Find the set of causes that the data ask for, and say where they cannot tell which.

    Args:
        model: the session's linear model; everything stated counts through its prior.
        resolved: what of the errors changes with angle and direction is fitted beside the
            candidates, so that a gain or backlash does not pass for offsets; and a fit that
            lacks accuses nobody on the strength of its noise.
    """
    tried = candidates(model)
    left = _Left.of(model, tried, resolved)
    usable = [i for i in range(len(tried)) if left.visible(i)]
    if not usable:
        return []
    # a candidate earns its place by more than chance would give the best of them all
    price = float(norm.isf(FAMILY_FALSE_ALARM / 2 / len(usable))) ** 2
    sets = [s for size in range(len(usable) + 1) for s in combinations(usable, size)]
    best = min(sets, key=lambda s: left.chi2(s) + price * len(s))
    causes = [_cause(left, tried, best, usable, i) for i in best]
    return _one_ambiguous([c for c in causes if c.explains > LEAST_SHARE])


def _one_ambiguous(causes: list[Cause]) -> list[Cause]:
    """Unite what cannot be told apart in one entry with all its candidates."""
    unclear = [c for c in causes if c.candidates]
    if len(unclear) < 2:
        return causes
    every = {id(k): k for c in unclear for k in c.candidates}
    largest = max(unclear, key=lambda c: c.explains)
    united = replace(largest, candidates=tuple(every.values()))
    return [*(c for c in causes if not c.candidates), united]


def _cause(
    left: "_Left", tried: list[Candidate], best: tuple[int, ...], usable: list[int], i: int
) -> Cause:
    rest = tuple(k for k in best if k != i)
    least = left.chi2(best)
    rivals = [k for k in usable if k not in best]
    close = [k for k in rivals if left.chi2((*rest, k)) - least < LEAST_ADVANTAGE]
    value, uncertainty = left.estimate(best, i)
    without = left.chi2(rest)
    return Cause(
        kind="ambiguous" if close else tried[i].kind,
        joint=None if close else tried[i].joint,
        unit=tried[i].unit,
        value=value,
        standard_uncertainty=uncertainty,
        explains=1 - least / without if without > 0 else 0.0,
        candidates=tuple(tried[k] for k in (i, *close)) if close else (),
    )


@dataclass(frozen=True, slots=True)
class _Left:
    """What registration, clock and stated doubts leave of the candidates and of the errors."""

    gram: Array  # (c, c)
    moment: Array  # (c,)
    power: float
    whole: Array  # (c,), squared length of the candidates' columns before

    @classmethod
    def of(cls, model: Model, tried: list[Candidate], resolved: Resolved) -> "_Left":
        columns = np.stack([c.column for c in tried], axis=1)
        target = np.concatenate([columns, model.xi[:, None]], axis=1)
        fitted = np.concatenate([model.fitted, resolved.significant], axis=1)
        products = left_over(fitted, target, model.prior) / resolved.misfit
        whole = np.sum(columns**2, axis=0) / resolved.misfit
        return cls(products[:-1, :-1], products[:-1, -1], float(products[-1, -1]), whole)

    def visible(self, i: int) -> bool:
        """Something of the candidate is left."""
        return bool(self.gram[i, i] > RANK * self.whole[i])

    def _solved(self, chosen: tuple[int, ...]) -> tuple[Array, Array] | None:
        index = list(chosen)
        size = np.sqrt(np.diag(self.gram)[index])
        normal = self.gram[np.ix_(index, index)] / np.outer(size, size)
        if len(index) and np.linalg.eigvalsh(normal)[0] < RANK:
            return None
        inverse = np.linalg.inv(normal) / np.outer(size, size)
        return inverse @ self.moment[index], inverse

    def chi2(self, chosen: tuple[int, ...]) -> float:
        """Misfit with these candidates fitted; infinite where they cannot be told apart."""
        solved = self._solved(chosen)
        if solved is None:
            return float("inf")
        return self.power - float(solved[0] @ self.moment[list(chosen)])

    def estimate(self, chosen: tuple[int, ...], i: int) -> tuple[float, float]:
        """Value and standard uncertainty of one of the chosen, all fitted together."""
        solved = self._solved(chosen)
        if solved is None:
            raise ValueError("a set that cannot be told apart is never the best")
        place = chosen.index(i)
        return float(solved[0][place]), float(np.sqrt(solved[1][place, place]))
