"""Each joint's mean error taken apart: how much of its uncertainty comes from which source."""

from dataclasses import replace

import numpy as np
import pandas as pd

from verify.clock import ClockEstimate
from verify.comparison import Comparison
from verify.judgement.means import JointErrors, Means, is_fitted
from verify.judgement.model import Model, prior_columns
from verify.records import Array
from verify.regression import solve
from verify.systematics import Systematics
from verify.track import Track

COLUMNS = ["joint", "source", "kind", "standard_uncertainty_deg"]
RANDOM = "pixels, alignment, readings"
CLOCK, PAN, ALIGNMENT = "clock", "pan angle", "alignment of the two instants"


def budget(
    model: Model,
    errors: JointErrors,
    means: Means,
    inverse: Array,
    systematics: Systematics,
    track: Track,
    clock: ClockEstimate,
) -> pd.DataFrame:
    """One row a joint and source: its share of the mean error's standard uncertainty, degrees.

    Where the means come from a fit, a source's share is what the variance loses when that source
    is taken as exact; shares of sources that the fit trades against each other need not add up.

    Args:
        model: the session's linear model.
        errors: joint errors a pair.
        means: what the sources add up to.
        inverse: (n, j, 6), d joints / d pose.
        systematics: stated parameters.
        track: measured poses (pan readings).
        clock: the offset and how it came about.
    """
    sources = [*dict.fromkeys(systematics.sources), *_others(model.comparison, systematics, clock)]
    parts = [(RANDOM, "random", means.random)]
    for source in sources:
        if is_fitted(model, errors):
            share = _lost(model, means, track, clock, systematics, source)
        else:
            share = _carried(model.comparison, errors, inverse, track, clock, systematics, source)
        if np.any(share > 0):
            parts.append((source, "systematic", share))
    rows = [
        (j + 1, source, kind, float(np.rad2deg(u[j])))
        for source, kind, u in parts
        for j in range(len(u))
    ]
    return pd.DataFrame(rows, columns=COLUMNS)


def _others(comparison: Comparison, systematics: Systematics, clock: ClockEstimate) -> list[str]:
    there = {
        PAN: bool(np.any(systematics.pan > 0)),
        CLOCK: bool(clock.standard_uncertainty),
        ALIGNMENT: bool(comparison.alignment_error.any()),
    }
    return [source for source, counts in there.items() if counts]


def _columns(
    comparison: Comparison,
    track: Track,
    clock: ClockEstimate,
    systematics: Systematics,
    source: str,
    *,
    without: bool,
) -> Array:
    """Prior columns (n, 6, p) of one source alone, or of all without it."""

    def counts(name: str) -> bool:
        return (name == source) != without

    keep = np.array([counts(s) for s in systematics.sources], dtype=bool)
    some = replace(
        systematics,
        covariance=systematics.covariance * np.outer(keep, keep),
        pan=systematics.pan if counts(PAN) else np.full(2, np.nan),
    )
    stamped = clock if counts(CLOCK) else replace(clock, standard_uncertainty=None)
    left = comparison.alignment_error
    aligned = replace(
        comparison, alignment_error=left if counts(ALIGNMENT) else np.zeros_like(left)
    )
    return prior_columns(aligned, track, stamped, some)


def _carried(
    comparison: Comparison,
    errors: JointErrors,
    inverse: Array,
    track: Track,
    clock: ClockEstimate,
    systematics: Systematics,
    source: str,
) -> Array:
    """A source's standard uncertainty carried through the plain mean, (j,), rad."""
    known = ~np.isnan(errors.error)
    weight = known / np.maximum(known.sum(axis=0), 1)
    # an estimated clock does not average out either: its column is that of a given one
    given = replace(clock, source="given")
    columns = _columns(comparison, track, given, systematics, source, without=False)
    share = np.einsum("ni,nij,njp->ip", weight, inverse, columns)
    size: Array = np.linalg.norm(share, axis=1)
    return size


def _lost(
    model: Model,
    means: Means,
    track: Track,
    clock: ClockEstimate,
    systematics: Systematics,
    source: str,
) -> Array:
    """What the fitted means' uncertainty loses when a source is exact, (j,), rad."""
    rest = _columns(model.comparison, track, clock, systematics, source, without=True)
    held = model.white.rows(rest)
    design = np.concatenate([model.offsets, model.fitted], axis=1)
    joints = model.offsets.shape[1]
    without = np.diag(solve(design, model.xi, held).covariance)[:joints]
    full = np.diag(solve(design, model.xi, model.prior).covariance)[:joints]
    lost: Array = np.sqrt(np.maximum(full - without, 0.0))
    return np.where(np.isnan(means.mean), np.nan, lost)
