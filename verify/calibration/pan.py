"""How far turned bases stand off their readings, as the pictures show it.

Each reading may be off by a random error of one standard deviation, the same for both bases: a
pair shows the difference of the two far better than either. The deviation is found by maximum
likelihood with everything else eliminated. Few pairs leave the deviation itself uncertain; it is
enlarged as Student's distribution is wider than the normal one, so that what rests on it is covered
as stated. Where none is visible, readings are exact in the adjustment, and what could hide there
is stated.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from verify.calibration.estimate import Estimate, inverted
from verify.calibration.gauge import FIXED
from verify.records import Array

SMALLEST, LARGEST = np.deg2rad(1e-5), np.deg2rad(5.0)
VISIBLE = 1.35  # of log likelihood over no scatter at all: 5 % by chance, as it cannot be negative
FEWEST_DEGREES = 5.0  # of freedom, of the deviation
ROUNDING = 1e-12  # of the largest information
ONE_SIGMA = 0.5  # of log likelihood: where a deviation could still hide


@dataclass(frozen=True, slots=True)
class Scatter:
    """Of a pan reading."""

    deviation: float  # rad, standard deviation; where none is visible, the largest that may hide
    visible: bool


def scatter(found: Estimate) -> Scatter:
    """Find the readings' scatter from an adjustment that let the bases stand off a little.

    Source: restricted maximum likelihood of a variance component, Patterson and Thompson,
    Biometrika 58, 1971.
    """
    information, pull = _of_readings(found)
    size, directions = np.linalg.eigh(information)
    along = (directions.T @ pull)[size > ROUNDING * size[-1]]
    size = size[size > ROUNDING * size[-1]]  # the others are gauge and say nothing

    def loss(log: float) -> float:
        variance = np.exp(2 * log)
        gained = variance * along**2 / (1 + variance * size)
        return float(0.5 * np.sum(np.log1p(variance * size) - gained))

    grid = np.linspace(np.log(SMALLEST), np.log(LARGEST), 60)
    middle = grid[int(np.argmin([loss(g) for g in grid]))]
    best = minimize_scalar(loss, bounds=(middle - 0.3, middle + 0.3), method="bounded")
    least, at = float(best.fun), float(best.x)
    if least < -VISIBLE:
        shown = np.exp(2 * at) * size
        degrees = max(float(np.sum((shown / (1 + shown)) ** 2)), FEWEST_DEGREES)
        return Scatter(float(np.exp(at) * np.sqrt(degrees / (degrees - 2))), visible=True)
    hides = [g for g in grid if loss(g) < min(least, 0.0) + ONE_SIGMA]
    return Scatter(float(np.exp(max(hides, default=grid[0]))), visible=False)


def _of_readings(found: Estimate) -> tuple[Array, Array]:
    """Information on every reading's error, and the pull towards one, about exact readings.

    Board poses and the rig's parameters are eliminated; the corners' noise is what it turned out.
    """
    turned = np.flatnonzero([base != FIXED for base in found.model.bases])
    own = np.concatenate([np.arange(6), 6 + turned])
    prior = np.concatenate([np.zeros(6), np.full(len(turned), found.model.pan_precision)])
    rig, rig_pull = 0.0, 0.0
    between, blocks, pulls = [], [], []
    system = found.system
    for b, error in enumerate(found.state.pan_error[:, turned]):
        with_prior = np.linalg.inv(system.own[b][np.ix_(own, own)])
        inner = with_prior - np.diag(prior)
        across = with_prior @ system.shared[b][own]
        pull = system.own_gradient[b][own] + inner[:, 6:] @ error  # about exact readings
        pull[6:] += prior[6:] * error
        pose = np.linalg.inv(inner[:6, :6])
        left_over = across[6:] - inner[6:, :6] @ pose @ across[:6]
        full = system.information[b] + across.T @ system.shared[b][own]
        to_rig = system.gradient[b] + system.shared[b][own].T @ system.own_gradient[b][own]
        to_rig = to_rig + across[6:].T @ error
        rig = rig + full - across[:6].T @ pose @ across[:6]
        rig_pull = rig_pull + to_rig - across[:6].T @ pose @ pull[:6]
        between.append(left_over @ found.basis)
        blocks.append(inner[6:, 6:] - inner[6:, :6] @ pose @ inner[:6, 6:])
        pulls.append(pull[6:] - inner[6:, :6] @ pose @ pull[:6])
    through = np.concatenate(between)
    inverse = inverted(found.basis.T @ rig @ found.basis)
    information = block_diag(*blocks) - through @ inverse @ through.T
    pull = np.concatenate(pulls) - through @ inverse @ (found.basis.T @ rig_pull)
    return information / found.noise**2, pull / found.noise**2
