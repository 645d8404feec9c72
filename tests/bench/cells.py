"""Stated uncertainties against the truth: what the studies of many replicates share."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.stats import chi2

from tests.support.boards.calibrated import squared_distance
from verify.core.records import Array
from verify.errors import InputError

SEEDS = (20261121, 20270101)  # fixed beforehand; the second set is the check of the first
WITHIN = 1.96  # standard uncertainties
LOW, HIGH = 0.93, 0.97  # share of replicates that hold the truth within that
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Checked:
    """Some estimates against the truth, in their stated covariance."""

    names: tuple[str, ...]
    z: Array  # (p,), error over standard uncertainty
    d2: float
    degrees: int
    u: Array | None = None  # (p,), standard uncertainty


def checked(names: Sequence[str], error: Array, covariance: Array) -> Checked:
    """Set an error (p,) against the covariance (p, p) stated for it."""
    d2, degrees = squared_distance(error, covariance)
    u = np.sqrt(np.diag(covariance))
    return Checked(tuple(names), error / u, d2, degrees, u)


def seeds(seed: int | list[int], count: int) -> list[int]:
    """Seeds of so many replicates."""
    return list(np.random.SeedSequence(seed).generate_state(count).tolist())


def replicates(work: Callable[[int], R], seed: int, count: int, jobs: int | None = None) -> list[R]:
    """All replicates that are not refused, on all cores; a refusal is printed."""
    attempts = partial(_attempt, work)
    if jobs == 1:
        outcomes = list(map(attempts, seeds(seed, count)))
    else:
        with ProcessPoolExecutor(max_workers=jobs or os.cpu_count()) as pool:
            outcomes = list(pool.map(attempts, seeds(seed, count), chunksize=4))
    for outcome in outcomes:
        if isinstance(outcome, str):
            print(outcome)
    return [outcome for outcome in outcomes if not isinstance(outcome, str)]


def _attempt(work: Callable[[int], R], seed: int) -> R | str:
    try:
        return work(seed)
    except InputError as error:
        return f"refused, replicate's seed {seed}: {error}"


def d2_ratio(outcomes: Sequence[Checked]) -> tuple[float, float, float]:
    """Sum of d² over the sum of its degrees of freedom, and the 99 % interval of that."""
    degrees = sum(o.degrees for o in outcomes)
    low, high = (float(chi2.ppf(p, degrees)) / degrees for p in (0.005, 0.995))
    return sum(o.d2 for o in outcomes) / degrees, low, high


def by_name(outcomes: Sequence[Checked]) -> dict[str, Array]:
    """Normalised errors of every parameter over the replicates that have it."""
    errors: dict[str, list[float]] = {}
    for outcome in outcomes:
        for name, z in zip(outcome.names, outcome.z.tolist(), strict=True):
            errors.setdefault(name, []).append(z)
    return {name: np.array(z) for name, z in errors.items()}


def share(z: Array) -> float:
    """Share of normalised errors whose interval holds the truth."""
    return float(np.mean(np.abs(z) <= WITHIN))


def conclude(failed: int) -> int:
    """Print whether all cells hold; the exit status."""
    print("all cells hold" if not failed else f"{failed} cells fail")
    return int(failed > 0)
