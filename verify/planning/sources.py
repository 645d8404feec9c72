"""What a foretold uncertainty is made of: which source is worth mending before the session."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from verify.judgement.means import is_fitted
from verify.judgement.model import clock_effect, prior_columns
from verify.planning.foresight import Foreseen, Judged
from verify.records import Array
from verify.regression import solve

RANDOM, CLOCK, PAN = "pixels, alignment, readings", "clock", "pan angle"


@dataclass(frozen=True, slots=True)
class Source:
    """One source's part of the mean errors' standard uncertainty."""

    name: str
    share: Array  # (j,), rad; nan where the mean is not known


def sources(foreseen: Foreseen, judged: Judged) -> list[Source]:
    """Take the mean errors' uncertainties apart.

    Of plain means the squares add up. Where the means come from a fit, a share is what their
    variance loses when the source is exact, and what sources share need not add up.

    Args:
        foreseen: the session.
        judged: its means.
    """
    fitted = is_fitted(foreseen.model, judged.errors)
    found = [Source(RANDOM, judged.means.random)]
    for name, columns, others in _columns(foreseen):
        share = _lost(foreseen, others) if fitted else _carried(judged, columns)
        if np.any(share > 0):
            found.append(Source(name, np.where(np.isnan(judged.means.mean), np.nan, share)))
    return found


def _columns(foreseen: Foreseen) -> Iterator[tuple[str, Array, Array]]:
    """Each source's columns of unit variance (n, 6, p), and those of all others."""
    comparison, clock = foreseen.comparison, foreseen.clock
    parts: dict[str, Array] = {}
    stated, exact = foreseen.systematics, replace(clock, standard_uncertainty=None)
    still = replace(comparison, alignment_error=np.zeros_like(comparison.alignment_error))
    still_pan = np.full(2, np.nan)
    for source in dict.fromkeys(stated.sources):
        keep = np.array([one == source for one in stated.sources])
        own = replace(stated, covariance=stated.covariance * np.outer(keep, keep), pan=still_pan)
        parts[source] = prior_columns(still, foreseen.track, exact, own)
    none = replace(stated, covariance=np.zeros_like(stated.covariance))
    parts[PAN] = prior_columns(still, foreseen.track, exact, none)
    if clock.standard_uncertainty:
        parts[CLOCK] = clock_effect(comparison) * clock.standard_uncertainty
    for name, columns in parts.items():
        rest = [other for key, other in parts.items() if key != name]
        yield name, columns, np.concatenate([*rest, np.zeros((len(comparison), 6, 0))], axis=2)


def _carried(judged: Judged, columns: Array) -> Array:
    """Standard uncertainty carried through the plain mean, (j,)."""
    known = ~np.isnan(judged.errors.error)
    weight = known / np.maximum(known.sum(axis=0), 1)
    share = np.einsum("ni,nij,njp->ip", weight, judged.inverse, columns)
    size: Array = np.linalg.norm(share, axis=1)
    return size


def _lost(foreseen: Foreseen, others: Array) -> Array:
    """What the fitted means' uncertainty loses when a source is exact, (j,)."""
    model = foreseen.model
    design = np.concatenate([model.offsets, model.fitted], axis=1)
    joints = model.offsets.shape[1]
    without = np.diag(solve(design, model.xi, model.white.rows(others)).covariance)[:joints]
    whole = np.diag(solve(design, model.xi, model.prior).covariance)[:joints]
    lost: Array = np.sqrt(np.maximum(whole - without, 0.0))
    return lost
