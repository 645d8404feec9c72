"""Uncertainty budget (GUM) of each joint's mean error, source by source.

Each source has its kind (does it average out?), type (A or B), degrees of freedom, sensitivity and
contribution. All contributions go through one set of sensitivities, those by which the means follow
from the pairs, so they add up to the stated uncertainty.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

import robots
from verify.analysis.comparison import Comparison
from verify.analysis.joint_errors import (
    ResolvedErrors,
    coverage_factor,
    effective_degrees,
    mean_sensitivities,
)
from verify.analysis.model import JointErrorModel, SessionComparison
from verify.analysis.uncertainty.sources import (
    CAUSES,
    LACK_OF_FIT,
    ROBOT_TABLE,
    RandomSource,
    SystematicSources,
    UnstatedEffect,
    random_sources,
    robot_table_columns,
    systematic_sources,
    unstated_effects,
    unstated_sources,
)
from verify.core.records import Array
from verify.measurement.systematics import unit

BUDGET_COLUMNS = [
    "joint", "source", "kind", "type", "standard_uncertainty_deg", "degrees_of_freedom", "share",
]  # fmt: skip
PARAMETER_COLUMNS = [
    "source", "parameter", "unit", "standard_uncertainty", "type", "degrees_of_freedom", "joint",
    "sensitivity_deg", "contribution_deg",
]  # fmt: skip
CORRELATION_SOURCE = "correlation of sources"
TOL_VARIANCE = 1e-9  # of a variance: what sums leave of nothing


@dataclass(frozen=True, slots=True)
class Budget:
    """What a session's budget holds; j joints."""

    lines: pd.DataFrame  # BUDGET_COLUMNS, a row a joint and source
    parameters: pd.DataFrame  # PARAMETER_COLUMNS, a row a joint and parameter
    random: Array  # (j,), standard uncertainty from what averages out, rad
    systematic: Array  # (j,), from what does not
    degrees: Array  # (j,), effective degrees of freedom; inf: without bound
    coverage_factor: Array  # (j,)
    uncounted: tuple[str, ...]  # sources that state no uncertainty and are taken as exact
    unstated: tuple[UnstatedEffect, ...]  # what errors of theirs would do


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """A source and what it contributes; j joints."""

    source: str
    kind: str
    type: str
    variance: Array  # (j,), rad²; negative where correlated sources cancel
    degrees: Array  # (j,)


def budget(
    model: JointErrorModel,
    compared: SessionComparison,
    resolved: ResolvedErrors,
) -> Budget:
    """Take apart the uncertainties of the means that `resolved`, the fit, gave.

    `compared` is the session before pairs that repeat each other were counted for fewer.
    """
    by_row = mean_sensitivities(model, resolved)
    by_pair = pair_sensitivities(model, by_row)
    varying = random_sources(model, compared)
    held = systematic_sources(
        model.comparison, compared.track, compared.clock, compared.systematics,
        compared.session.rig,
    )  # fmt: skip
    exact = unstated_sources(compared.systematics, compared.clock)
    own = np.full(len(resolved.mean), max(float(resolved.fit.degrees_of_freedom), 1.0))
    lines = [*_random_lines(varying, by_pair, own), *systematic_lines(held, by_pair)]
    if resolved.common.shape[1]:
        common = np.sum((by_row @ resolved.common) ** 2, axis=1)
        lines.append(BudgetLine(CAUSES, "systematic", "A", common, own))
    if resolved.misfit > 1:
        lacking = (resolved.misfit - 1) * sum(line.variance for line in lines)
        lines.append(BudgetLine(LACK_OF_FIT, "random", "A", np.asarray(lacking), own))
    known = ~np.isnan(resolved.mean)
    random, systematic = (
        np.where(known, sum((li.variance for li in lines if li.kind == k), 0.0), np.nan)
        for k in ("random", "systematic")
    )
    shown = [li.variance for li in lines if li.degrees is own]
    degrees = effective_degrees(
        random + systematic, np.sum(shown, axis=0), own, *calibration_variance(held, by_pair)
    )
    return Budget(
        lines=_table(lines, random + systematic),
        parameters=_parameters(held, compared.session.arm, model.comparison, by_pair),
        random=np.sqrt(np.maximum(random, 0.0)),
        systematic=np.sqrt(np.maximum(systematic, 0.0)),
        degrees=degrees,
        coverage_factor=coverage_factor(degrees),
        uncounted=exact,
        unstated=tuple(unstated_effects(model.comparison, compared, exact, by_pair)),
    )


def pair_sensitivities(model: JointErrorModel, by_row: Array) -> Array:
    """Take derivatives by whitened rows (j, r) to those by the pairs' twists, (n, j, 6)."""
    factors = model.white.factors
    ends = np.cumsum([len(f) for f in factors])
    parts = np.split(by_row, ends[:-1], axis=1)
    return np.array([part @ factor for part, factor in zip(parts, factors, strict=True)])


def _random_lines(sources: list[RandomSource], by_pair: Array, own: Array) -> Iterator[BudgetLine]:
    for source in sources:
        variance = np.einsum("njk,nkl,njl->j", by_pair, source.covariance, by_pair)
        degrees = own if source.type == "A" else np.full(len(own), np.inf)
        yield BudgetLine(source.source, "random", source.type, variance, degrees)


def systematic_lines(held: SystematicSources, by_pair: Array) -> Iterator[BudgetLine]:
    """Carry what does not average out to the means, source by source; `by_pair` (n, j, 6)."""
    sensitivity = np.einsum("njk,nkp->jp", by_pair, held.columns)
    for source in dict.fromkeys(held.sources):
        mine = np.flatnonzero([s == source for s in held.sources])
        part = sensitivity[:, mine]
        variance = np.einsum("jp,pq,jq->j", part, held.covariance[np.ix_(mine, mine)], part)
        degrees = np.full(len(part), held.degrees[mine].min())
        yield BudgetLine(source, "systematic", held.types[mine[0]], variance, degrees)
    alike = np.array(held.sources)[:, None] == np.array(held.sources)[None]
    between = np.where(alike, 0.0, held.covariance) if len(held.sources) else held.covariance
    if between.any():
        variance = np.einsum("jp,pq,jq->j", sensitivity, between, sensitivity)
        yield BudgetLine(
            CORRELATION_SOURCE, "systematic", "B", variance, np.full(len(variance), np.inf)
        )


def calibration_variance(held: SystematicSources, by_pair: Array) -> tuple[Array, float]:
    """Variance from all that one calibration found, and its degrees of freedom."""
    mine = np.flatnonzero(np.isfinite(held.degrees))
    part = np.einsum("njk,nkp->jp", by_pair, held.columns[:, :, mine])
    variance = np.einsum("jp,pq,jq->j", part, held.covariance[np.ix_(mine, mine)], part)
    return variance, float(held.degrees[mine].min(initial=np.inf))


def _table(lines: list[BudgetLine], total: Array) -> pd.DataFrame:
    rows = []
    for line in lines:
        with np.errstate(invalid="ignore", divide="ignore"):
            share = line.variance / total
        if not np.any(np.abs(share) > TOL_VARIANCE):
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
    return pd.DataFrame(rows, columns=BUDGET_COLUMNS)


def _parameters(
    held: SystematicSources, arm: robots.Arm, comparison: Comparison, by_pair: Array
) -> pd.DataFrame:
    """Every parameter with its sensitivity, those of the robot's table without an uncertainty."""
    names, columns = robot_table_columns(arm, comparison)
    everything = np.concatenate([held.columns, columns], axis=2)
    u = np.concatenate([np.sqrt(np.diag(held.covariance)), np.full(len(names), np.nan)])
    sources = [*held.sources, *[ROBOT_TABLE] * len(names)]
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
