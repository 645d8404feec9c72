"""Fit of chosen parameters to measured poses, robust to outlying rows, with cross-validation.

    minimise   sum over rows i of | W_i (ξ_i(p) - N_i z) |² + |z|²

    ξ_i   (6,)     measured pose less the chain's, m and rad
    W_i   (6, 6)   whitener of the row's noise
    N_i   (6, e)   effects of unit variance that do not average out
    p     (L,)     chosen parameters (`chain.Parameter`), in units of 1 mm or 1°
    z     (e,)     nuisances, in standard deviations

A row is outlying where its squared Mahalanobis distance exceeds what noise reaches once in a
thousand data sets; such rows are left out and remain listed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from robots.transforms import difference
from verify.calibration.kinematics.chain import ArmState, Parameter, change_state
from verify.calibration.kinematics.identifiability import information_root
from verify.calibration.kinematics.model import predict_poses, predict_with_jacobian
from verify.calibration.kinematics.poses import (
    IdentificationPoses,
    NoiseScale,
    noise_scale,
    select_rows,
)
from verify.core.records import Array
from verify.core.statistics import chi2_isf

P_FALSE_ALARM = 1e-3  # over all rows: a row beyond it is outlying
MAX_ROUNDS = 12  # of fit and outlying rows; two or three suffice
MAX_RESTARTS = 3  # times at most that a fit starts anew where it ended
MIN_TURN = 1e-4  # rad, of a base or tool: its columns are those of no turn at all
TOL_FIT = 1e-9  # of scipy's three criteria: far below the data's own uncertainty


@dataclass(frozen=True, slots=True)
class KinematicFit:
    """Parameters that fit the rows best; L of them."""

    parameters: tuple[Parameter, ...]
    change: Array  # (L,), m and rad, since the arm's own numbers or the closed-form start
    covariance: Array  # (L, L)
    information: Array  # (L, L), `information_root` scaled by tolerance
    state: ArmState
    scale: NoiseScale
    distance: Array  # (n,), squared Mahalanobis length of what is left in each row
    used: NDArray[np.bool_]  # (n,)

    @property
    def standard_uncertainty(self) -> Array:
        """Of the parameters, (L,), m and rad."""
        return np.sqrt(np.diag(self.covariance))


def pose_residuals(state: ArmState, poses: IdentificationPoses) -> Array:
    """Measured pose less the model's, (n, 6), m and rad."""
    predicted = predict_poses(state, poses.q, poses.base, poses.tool)
    found = difference(poses.world_T_target, predicted)
    if poses.position_only:
        found[:, 3:] = 0.0
    return found


def whitened_columns(
    state: ArmState,
    poses: IdentificationPoses,
    parameters: tuple[Parameter, ...],
    scale: NoiseScale,
) -> tuple[Array, Array]:
    """Whitened columns: of parameters by tolerance (6n, L), and of the nuisances (6n, p)."""
    _, jacobian = predict_with_jacobian(state, poses.q, poses.base, poses.tool, parameters)
    jacobian *= np.array([parameter.tolerance for parameter in parameters])
    white = scale.of(poses)
    return _rows(white @ jacobian), _rows(white @ poses.nuisance)


def fit_parameters(
    state: ArmState, poses: IdentificationPoses, parameters: tuple[Parameter, ...]
) -> KinematicFit:
    """Fit parameters to the rows that are not outlying.

    Args:
        state: where to start.
        poses: n rows.
        parameters: L of them.
    """
    used = np.ones(len(poses), dtype=bool)
    limit = chi2_isf(P_FALSE_ALARM / len(poses), np.maximum(poses.dimensions, 1))
    known = NoiseScale(1.0, 1.0)
    found, change = state, np.zeros(len(parameters))
    for _ in range(MAX_ROUNDS):
        step, found = _least_squares(found, select_rows(poses, used), parameters, known)
        change = change + step
        left = _residuals_without_nuisances(found, poses, used, known)
        before, known = known, noise_scale(left, poses, used, len(parameters))
        distance = np.sum(known.whiten(poses, left) ** 2, axis=1)
        kept = distance <= limit
        if (kept == used).all() and known.near(before):
            break
        used = kept
    design, nuisance = whitened_columns(found, select_rows(poses, used), parameters, known)
    information = information_root(design, nuisance)
    return KinematicFit(
        parameters, change, _covariance(information, parameters), information, found, known,
        distance, used,
    )  # fmt: skip


def _least_squares(
    state: ArmState,
    poses: IdentificationPoses,
    parameters: tuple[Parameter, ...],
    scale: NoiseScale,
) -> tuple[Array, ArmState]:
    """Fit once by scipy: parameters in units of tolerance, nuisances in standard deviations."""
    length, extra = len(parameters), poses.nuisance.shape[2]
    tolerance = np.array([parameter.tolerance for parameter in parameters])
    white = scale.of(poses)
    held = _rows(white @ poses.nuisance)
    total = np.zeros(length)
    if not length:
        return total, state
    prior = np.hstack([np.zeros((extra, length)), np.eye(extra)])

    def left(x: Array, at: ArmState) -> Array:
        xi = pose_residuals(change_state(at, parameters, x[:length] * tolerance), poses)
        rows = (white @ xi[:, :, None]).reshape(-1) - held @ x[length:]
        return np.concatenate([rows, x[length:]])

    def slope(x: Array, at: ArmState) -> Array:
        there = change_state(at, parameters, x[:length] * tolerance)
        design, _ = whitened_columns(there, poses, parameters, scale)
        return np.vstack([np.hstack([-design, -held]), prior])

    for _ in range(MAX_RESTARTS):
        solved = least_squares(
            left, np.zeros(length + extra), slope, args=(state,), method="trf", x_scale="jac",
            xtol=TOL_FIT, ftol=TOL_FIT, gtol=TOL_FIT,
        )  # fmt: skip
        step = solved.x[:length] * tolerance
        total, state = total + step, change_state(state, parameters, step)
        turns = [abs(v) for v, p in zip(step, parameters, strict=True) if p.axis and p.angular]
        if max(turns, default=0.0) < MIN_TURN:
            break
    return total, state


def _residuals_without_nuisances(
    state: ArmState, poses: IdentificationPoses, used: NDArray[np.bool_], scale: NoiseScale
) -> Array:
    """Residuals of each row less the most likely effect of the nuisances, (n, 6)."""
    left = pose_residuals(state, poses)
    extra = poses.nuisance.shape[2]
    if not extra:
        return left
    white = scale.of(poses)[used]
    held = _rows(white @ poses.nuisance[used])
    rows = (white @ left[used][:, :, None]).reshape(-1)
    taken = np.linalg.solve(held.T @ held + np.eye(extra), held.T @ rows)
    return left - poses.nuisance @ taken


def _covariance(information: Array, parameters: tuple[Parameter, ...]) -> Array:
    if not parameters:
        return np.zeros((0, 0))
    tolerance = np.array([parameter.tolerance for parameter in parameters])
    _, size, vt = np.linalg.svd(information)
    root = vt.T / size * tolerance[:, None]
    found: Array = root @ root.T
    return found


def _rows(blocks: Array) -> Array:
    return blocks.reshape(blocks.shape[0] * blocks.shape[1], blocks.shape[2])


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Residuals on rows held out, means over the splits, outlying rows included."""

    splits: int
    rows: int  # held out in each, about
    position: Array  # (3,), m: mean, rms, greatest
    orientation: Array  # (3,), rad; nan where only positions were measured


def split(
    poses: IdentificationPoses, share: float, generator: np.random.Generator
) -> NDArray[np.bool_]:
    """Hold out a share of the blocks of every base and tool; (n,), True where held out."""
    held = np.zeros(len(poses), dtype=bool)
    for base, tool in sorted(set(zip(poses.base.tolist(), poses.tool.tolist(), strict=True))):
        own = (poses.base == base) & (poses.tool == tool)
        blocks = np.unique(poses.block[own])
        some_blocks = generator.permutation(blocks)[: max(1, round(share * len(blocks)))]
        held |= own & np.isin(poses.block, some_blocks)
    return held


def statistics(left: Array) -> Array:
    """Mean, rms and greatest length of vectors (n, 3)."""
    length = np.linalg.norm(left, axis=1)
    return np.array([length.mean(), np.sqrt(np.mean(length**2)), length.max()])


def hold_out(
    state: ArmState,
    poses: IdentificationPoses,
    parameters: tuple[Parameter, ...],
    splits: int,
    share: float,
    seed: int,
) -> CrossValidation | None:
    """Fit on one part and evaluate on the other, several times; None: too few rows.

    Args:
        state: where each fit starts.
        poses: n rows.
        parameters: what is free.
        splits: how often.
        share: of the rows held out.
        seed: of the splits.
    """
    generator = np.random.default_rng(seed)
    positions, turns, counts = [], [], []
    for _ in range(splits):
        held = split(poses, share, generator)
        training = select_rows(poses, ~held)
        if int(training.dimensions.sum()) < 2 * len(parameters) or not held.any():
            return None
        found = fit_parameters(state, training, parameters)
        left = pose_residuals(found.state, select_rows(poses, held))
        positions.append(statistics(left[:, :3]))
        turns.append(statistics(left[:, 3:]))
        counts.append(int(held.sum()))
    if not positions:
        return None
    blind = np.full(3, np.nan)
    return CrossValidation(
        splits=splits,
        rows=round(float(np.mean(counts))),
        position=np.mean(positions, axis=0),
        orientation=blind if poses.position_only else np.mean(turns, axis=0),
    )
