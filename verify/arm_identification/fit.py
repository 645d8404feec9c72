"""Least squares over chosen parameters, robust to rows that do not belong."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from robots.transforms import difference
from verify.arm_identification.model import predict, predict_with_jacobian
from verify.arm_identification.noise import Scale, scale_of
from verify.arm_identification.parameters import Parameter, State, moved
from verify.arm_identification.poses import Poses, some
from verify.arm_identification.support import triangle
from verify.distributions import chi2_isf
from verify.records import Array

FALSE_ALARM = 1e-3  # over all rows: a row beyond it does not belong
ROUNDS = 12  # of fit and outlying rows; two or three suffice
RELINEARISED = 3  # times at most that a fit starts anew where it ended
SMALL_TURN = 1e-4  # rad, of a base or tool: its columns are those of no turn at all
SETTLED = 1e-9  # of scipy's three criteria: far below the data's own uncertainty


@dataclass(frozen=True, slots=True)
class Fit:
    """Parameters that fit the rows best; L of them."""

    parameters: tuple[Parameter, ...]
    change: Array  # (L,), m and rad, since the arm's own numbers or the closed-form start
    covariance: Array  # (L, L)
    information: Array  # (L, L), `triangle` scaled by tolerance
    state: State
    scale: Scale
    distance: Array  # (n,), squared Mahalanobis length of what is left in each row
    used: NDArray[np.bool_]  # (n,)

    @property
    def chi2(self) -> float:
        """Sum over the rows used."""
        return float(self.distance[self.used].sum())


def residual(state: State, poses: Poses) -> Array:
    """Measured pose less the model's, (n, 6), m and rad."""
    predicted = predict(state, poses.q, poses.base, poses.tool)
    found = difference(poses.world_T_target, predicted)
    if poses.position_only:
        found[:, 3:] = 0.0
    return found


def columns(
    state: State, poses: Poses, parameters: tuple[Parameter, ...], scale: Scale
) -> tuple[Array, Array]:
    """Whitened columns: of parameters by tolerance (6n, L), and of the nuisances (6n, p)."""
    _, jacobian = predict_with_jacobian(state, poses.q, poses.base, poses.tool, parameters)
    jacobian *= np.array([parameter.tolerance for parameter in parameters])
    white = scale.of(poses)
    return _rows(white @ jacobian), _rows(white @ poses.nuisance)


def fit(
    state: State,
    poses: Poses,
    parameters: tuple[Parameter, ...],
) -> Fit:
    """Fit parameters; rows that do not belong are left out and remain listed.

    A row is outlying where its squared Mahalanobis distance exceeds what noise reaches once in a
    thousand data sets. The noise is what was stated, or what is left, whichever is larger (by the
    median, which outlying rows do not move).

    Args:
        state: where to start.
        poses: n rows.
        parameters: L of them.
    """
    used = np.ones(len(poses), dtype=bool)
    limit = chi2_isf(FALSE_ALARM / len(poses), np.maximum(poses.dimensions, 1))
    known = Scale(1.0, 1.0)
    found, change = state, np.zeros(len(parameters))
    for _ in range(ROUNDS):
        step, found = _least_squares(found, some(poses, used), parameters, known)
        change = change + step
        left = _left(found, poses, used, known)
        before, known = known, scale_of(left, poses, used, len(parameters))
        distance = np.sum((known.of(poses) @ left[:, :, None])[:, :, 0] ** 2, axis=1)
        kept = distance <= limit
        if (kept == used).all() and known.near(before):
            break
        used = kept
    design, nuisance = columns(found, some(poses, used), parameters, known)
    information = triangle(design, nuisance)
    return Fit(
        parameters, change, _covariance(information, parameters), information, found, known,
        distance, used,
    )  # fmt: skip


def _least_squares(
    state: State, poses: Poses, parameters: tuple[Parameter, ...], scale: Scale
) -> tuple[Array, State]:
    """One fit by scipy: parameters in units of tolerance, nuisances in standard deviations."""
    length, extra = len(parameters), poses.nuisance.shape[2]
    tolerance = np.array([parameter.tolerance for parameter in parameters])
    white = scale.of(poses)
    held = _rows(white @ poses.nuisance)
    total = np.zeros(length)
    if not length:
        return total, state
    prior = np.hstack([np.zeros((extra, length)), np.eye(extra)])

    def left(x: Array, at: State) -> Array:
        xi = residual(moved(at, parameters, x[:length] * tolerance), poses)
        rows = (white @ xi[:, :, None]).reshape(-1) - held @ x[length:]
        return np.concatenate([rows, x[length:]])

    def slope(x: Array, at: State) -> Array:
        there = moved(at, parameters, x[:length] * tolerance)
        design, _ = columns(there, poses, parameters, scale)
        return np.vstack([np.hstack([-design, -held]), prior])

    for _ in range(RELINEARISED):
        solved = least_squares(
            left,
            np.zeros(length + extra),
            slope,
            args=(state,),
            method="trf",
            x_scale="jac",
            xtol=SETTLED,
            ftol=SETTLED,
            gtol=SETTLED,
        )
        step = solved.x[:length] * tolerance
        total, state = total + step, moved(state, parameters, step)
        turns = [abs(v) for v, p in zip(step, parameters, strict=True) if p.axis and p.angular]
        if max(turns, default=0.0) < SMALL_TURN:
            break
    return total, state


def _left(
    state: State,
    poses: Poses,
    used: NDArray[np.bool_],
    scale: Scale,
) -> Array:
    """What is left in each row once the nuisances have taken their most likely part."""
    left = residual(state, poses)
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
