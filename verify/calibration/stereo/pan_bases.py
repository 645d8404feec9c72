"""The turning bases: which turned, far enough to determine their axes, and their readings' scatter.

Each reading errs by e ~ N(0, s²), s the same for both bases. With the information J (m, m) on the
m pan errors and the gradient g at e = 0, everything else eliminated, s maximises the restricted
likelihood, in the eigenvectors of J with values j and gradients h:

    -2 log L(s) = sum of log(1 + s² j) - s² h² / (1 + s² j)

Parameter: s, rad, found over log s. Few pairs leave s itself uncertain: it is enlarged as Student's
distribution is wider than the normal one. Where s is not significant the readings are exact in the
adjustment, and the s that could remain unnoticed is stated.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from verify.calibration.stereo.estimate import Estimate, invert, readjust
from verify.calibration.stereo.gauge import BASE_CENTRED, BASE_FIXED, BASE_TURNING
from verify.calibration.stereo.parameters import (
    PAR_AXIS,
    PAR_OFFSET,
    SIDES,
    CornerStack,
    camera_columns,
)
from verify.core.records import Array

MIN_SCATTER, MAX_SCATTER = np.deg2rad(1e-5), np.deg2rad(5.0)
MIN_LOG_LIKELIHOOD = 1.35  # gain over no scatter: 5 % by chance, as it cannot be negative
MIN_DOF = 5.0  # degrees of freedom of the deviation
TOL_INFORMATION = 1e-12  # of the largest information
LOG_LIKELIHOOD_ONE_SIGMA = 0.5  # within which a deviation could remain unnoticed
MIN_TURN = 1e-9  # rad: readings that differ by less are the same number
MAX_AXIS_UNCERTAINTY = np.deg2rad(3.0)  # above it an axis is not determined
MAX_OFFSET_UNCERTAINTY = 0.02  # m, above it the axis's distance from the camera is not determined
START_SIGMA = np.deg2rad(0.1)  # a poor base; the pictures give the scatter later
MAX_ROUNDS = 6
TOL_SCATTER = 0.03  # relative change of the scatter: far below its own uncertainty


@dataclass(frozen=True, slots=True)
class PanScatter:
    """Standard deviation of a pan reading."""

    deviation: float  # rad; where it is not significant, the largest that may remain unnoticed
    visible: bool


def base_kinds(readings: Array) -> tuple[str, str]:
    """Classify each base as turning or fixed by its readings (b, 2), rad."""
    left, right = (BASE_TURNING if np.ptp(side) > MIN_TURN else BASE_FIXED for side in readings.T)
    return left, right


def start_precision(bases: tuple[str, str], noise: float = 1.0) -> float:
    """Weight of a pan reading at first, 1/rad²; `noise`: factor on the corners' uncertainty."""
    return float("inf") if bases == (BASE_FIXED, BASE_FIXED) else (noise / START_SIGMA) ** 2


def settle_bases(
    found: Estimate, corners: CornerStack
) -> tuple[Estimate, PanScatter | None, list[str]]:
    """Find the readings' scatter, then hold what the bases' turns do not determine.

    Returns:
        The estimate, the scatter (None where no base turned), and a sentence a base that is held.
    """
    found, scatter = adjust_with_scatter(found, corners)
    kinds, sentences = _determined_bases(found)
    if kinds == found.model.bases:
        return found, scatter, sentences
    model = replace(found.model, bases=kinds, pan_precision=start_precision(kinds, found.noise))
    found = readjust(_without_pan_errors(found), corners, model)
    return (*adjust_with_scatter(found, corners), sentences)


def _without_pan_errors(found: Estimate) -> Estimate:
    state = replace(found.state, pan_error=np.zeros_like(found.state.pan_error))
    return replace(found, state=state)


def _determined_bases(found: Estimate) -> tuple[tuple[str, str], list[str]]:
    """Choose the kind of each base by what its turn determines, and explain each choice."""
    kinds, sentences = list(found.model.bases), []
    u = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    for index, side in enumerate(SIDES):
        own = u[camera_columns(index)]
        if kinds[index] == BASE_FIXED:
            continue
        axis, offset = float(own[PAR_AXIS].max()), float(own[PAR_OFFSET].max())
        if axis > MAX_AXIS_UNCERTAINTY:
            kinds[index] = BASE_FIXED
            sentences.append(
                f"{side} base: turned too little to show its axis (± {np.rad2deg(axis):.0f}°); "
                "taken as +y through the optical centre."
            )
        elif offset > MAX_OFFSET_UNCERTAINTY:
            kinds[index] = BASE_CENTRED
            sentences.append(
                f"{side} base: turned too little to show where its axis passes the camera "
                f"(± {1e3 * offset:.0f} mm); taken through the optical centre."
            )
    return (kinds[0], kinds[1]), sentences


def adjust_with_scatter(
    found: Estimate, corners: CornerStack
) -> tuple[Estimate, PanScatter | None]:
    """Find the readings' scatter and adjust with it; None where no base turned."""
    if not found.model.pan_errors:
        return found, None
    scatter = reading_scatter(found)
    for _ in range(MAX_ROUNDS):
        precision = (found.noise / scatter.deviation) ** 2 if scatter.visible else float("inf")
        model = replace(found.model, pan_precision=precision)
        if not scatter.visible:
            return readjust(_without_pan_errors(found), corners, model), scatter
        found = readjust(found, corners, model)
        before, scatter = scatter, reading_scatter(found)
        if abs(scatter.deviation - before.deviation) < TOL_SCATTER * before.deviation:
            break
    return found, scatter


def base_sentences(found: Estimate, scatter: PanScatter | None, readings: Array) -> Iterator[str]:
    """Describe what was found and chosen of each base, and the readings' scatter."""
    for side, base, values in zip(SIDES, found.model.bases, readings.T, strict=True):
        if base == BASE_FIXED and np.ptp(values) <= MIN_TURN:
            yield (
                f"{side} base: not turned, so its axis cannot be seen: pan centre at the optical "
                "centre, axis +y, zero 0; the camera's orientation is its mount's."
            )
        elif base != BASE_FIXED:
            yield (
                f"{side} base: turned over {np.rad2deg(np.ptp(values)):.1f}°; its place along its "
                "axis is chosen (mount offset 0 along the axis), and so is the mount's turn about "
                "it (0, in the pan zero instead)."
            )
    if scatter is not None and scatter.visible:
        yield (
            f"pan readings: scatter by {np.rad2deg(scatter.deviation):.2g}°, which was allowed for."
        )
    elif scatter is not None:
        yield (
            "pan readings: no scatter is visible, taken as exact; "
            f"{np.rad2deg(scatter.deviation):.1g}° could hide and is stated."
        )


def reading_scatter(found: Estimate) -> PanScatter:
    """Find the readings' scatter from an adjustment with pan errors.

    Source: restricted maximum likelihood of a variance component, Patterson and Thompson,
    Biometrika 58, 1971.
    """
    information, pull = _reading_information(found)
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
    if least < -MIN_LOG_LIKELIHOOD:
        ratio = np.exp(2 * at) * size
        degrees = max(float(np.sum((ratio / (1 + ratio)) ** 2)), MIN_DOF)
        return PanScatter(float(np.exp(at) * np.sqrt(degrees / (degrees - 2))), visible=True)
    hidden = [g for g in grid if loss(g) < min(least, 0.0) + LOG_LIKELIHOOD_ONE_SIGMA]
    return PanScatter(float(np.exp(max(hidden, default=grid[0]))), visible=False)


def _reading_information(found: Estimate) -> tuple[Array, Array]:
    """Information (m, m) on all pan errors and the gradient (m,), at exact readings.

    Board poses and rig parameters are eliminated; the corners' noise is the estimated one.
    """
    turned = np.flatnonzero([base != BASE_FIXED for base in found.model.bases])
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
    inverse = invert(found.basis.T @ rig @ found.basis)
    information = block_diag(*blocks) - through @ inverse @ through.T
    pull = np.concatenate(pulls) - through @ inverse @ (found.basis.T @ rig_pull)
    return information / found.noise**2, pull / found.noise**2
