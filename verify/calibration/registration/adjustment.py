"""Bundle adjustment of base, LEDs, clock and skew on the pixels of a whole session.

The readings' own noise moves all spots of a pair together, so each pair's pixels have one full
covariance: the spots' own and, through the arm's Jacobian, the readings'.
"""

from dataclasses import dataclass, replace

import numpy as np

import robots
from verify.analysis.least_squares import autocorrelation, gauss_newton
from verify.calibration.registration.model import (
    PredictedSpots,
    RegistrationParameters,
    SpotStack,
    predict_spots,
    shared_noise,
)
from verify.core.readings import Readings
from verify.core.records import Array, Flags, Index
from verify.core.rig import Rig
from verify.measurement.pose import MAX_SPOT_CHI2, MODEL_ERROR_PX

MAX_ITERATIONS = 40
TOL_STEP = 1e-9  # of a step in units of m, rad and s: a hundredth of any uncertainty here
# a joint fault must not pass for wrong spots: poses are left open
JOINT_PRIOR_SIGMA = np.deg2rad(1.0)
MAX_ROUNDS = 8  # of rejection
TOL_RANK = 1e-12  # of the largest eigenvalue, with unit diagonal: rounding


@dataclass(frozen=True, slots=True)
class AdjustmentSetup:
    """Everything that an adjustment takes as given."""

    rig: Rig
    arm: robots.Arm
    readings: Readings
    variance: Array  # (j,), rad², of one joint reading
    time_variance: float  # s², of a reading's time stamp
    clock: tuple[float, float] | None  # s: stated offset and its standard uncertainty


@dataclass(frozen=True, slots=True)
class WhitenedRows:
    """A session whitened: r rows, of unit variance if the stated noise is all there is."""

    pair: Index  # (r,)
    pose: Flags  # (r,), rows that a motion of the flange explains; others: the shape
    place: Index  # (r,), which of a pair's six pose rows; -1 for others
    residual: Array  # (r,)
    design: Array  # (r, size)
    joints: Array  # (r, j)


@dataclass(frozen=True, slots=True)
class AdjustedRegistration:
    """An adjusted registration."""

    at: RegistrationParameters
    free: Flags  # (size,), parameters that were adjusted
    spotted: SpotStack
    predicted: PredictedSpots
    rows: WhitenedRows
    inverse: Array  # (size, size), of the information; 0 for what was held
    gain: Array  # (size, 2 s), d parameters / d spots; 0 for spots that were refused
    covariance: Array  # (size, size), with what the residuals show beside the stated noise
    chi2: float
    degrees_of_freedom: int
    inflation: float  # what the residuals' spread multiplies the pose rows' variance with


def adjust(
    spotted: SpotStack, setup: AdjustmentSetup, start: RegistrationParameters, free: Flags
) -> AdjustedRegistration:
    """Adjust what is `free` (size,) to all spots, refusing those that the others contradict."""
    at = start
    for _ in range(MAX_ROUNDS):
        at = _fit_parameters(spotted, setup, at, free)
        seen = predict_spots(spotted, setup.rig, setup.arm, setup.readings, at)
        refused = _worst_spots(spotted, seen)
        if not refused.any():
            break
        spotted = replace(spotted, used=spotted.used & ~refused)
    return _estimate_covariance(spotted, setup, at, free)


def _fit_parameters(
    spotted: SpotStack, setup: AdjustmentSetup, at: RegistrationParameters, free: Flags
) -> RegistrationParameters:
    def solve_step(at: RegistrationParameters) -> tuple[Array, None]:
        predicted = predict_spots(spotted, setup.rig, setup.arm, setup.readings, at)
        rows = whiten_pairs(spotted, predicted, setup)
        design = rows.design[:, free]
        design, residual = _append_stated_clock(design, rows.residual, free, setup, at)
        step = np.zeros(at.size)
        step[free] = np.linalg.lstsq(design, residual, rcond=None)[0]
        return step, None

    move = RegistrationParameters.moved
    return gauss_newton(at, solve_step, move, max_iterations=MAX_ITERATIONS, tol_step=TOL_STEP)[0]


def _append_stated_clock(
    design: Array, residual: Array, free: Flags, setup: AdjustmentSetup, at: RegistrationParameters
) -> tuple[Array, Array]:
    """Add the stated clock offset as one more observation."""
    if setup.clock is None or not free[-2]:
        return design, residual
    offset, uncertainty = setup.clock
    row = (np.arange(at.size) == at.size - 2)[free] / uncertainty
    return np.vstack([design, row]), np.append(residual, (offset - at.clock) / uncertainty)


def whiten_pairs(spotted: SpotStack, seen: PredictedSpots, setup: AdjustmentSetup) -> WhitenedRows:
    """Whiten each pair's used spots, and turn the rows so that six of them hold its pose."""
    used = np.flatnonzero(spotted.used)
    kinds = seen.by_flange, seen.residual[..., None], seen.design, seen.by_joint
    columns = np.concatenate([kind[used] for kind in kinds], axis=2)
    rows, place = np.empty((len(used), 2, columns.shape[2] - 6)), np.empty((len(used), 2), np.int64)
    begin, size = np.unique(spotted.pair[used], return_index=True, return_counts=True)[1:]
    for spots in np.unique(size):  # all pairs with as many spots at once
        mine = begin[size == spots, None] + np.arange(spots)
        pairs, count = len(mine), 2 * mine.shape[1]
        lower = np.linalg.cholesky(_covariance(spotted, seen, setup, used[mine]))
        white = np.linalg.solve(lower, columns[mine].reshape(pairs, count, -1))
        turn, triangle = np.linalg.qr(white[..., :6], mode="complete")
        signs = np.sign(np.diagonal(triangle, axis1=1, axis2=2))
        turn[..., : signs.shape[1]] *= signs[:, None]
        rows[mine] = (turn.swapaxes(1, 2) @ white[..., 6:]).reshape(pairs, -1, 2, rows.shape[2])
        place[mine] = np.array([k if k < 6 else -1 for k in range(count)]).reshape(-1, 2)
    residual, design, joints = np.split(
        rows.reshape(2 * len(used), -1), [1, 1 + seen.design.shape[2]], axis=1
    )
    where = place.reshape(-1)
    return WhitenedRows(
        pair=spotted.pair[used].repeat(2),
        pose=where >= 0,
        place=where,
        residual=residual[:, 0],
        design=design,
        joints=joints,
    )


def _covariance(
    spotted: SpotStack, seen: PredictedSpots, setup: AdjustmentSetup, mine: Index
) -> Array:
    """Of a pair's pixels, (..., 2 m, 2 m): the spots' noise, and the readings' that they share.

    `mine` (..., m): the spots of a pair, or of several.
    """
    by_joint = seen.by_joint[mine].reshape(*mine.shape[:-1], 2 * mine.shape[-1], -1)
    speed = by_joint @ seen.rate[mine[..., 0], :, None]
    common = (by_joint * setup.variance) @ by_joint.swapaxes(-1, -2)
    common += setup.time_variance * speed @ speed.swapaxes(-1, -2)
    shared = shared_noise(seen.readings[0][mine], seen.readings[1][mine])
    covariance: Array = common * shared.repeat(2, axis=-1).repeat(2, axis=-2)
    return covariance + block_diagonal(spotted.covariance[mine])


def block_diagonal(blocks: Array) -> Array:
    """(..., n, 2, 2) as one matrix (..., 2 n, 2 n)."""
    (*lead, n), each = blocks.shape[:-2], np.arange(blocks.shape[-3])
    matrix = np.zeros((*lead, n, 2, n, 2))
    matrix[..., each, :, each, :] = np.moveaxis(blocks, -3, 0)
    return matrix.reshape(*lead, 2 * n, 2 * n)


def _worst_spots(spotted: SpotStack, seen: PredictedSpots) -> Flags:
    """The worst spot of each pair that the others, with the pose left open, contradict."""
    refused = np.zeros(len(spotted.pair), dtype=bool)
    for i in range(len(spotted)):
        mine = np.flatnonzero((spotted.pair == i) & spotted.used)
        if len(mine) < 2:
            continue
        by_joint = seen.by_joint[mine].reshape(2 * len(mine), -1) * JOINT_PRIOR_SIGMA
        covariance = block_diagonal(spotted.covariance[mine] + MODEL_ERROR_PX**2 * np.eye(2))
        precision = np.linalg.inv(covariance + by_joint @ by_joint.T)
        pull = (precision @ seen.residual[mine].reshape(-1)).reshape(-1, 2)
        k = np.arange(len(mine))
        own = precision.reshape(len(mine), 2, len(mine), 2)[k, :, k]
        # of a spot given all others: the inverse of its block of the precision is its variance
        size = np.einsum("si,si->s", pull, np.linalg.solve(own, pull[:, :, None])[:, :, 0])
        worst = int(np.argmax(size))
        refused[mine[worst]] = size[worst] > MAX_SPOT_CHI2
    return refused


def _estimate_covariance(
    spotted: SpotStack, setup: AdjustmentSetup, at: RegistrationParameters, free: Flags
) -> AdjustedRegistration:
    """Covariance of what was adjusted: the stated noise, and what the residuals show beside it."""
    seen = predict_spots(spotted, setup.rig, setup.arm, setup.readings, at)
    rows = whiten_pairs(spotted, seen, setup)
    design = np.where(free, rows.design, 0.0)
    stated, _ = _append_stated_clock(design[:, free], rows.residual, free, setup, at)
    inverse = np.zeros((at.size, at.size))
    inverse[np.ix_(free, free)] = invert_information(stated.T @ stated)
    shape = int(free[6:-2].sum())
    rigid = int(free.sum()) - max(shape - 6, 0)
    pose_misfit = _misfit(rows.residual[rows.pose], rigid)
    shape_misfit = _misfit(rows.residual[~rows.pose], max(shape - 6, 0))
    weight = np.full(len(rows.residual), shape_misfit)
    by_pair = np.full((len(spotted), 6), np.nan)
    by_pair[rows.pair[rows.pose], rows.place[rows.pose]] = rows.residual[rows.pose]
    factors = autocorrelation(by_pair)
    weight[rows.pose] = pose_misfit * factors[rows.place[rows.pose]]
    spread = (design * weight[:, None]).T @ design
    extra = np.linalg.norm(stated[len(design) :], axis=0) ** 2  # the stated clock needs no factor
    spread[np.ix_(free, free)] += np.diag(extra)
    return AdjustedRegistration(
        at=at,
        free=free,
        spotted=spotted,
        predicted=seen,
        rows=rows,
        inverse=inverse,
        gain=inverse @ _weighted_design(spotted, seen, setup, free),
        covariance=inverse @ spread @ inverse,
        chi2=float(rows.residual @ rows.residual),
        degrees_of_freedom=len(rows.residual) - int(free.sum()),
        inflation=float(pose_misfit * factors.max()),
    )


def _weighted_design(
    spotted: SpotStack, seen: PredictedSpots, setup: AdjustmentSetup, free: Flags
) -> Array:
    """Design' S⁻¹, (size, 2 s), pair by pair."""
    weighted = np.zeros((len(free), len(spotted.pair), 2))
    for i in range(len(spotted)):
        mine = np.flatnonzero((spotted.pair == i) & spotted.used)
        if len(mine):
            design = np.where(free, seen.design[mine], 0.0).reshape(2 * len(mine), -1)
            part = np.linalg.solve(_covariance(spotted, seen, setup, mine), design)
            weighted[:, mine] = part.T.reshape(len(free), len(mine), 2)
    return weighted.reshape(len(free), -1)


def _misfit(residual: Array, parameters: int) -> float:
    """Chi² a degree of freedom, at least 1: a lucky session is no better than its noise."""
    degrees = len(residual) - parameters
    return max(float(residual @ residual) / degrees, 1.0) if degrees > 0 else 1.0


def invert_information(information: Array) -> Array:
    """Inverse of an information matrix in units of very different size; its rounding left out."""
    scale = np.sqrt(np.diag(information))
    scale[scale == 0] = 1.0
    inverse = np.linalg.pinv(information / np.outer(scale, scale), TOL_RANK, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))
