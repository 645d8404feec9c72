"""Fit of chosen parameters to measured poses, with weak priors, robust to outlying rows.

    minimise   sum over rows i of | W_i (ξ_i(p) - N_i z) |² + |p / σ|² + |z|²

    ξ_i   (6,)     measured pose less the chain's, m and rad
    W_i   (6, 6)   whitener of the row's noise
    N_i   (6, e)   effects of unit variance that do not average out
    p     (L,)     chosen parameters (`chain.Parameter`), since the arm's own numbers
    σ     (L,)     `Parameter.prior`: 3 mm and 3° of the arm, 1 m and 1 rad of a free base or tool;
                   less of twists and lengths, as far as they show how far they lie from the file
    z     (e,)     nuisances, in standard deviations

That spread follows from the rows: s² = Σ (p_k² + var p_k) / (n - 2) over the n of a kind, so that n
few values, which tell it only roughly, do not make the others too sure (Dempster, Laird and Rubin,
J. R. Stat. Soc. B 39, 1977; n / (n - 2) is the variance of Student's distribution).

A row is outlying where its squared Mahalanobis distance exceeds what noise reaches once in a
thousand data sets. Such rows are left out and remain listed; never more than a tenth, the farthest:
where more lie that far off, the noise is not what it was taken for, and grows.
"""

from dataclasses import dataclass, replace

import numpy as np

from robots.transforms import difference
from verify.analysis.least_squares import gauss_newton
from verify.calibration.kinematics.chain import ArmState, Parameter, change_state
from verify.calibration.kinematics.identifiability import information_root
from verify.calibration.kinematics.model import predict_poses, predict_with_jacobian
from verify.calibration.kinematics.noise import (
    NoiseScale,
    initial_scale,
    median_scale,
    residual_scale,
)
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array, Flags, take_rows
from verify.core.statistics import chi2_isf, t_isf

P_FALSE_ALARM = 1e-3  # over all rows: a row beyond it is outlying
MAX_OUTLYING = 0.1  # of the rows
MAX_ROUNDS = 12  # of fit and outlying rows, and of fit and noise; two or three suffice
MAX_ITERATIONS = 40  # of a fit: five from a closed-form start, two from a fit of other rows
TOL_STEP = 1e-5  # of 1 mm or 1°
SPREAD_KINDS = (("alpha", "beta"), ("d", "a"))  # that lie about as far from the file
MIN_SPREAD = 0.02  # mm or °: no arm is made better
TOL_SPREAD = 0.02  # relative
TAIL = 0.0228  # beyond k = 2 on either side of a normal variable


@dataclass(frozen=True, slots=True)
class KinematicFit:
    """Parameters that fit the rows best; L of them."""

    parameters: tuple[Parameter, ...]
    change: Array  # (L,), m and rad, since the arm's own numbers or the closed-form start
    covariance: Array  # (L, L), m and rad
    information: Array  # (., L), `information_root` of the rows alone, scaled by tolerance
    state: ArmState
    scale: NoiseScale
    distance: Array  # (n,), squared Mahalanobis length of what is left in each row
    used: Flags  # (n,)
    scatter: float | None = None  # of parameters between recordings, over u; None: one recording

    @property
    def standard_uncertainty(self) -> Array:
        """Of the parameters, (L,), m and rad."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def coverage_factor(self) -> float:
        """Of 95.4 %: 2 where the noise is known, Student's where these rows showed it."""
        return max(2.0, float(t_isf(TAIL, max(self.scale.degrees_of_freedom, 1.0))))


@dataclass(frozen=True, slots=True)
class FitState:
    """An arm on the way of a fit."""

    state: ArmState
    change: Array  # (L,), in tolerances, since where the priors are about


def pose_residuals(state: ArmState, poses: IdentificationPoses) -> Array:
    """Measured pose less the model's, (n, 6), m and rad."""
    return _residuals(predict_poses(state, poses.q, poses.base, poses.tool), poses)


def _residuals(predicted: Array, poses: IdentificationPoses) -> Array:
    found = difference(poses.world_T_target, predicted)
    if poses.position_only:
        found[:, 3:] = 0.0
    return found


def scaled_columns(
    state: ArmState, poses: IdentificationPoses, parameters: tuple[Parameter, ...]
) -> tuple[Array, Array]:
    """Residuals (n, 6), m and rad, and the change a tolerance of each parameter, (n, 6, L)."""
    predicted, jacobian = predict_with_jacobian(state, poses.q, poses.base, poses.tool, parameters)
    jacobian *= tolerances(parameters)
    return _residuals(predicted, poses), jacobian


def information(
    state: ArmState,
    poses: IdentificationPoses,
    parameters: tuple[Parameter, ...],
    scale: NoiseScale,
) -> Array:
    """`information_root` of parameters by tolerance, the nuisances taken out, (., L)."""
    white = scale.of(poses)
    design = _rows(white @ scaled_columns(state, poses, parameters)[1])
    return information_root(design, _rows(white @ poses.nuisance))


def fit_parameters(
    state: ArmState,
    poses: IdentificationPoses,
    parameters: tuple[Parameter, ...],
    richest: KinematicFit | None = None,
) -> KinematicFit:
    """Fit L parameters to the rows that are not outlying; priors are about the state at the start.

    Outlying rows of the largest model's fit `richest` are left out here as well, and the noise is
    no less than what it leaves: what a smaller model cannot follow is no noise.
    """
    known = None if richest is None else (richest.used, richest.scale)
    used, scale = known or _outlying_rows(state, poses, parameters)
    rows = take_rows(poses, used)
    at = FitState(state, np.zeros(len(parameters)))
    for _ in range(MAX_ROUNDS):
        at, covariance = minimise(at, rows, parameters, scale)
        left, columns = scaled_columns(at.state, rows, parameters)
        columns = np.concatenate([columns, rows.nuisance], axis=2)
        left = without_nuisances(left, rows, scale)
        before, scale = scale, residual_scale(left, columns, covariance, rows, scale)
        if richest is not None:
            scale = scale.at_least(richest.scale)
        parameters, wider = _with_spread(parameters, at, covariance), parameters
        if scale.near(before) and np.allclose(_priors(parameters), _priors(wider), rtol=TOL_SPREAD):
            break
    root = information(at.state, rows, parameters, scale)
    left = without_nuisances(pose_residuals(at.state, poses), poses, scale, used)
    return KinematicFit(
        parameters, at.change * tolerances(parameters), _covariance(root, parameters), root,
        at.state, scale, np.sum(scale.whiten(poses, left) ** 2, axis=1), used,
    )  # fmt: skip


def minimise(
    start: FitState,
    poses: IdentificationPoses,
    parameters: tuple[Parameter, ...],
    scale: NoiseScale,
) -> tuple[FitState, Array]:
    """Fit all rows by Gauss and Newton at a given noise.

    Returns where it ends, and the covariance (L + e, L + e) of parameters by tolerance and
    nuisances.
    """
    length, tolerance = len(parameters), tolerances(parameters)
    white = scale.of(poses)
    held = _rows(white @ poses.nuisance)
    weight = (tolerance / _priors(parameters)) ** 2
    prior = np.concatenate([weight, np.ones(held.shape[1])])

    def solve_step(at: FitState) -> tuple[Array, Array]:
        left, columns = scaled_columns(at.state, poses, parameters)
        design = np.hstack([_rows(white @ columns), held])
        normal = design.T @ design + np.diag(prior)
        right = design.T @ (white @ left[:, :, None]).reshape(-1)
        right[:length] -= weight * at.change
        size = np.sqrt(np.diag(normal))
        covariance = np.linalg.inv(normal / np.outer(size, size)) / np.outer(size, size)
        return (covariance @ right)[:length], covariance

    def move(at: FitState, step: Array) -> FitState:
        return FitState(change_state(at.state, parameters, step * tolerance), at.change + step)

    return gauss_newton(start, solve_step, move, max_iterations=MAX_ITERATIONS, tol_step=TOL_STEP)


def _outlying_rows(
    state: ArmState, poses: IdentificationPoses, parameters: tuple[Parameter, ...]
) -> tuple[Flags, NoiseScale]:
    """Tell which rows belong together, (n,), by fits and the median of what they leave."""
    used, scale = np.ones(len(poses), dtype=bool), initial_scale(poses)
    limit = chi2_isf(P_FALSE_ALARM / len(poses), np.maximum(poses.dimensions, 1))
    at = FitState(state, np.zeros(len(parameters)))
    for _ in range(MAX_ROUNDS):
        at, _ = minimise(at, take_rows(poses, used), parameters, scale)
        left = without_nuisances(pose_residuals(at.state, poses), poses, scale, used)
        before, scale = scale, median_scale(left, poses, used)
        excess = np.sum(scale.whiten(poses, left) ** 2, axis=1) - limit
        farthest = np.argsort(-excess)[: int(MAX_OUTLYING * len(poses))]
        kept = np.ones(len(poses), dtype=bool)
        kept[farthest[excess[farthest] > 0]] = False
        if (kept == used).all() and scale.near(before):
            break
        used = kept
    return used, scale


def without_nuisances(
    left: Array, poses: IdentificationPoses, scale: NoiseScale, used: Flags | None = None
) -> Array:
    """Residuals (n, 6) less the most likely effect of the nuisances on the used rows."""
    extra = poses.nuisance.shape[2]
    if not extra:
        return left
    own = slice(None) if used is None else used
    white = scale.of(poses)[own]
    held = _rows(white @ poses.nuisance[own])
    rows = (white @ left[own][:, :, None]).reshape(-1)
    taken = np.linalg.solve(held.T @ held + np.eye(extra), held.T @ rows)
    return left - poses.nuisance @ taken


def tolerances(parameters: tuple[Parameter, ...]) -> Array:
    """1 mm or 1° of each, (L,), m and rad."""
    return np.array([parameter.tolerance for parameter in parameters])


def _priors(parameters: tuple[Parameter, ...]) -> Array:
    """Standard deviations, (L,), m and rad."""
    return np.array([parameter.prior for parameter in parameters])


def _with_spread(
    parameters: tuple[Parameter, ...], at: FitState, covariance: Array
) -> tuple[Parameter, ...]:
    """State how far the arm's twists, and its lengths, lie from its file, by a fit so far."""
    square = at.change**2 + np.diag(covariance)[: len(parameters)]
    found = list(parameters)
    for kinds in SPREAD_KINDS:
        own = [k for k, parameter in enumerate(parameters) if parameter.kind in kinds]
        size = np.sqrt(square[own].sum() / max(len(own) - 2, 1))
        for k in own:
            spread = max(float(size), MIN_SPREAD) * parameters[k].tolerance
            widest = replace(parameters[k], spread=None).prior
            found[k] = replace(parameters[k], spread=min(spread, widest))
    return tuple(found)


def _covariance(known: Array, parameters: tuple[Parameter, ...]) -> Array:
    """Covariance by the rows and the priors together, (L, L), m and rad."""
    if not parameters:
        return np.zeros((0, 0))
    tolerance = tolerances(parameters)
    prior = np.diag(tolerance / _priors(parameters))
    _, size, vt = np.linalg.svd(np.vstack([known, prior]), full_matrices=False)
    root = vt.T / size * tolerance[:, None]
    return np.asarray(root @ root.T)


def _rows(blocks: Array) -> Array:
    return blocks.reshape(blocks.shape[0] * blocks.shape[1], blocks.shape[2])
