"""Scatter of what errs from pair to pair: the pan readings, or a board between left and right.

Each errs by e ~ N(0, s²), s the same for all of a kind. With the information J (m, m) on the m
errors and the gradient g at e = 0, everything else eliminated, the restricted likelihood of s is,
in the eigenvectors of J with values j and gradients h:

    -2 log L(s) = sum of log(1 + s² j) - s² h² / (1 + s² j)

What is stated is the mean of s² over its posterior with Jeffreys' prior, so few pairs, which leave
s itself uncertain, state more. An s that is not significant may be there all the same.

Parameter: s, rad or m, on a grid of log s. Source: Patterson and Thompson, Biometrika 58, 1971, of
the restricted likelihood; Jeffreys, Proc. R. Soc. Lond. A 186, 1946, of the prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from verify.calibration.stereo.estimate import Estimate, inverse_root, readjust
from verify.calibration.stereo.parameters import CornerStack
from verify.core.records import Array

MIN_SCATTER, MAX_SCATTER = 1e-7, 0.1  # rad or m
N_GRID = 600  # scatters that are tried: 2 % apart, far less than a tenth of their uncertainty
MIN_LOG_LIKELIHOOD = 1.35  # gain over no scatter: 5 % by chance, as it cannot be negative
TOL_INFORMATION = 1e-12  # of the largest information
MAX_ROUNDS = 6
TOL_SCATTER = 0.03  # relative change of the scatter: far below its own uncertainty


@dataclass(frozen=True, slots=True)
class ErrorScatter:
    """Standard deviation of the errors of one kind."""

    deviation: float  # rad or m; where not significant, what may be there unseen
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
    """Find the scatter of errors that are free in an adjustment; visible if it gains so much."""
    information, pull = _error_information(found, list(columns))
    size, directions = np.linalg.eigh(information)
    some = size > TOL_INFORMATION * size[-1]  # the others are gauge
    size, along = size[some], (directions.T @ pull)[some]
    variance = np.geomspace(MIN_SCATTER, MAX_SCATTER, N_GRID) ** 2
    ratio = variance[:, None] * size
    gained = variance[:, None] * along**2 / (1 + ratio)
    loss = 0.5 * np.sum(np.log1p(ratio) - gained, axis=1)
    prior = np.linalg.norm(ratio / (1 + ratio), axis=1)  # Jeffreys', for log s
    weight = prior * np.exp(loss.min() - loss)
    mean = float(weight @ variance / weight.sum())
    return ErrorScatter(float(np.sqrt(mean)), visible=bool(loss.min() < -gain))


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
    rig, rig_pull = system.prior, system.prior_gradient
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
