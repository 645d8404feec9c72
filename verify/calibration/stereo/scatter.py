"""Scatter of what errs from pair to pair: the pan readings, or a board between left and right.

Each errs by e ~ N(0, s²), s the same for all of a kind. With the information J (m, m) on the m
errors and the gradient g at e = 0, everything else eliminated, s maximises the restricted
likelihood, in the eigenvectors of J with values j and gradients h:

    -2 log L(s) = sum of log(1 + s² j) - s² h² / (1 + s² j)

Parameter: s, rad or m, found over log s. Few pairs leave s itself uncertain: it is enlarged as
Student's distribution is wider than the normal one. Where s is not significant the errors are 0 in
the adjustment, and the s that could remain unnoticed is stated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from verify.calibration.stereo.estimate import Estimate, inverse_root, readjust
from verify.calibration.stereo.parameters import CornerStack
from verify.core.records import Array

MIN_SCATTER, MAX_SCATTER = 1e-7, 0.1  # rad or m
MIN_LOG_LIKELIHOOD = 1.35  # gain over no scatter: 5 % by chance, as it cannot be negative
MIN_DOF = 5.0  # degrees of freedom of the deviation
TOL_INFORMATION = 1e-12  # of the largest information
LOG_LIKELIHOOD_ONE_SIGMA = 0.5  # within which a deviation could remain unnoticed
MAX_ROUNDS = 6
TOL_SCATTER = 0.03  # relative change of the scatter: far below its own uncertainty


@dataclass(frozen=True, slots=True)
class ErrorScatter:
    """Standard deviation of the errors of one kind."""

    deviation: float  # rad or m; where not significant, the largest that may remain unnoticed
    visible: bool


def adjust_with_scatter(
    found: Estimate,
    corners: CornerStack,
    kinds: Sequence[Sequence[int]],
    gain: float = MIN_LOG_LIKELIHOOD,
) -> tuple[Estimate, list[ErrorScatter]]:
    """Find the scatter of each kind of error that is free, and adjust with it.

    A kind is the columns of a pair's errors that share a scatter; all are free in `found`. One that
    gains less in log likelihood than `gain` is not visible.
    """
    scatters: dict[int, ErrorScatter] = {}
    for _ in range(MAX_ROUNDS):
        before = dict(scatters)
        precision, errors = np.full(found.state.errors.shape[1], np.inf), found.state.errors.copy()
        for k, own in enumerate(kinds):
            if k not in before or before[k].visible:
                scatters[k] = error_scatter(found, own, gain)
            if scatters[k].visible:
                precision[list(own)] = (found.noise / scatters[k].deviation) ** 2
            else:
                errors[:, list(own)] = 0.0
        found = replace(found, state=replace(found.state, errors=errors))
        found = readjust(found, corners, replace(found.model, precision=precision))
        if all(
            not now.visible
            or (k in before and abs(now.deviation / before[k].deviation - 1) < TOL_SCATTER)
            for k, now in scatters.items()
        ):
            break
    return found, list(scatters.values())


def error_scatter(
    found: Estimate, columns: Sequence[int], gain: float = MIN_LOG_LIKELIHOOD
) -> ErrorScatter:
    """Find the scatter of errors that are free in an adjustment; visible if it gains so much.

    Source: restricted maximum likelihood of a variance component, Patterson and Thompson,
    Biometrika 58, 1971.
    """
    information, pull = _error_information(found, list(columns))
    size, directions = np.linalg.eigh(information)
    along = (directions.T @ pull)[size > TOL_INFORMATION * size[-1]]
    size = size[size > TOL_INFORMATION * size[-1]]  # the others are gauge

    def loss(log: float) -> float:
        variance = np.exp(2 * log)
        gained = variance * along**2 / (1 + variance * size)
        return float(0.5 * np.sum(np.log1p(variance * size) - gained))

    grid = np.linspace(np.log(MIN_SCATTER), np.log(MAX_SCATTER), 60)
    middle = grid[int(np.argmin([loss(g) for g in grid]))]
    best = minimize_scalar(loss, bounds=(middle - 0.3, middle + 0.3), method="bounded")
    least, at = float(best.fun), float(best.x)
    if least < -gain:
        ratio = np.exp(2 * at) * size
        degrees = max(float(np.sum((ratio / (1 + ratio)) ** 2)), MIN_DOF)
        return ErrorScatter(float(np.exp(at) * np.sqrt(degrees / (degrees - 2))), visible=True)
    hidden = [g for g in grid if loss(g) < min(least, 0.0) + LOG_LIKELIHOOD_ONE_SIGMA]
    return ErrorScatter(float(np.exp(max(hidden, default=grid[0]))), visible=False)


def _error_information(found: Estimate, columns: list[int]) -> tuple[Array, Array]:
    """Information (m, m) on some free errors of all pairs and the gradient (m,), where they are 0.

    Board poses, other errors and shared parameters are eliminated; the corners' noise is the
    estimated one.
    """
    precision = found.model.precision
    others = [i for i in np.flatnonzero(np.isfinite(precision)).tolist() if i not in columns]
    own = [*range(6), *(6 + i for i in others), *(6 + i for i in columns)]
    count = 6 + len(others)
    prior = np.concatenate([np.zeros(count), precision[columns]])
    between, blocks, pulls = [], [], []
    system = found.system
    rig, rig_pull = system.lens, system.lens_gradient
    for b, error in enumerate(found.state.errors[:, columns]):
        with_prior = np.linalg.inv(system.own[b][np.ix_(own, own)])
        inner = with_prior - np.diag(prior)
        across = with_prior @ system.shared[b][own]
        pull = system.own_gradient[b][own] + inner[:, count:] @ error  # about errors of 0
        pull[count:] += prior[count:] * error
        pose = np.linalg.inv(inner[:count, :count])
        left_over = across[count:] - inner[count:, :count] @ pose @ across[:count]
        full = system.information[b] + across.T @ system.shared[b][own]
        to_rig = system.gradient[b] + system.shared[b][own].T @ system.own_gradient[b][own]
        to_rig = to_rig + across[count:].T @ error
        rig = rig + full - across[:count].T @ pose @ across[:count]
        rig_pull = rig_pull + to_rig - across[:count].T @ pose @ pull[:count]
        between.append(left_over @ found.basis)
        blocks.append(inner[count:, count:] - inner[count:, :count] @ pose @ inner[:count, count:])
        pulls.append(pull[count:] - inner[count:, :count] @ pose @ pull[:count])
    through = np.concatenate(between)
    root = inverse_root(found.basis.T @ rig @ found.basis)
    through = through @ root.T
    information = block_diag(*blocks) - through @ through.T
    pull = np.concatenate(pulls) - through @ (root @ found.basis.T @ rig_pull)
    return information / found.noise**2, pull / found.noise**2
