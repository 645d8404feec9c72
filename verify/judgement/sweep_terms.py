"""The encoder's error over a sweep: its terms, fitted together with the axis."""

from dataclasses import dataclass

import numpy as np

from verify.distributions import chi2_sf
from verify.judgement.resolved import LEAST_PAIRS_A_DIRECTION
from verify.judgement.sweep_axis import AxisFit, Swept, fit_axis
from verify.records import Array

SIGNIFICANT = 1e-3  # chance of an eccentricity where there is none


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure with its standard uncertainty; nan where the sweep does not determine it."""

    value: float
    uncertainty: float


NOTHING = Figure(float("nan"), float("nan"))


@dataclass(frozen=True, slots=True)
class Terms:
    """Columns of the encoder's error: gain, hysteresis, sine and cosine, clock; -1: not there."""

    columns: Array  # (n, k)
    hysteresis: int
    circular: int  # the first of two
    clock: int


def _terms(turned: Array, direction: Array, rate: Array | None, *, circular: bool) -> Terms:
    middle = (turned.max() + turned.min()) / 2
    columns, places = [turned - middle], {"hysteresis": -1, "circular": -1, "clock": -1}
    if min(np.sum(direction > 0), np.sum(direction < 0)) >= LEAST_PAIRS_A_DIRECTION:
        places["hysteresis"] = len(columns)
        columns.append(direction / 2 - np.mean(direction / 2))
    if circular:
        places["circular"] = len(columns)
        columns += [np.sin(turned) - np.mean(np.sin(turned))]
        columns += [np.cos(turned) - np.mean(np.cos(turned))]
    if rate is not None:
        places["clock"] = len(columns)
        columns.append(rate - np.mean(rate))
    return Terms(np.stack(columns, axis=1), **places)


def fit_terms(
    swept: Swept, direction: Array, rate: Array | None, *, circular: bool
) -> tuple[Terms, AxisFit]:
    """Fit with terms of the true angle, which the first fit shows."""
    turned = swept.q
    for _ in range(2):
        terms = _terms(turned, direction, rate, circular=circular)
        fit = fit_axis(swept, terms.columns)
        turned = fit.turned
    return terms, fit


def figure(fit: AxisFit, place: int, misfit: float) -> Figure:
    """One term with its uncertainty; `misfit` is by how much chi-squared is too large."""
    if place < 0 or not fit.estimable[place]:
        return NOTHING
    return Figure(float(fit.value[place]), float(np.sqrt(fit.covariance[place, place] * misfit)))


def find_eccentricity(terms: Terms, fit: AxisFit) -> tuple[Figure, Figure, bool]:
    """Amplitude, phase, and whether it is there at all."""
    both = slice(terms.circular, terms.circular + 2)
    if not fit.estimable[both].all():
        return NOTHING, NOTHING, False
    part, spread = fit.value[both], fit.covariance[both, both]
    size = float(np.hypot(*part))
    there = bool(chi2_sf(float(part @ np.linalg.solve(spread, part)), 2) < SIGNIFICANT)
    along = part / size if size > 0 else part
    # without a direction to speak of, the worst known one bounds it
    variance = along @ spread @ along if there else np.linalg.eigvalsh(spread)[-1]
    phase = NOTHING
    if there:
        across = np.array([along[1], -along[0]])
        doubt = float(np.sqrt(across @ spread @ across)) / size
        phase = Figure(float(np.arctan2(part[0], part[1])), doubt)
    return Figure(size, float(np.sqrt(variance))), phase, there
