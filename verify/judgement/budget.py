"""Each joint's mean error taken apart: how much of its uncertainty comes from which source.

A GUM budget: every source with its kind (does it average out?), type (A or B), sensitivity, degrees
of freedom and contribution. All contributions go through one set of sensitivities, those by which
the means follow from the pairs, so they add up to the stated uncertainty.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from verify.clock import ClockEstimate
from verify.comparison import Comparison
from verify.joints import Joints
from verify.judgement.budget_gains import gains
from verify.judgement.budget_sources import (
    ALIGNMENT,
    CLOCK,
    LACK_OF_FIT,
    PAN,
    TABLE,
    Parameters,
    Random,
    random_sources,
    systematic_sources,
    table_columns,
)
from verify.judgement.means import (
    JointErrors,
    Means,
    coverage_factor,
    effective_degrees,
    is_fitted,
)
from verify.judgement.model import Model
from verify.judgement.resolved import Resolved
from verify.records import Array
from verify.session import Session
from verify.systematics import Systematics, unit
from verify.track import Track

__all__ = ["ALIGNMENT", "CLOCK", "COLUMNS", "PAN", "Budget", "budget"]

COLUMNS = [
    "joint", "source", "kind", "type", "standard_uncertainty_deg", "degrees_of_freedom", "share",
]  # fmt: skip
PARAMETER_COLUMNS = [
    "source", "parameter", "unit", "standard_uncertainty", "type", "degrees_of_freedom", "joint",
    "sensitivity_deg", "contribution_deg",
]  # fmt: skip
TOGETHER = "correlation of sources"
ROUNDING = 1e-9  # of a variance: what sums leave of nothing


@dataclass(frozen=True, slots=True)
class Budget:
    """What a session's budget holds; j joints."""

    lines: pd.DataFrame  # COLUMNS, a row a joint and source
    parameters: pd.DataFrame  # PARAMETER_COLUMNS, a row a joint and parameter
    random: Array  # (j,), standard uncertainty from what averages out, rad
    systematic: Array  # (j,), from what does not
    degrees: Array  # (j,), effective degrees of freedom; inf: without bound
    coverage_factor: Array  # (j,)


@dataclass(frozen=True, slots=True)
class _Line:
    source: str
    kind: str
    type: str
    variance: Array  # (j,), rad²; negative where correlated sources cancel
    degrees: Array  # (j,)


def budget(
    model: Model,
    plain: Comparison,
    joints: Joints,
    errors: JointErrors,
    means: Means,
    resolved: Resolved,
    session: Session,
    systematics: Systematics,
    track: Track,
    clock: ClockEstimate,
) -> Budget:
    """Take the mean errors' uncertainties apart.

    Args:
        model: the session's linear model.
        plain: its comparison before pairs that repeat each other were counted for fewer.
        joints: for how measured angles follow from measured poses.
        errors: joint errors a pair.
        means: what the sources add up to.
        resolved: the fit that means come from where no pair tells some joint's error.
        session: for the arm, the rig, and what is stated of the encoders.
        systematics: stated parameters.
        track: measured poses (pan readings).
        clock: the offset and how it came about.
    """
    by_pair = gains(model, errors, resolved, joints.inverse)
    fitted = is_fitted(model, errors)
    varying = random_sources(model, plain, track, session, systematics)
    held = systematic_sources(
        model.comparison, track, session.rig, clock, systematics, clock_fitted=fitted
    )
    own = _degrees_of_noise(resolved, means, fitted=fitted)
    lines = [*_random(varying, by_pair, own), *_systematic(held, by_pair)]
    if fitted and not model.through_encoders and resolved.misfit > 1:
        lacking = (resolved.misfit - 1) * sum(line.variance for line in lines)
        lines.append(_Line(LACK_OF_FIT, "random", "A", np.asarray(lacking), own))
    known = ~np.isnan(means.mean)
    random, systematic = (
        np.where(known, sum((li.variance for li in lines if li.kind == k), 0.0), np.nan)
        for k in ("random", "systematic")
    )
    noise = [li.variance for li in lines if li.kind == "random" and li.degrees is own]
    degrees = effective_degrees(
        random + systematic, np.sum(noise, axis=0), own, *_calibrated(held, by_pair)
    )
    return Budget(
        lines=_table(lines, random + systematic),
        parameters=_parameters(held, session, model.comparison, by_pair),
        random=np.sqrt(np.maximum(random, 0.0)),
        systematic=np.sqrt(np.maximum(systematic, 0.0)),
        degrees=degrees,
        coverage_factor=coverage_factor(degrees),
    )


def _degrees_of_noise(resolved: Resolved, means: Means, *, fitted: bool) -> Array:
    """Degrees of freedom of what the session itself shows of its noise, (j,)."""
    if fitted:
        return np.full(len(means.mean), max(float(resolved.fit.degrees_of_freedom), 1.0))
    # six coordinates a pair share the noise estimate
    degrees: Array = np.maximum(6.0 * means.pairs - 6, 1.0)
    return degrees


def _random(sources: list[Random], by_pair: Array, own: Array) -> Iterator[_Line]:
    for source in sources:
        variance = np.einsum("njk,nkl,njl->j", by_pair, source.covariance, by_pair)
        degrees = own if source.type == "A" else np.full(len(own), np.inf)
        yield _Line(source.source, "random", source.type, variance, degrees)


def _systematic(held: Parameters, by_pair: Array) -> Iterator[_Line]:
    sensitivity = np.einsum("njk,nkp->jp", by_pair, held.columns)
    for source in dict.fromkeys(held.sources):
        mine = np.flatnonzero([s == source for s in held.sources])
        part = sensitivity[:, mine]
        variance = np.einsum("jp,pq,jq->j", part, held.covariance[np.ix_(mine, mine)], part)
        degrees = np.full(len(part), held.degrees[mine].min())
        yield _Line(source, "systematic", held.types[mine[0]], variance, degrees)
    alike = np.array(held.sources)[:, None] == np.array(held.sources)[None]
    between = np.where(alike, 0.0, held.covariance) if len(held.sources) else held.covariance
    if between.any():
        variance = np.einsum("jp,pq,jq->j", sensitivity, between, sensitivity)
        yield _Line(TOGETHER, "systematic", "B", variance, np.full(len(variance), np.inf))


def _calibrated(held: Parameters, by_pair: Array) -> tuple[Array, float]:
    """Variance from all that one calibration found, and its degrees of freedom."""
    mine = np.flatnonzero(np.isfinite(held.degrees))
    part = np.einsum("njk,nkp->jp", by_pair, held.columns[:, :, mine])
    variance = np.einsum("jp,pq,jq->j", part, held.covariance[np.ix_(mine, mine)], part)
    return variance, float(held.degrees[mine].min(initial=np.inf))


def _table(lines: list[_Line], total: Array) -> pd.DataFrame:
    rows = []
    for line in lines:
        with np.errstate(invalid="ignore", divide="ignore"):
            share = line.variance / total
        if not np.any(np.abs(share) > ROUNDING):
            continue
        size = np.rad2deg(np.sqrt(np.abs(line.variance)) * np.sign(line.variance))
        rows += [
            (
                j + 1,
                line.source,
                line.kind,
                line.type,
                float(size[j]),
                float(line.degrees[j]),
                float(share[j]),
            )
            for j in range(len(total))
        ]
    return pd.DataFrame(rows, columns=COLUMNS)


def _parameters(
    held: Parameters, session: Session, comparison: Comparison, by_pair: Array
) -> pd.DataFrame:
    """Every parameter with its sensitivity, those of the robot's table without an uncertainty."""
    names, columns = table_columns(session.arm, comparison)
    everything = np.concatenate([held.columns, columns], axis=2)
    u = np.concatenate([np.sqrt(np.diag(held.covariance)), np.full(len(names), np.nan)])
    sources = [*held.sources, *[TABLE] * len(names)]
    types = [*held.types, *["B"] * len(names)]
    degrees = [*held.degrees.tolist(), *[np.nan] * len(names)]
    sensitivity = np.rad2deg(np.einsum("njk,nkp->pj", by_pair, everything))
    rows = []
    every = [*held.names, *names]
    for name in dict.fromkeys(every):
        alike = [p for p, other in enumerate(every) if other == name]
        p = alike[0]
        scale, suffix = unit(name), name.rsplit("_", 1)[-1]
        # errors of single pan readings: independent of each other, of one size
        effect = sensitivity[p] if len(alike) == 1 else np.linalg.norm(sensitivity[alike], axis=0)
        for j, each in enumerate(effect.tolist()):
            rows.append(
                (
                    sources[p], name, suffix if suffix in ("mm", "deg", "px", "s") else "1",
                    float(u[p] / scale), types[p], degrees[p], j + 1, each * scale,
                    abs(each) * float(u[p]),
                )
            )  # fmt: skip
    return pd.DataFrame(rows, columns=PARAMETER_COLUMNS)
