"""Fit scaled readings and slipped belts along with an arm, and keep those that explain much.

    readings = angles + offset + Σ f_c x_c      f_c (n,): a joint's readings, or 1 from some pose on

The terms x are added by steps: the scales of all joints, or a slip of every joint at one pose,
whichever explain more of what is left. In the end those stay whose

    t² / (t² + degrees of freedom) >= MIN_SHARE,     t² = x² / u² >= t_P²

which is the share of the chi² left without a term that it explains; and noise alone keeps any in
less than P of the recordings.
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.least_squares import gauss_newton
from verify.calibration.kinematics.chain import (
    ANGLE_UNIT,
    ArmState,
    Parameter,
    change_state,
    offset_parameters,
)
from verify.calibration.kinematics.fit import scaled_columns, tolerances, without_nuisances
from verify.calibration.kinematics.noise import NoiseScale, initial_scale, residual_scale
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array
from verify.core.statistics import t_isf

P_FALSE = 1e-3  # of a recording without scale and slip, that one is kept
MIN_SHARE = 0.2  # of the chi² left without it, that a step explains, and each term
MAX_STEPS = 3
MIN_SIDE = 6  # poses on either side of a slip
MAX_ROUNDS = 4  # of fit and noise
MAX_ITERATIONS = 20
TOL_STEP = 1e-4  # of 1 mm or 1°
TOL_REDUNDANT = 1e-6  # of a column: what is left of one that the others make up


@dataclass(frozen=True, slots=True)
class Term:
    """A joint's readings scaled, or slipped from an instant on."""

    joint: int  # from 0
    since: float | None = None  # s; None: a scale

    def factor(self, q: Array, t: Array) -> Array:
        """What x is multiplied with, (n,), of readings q (n, j), rad, at t (n,), s."""
        return q[:, self.joint] if self.since is None else (t >= self.since).astype(np.float64)


@dataclass(frozen=True, slots=True)
class TermFit:
    """Parameters and c terms that fit n rows best; p columns in all."""

    terms: tuple[Term, ...]
    x: Array  # (c,), of a scale without unit, of a slip in rad
    t_squared: Array  # (c,), x² / u²
    state: ArmState
    left: Array  # (n, 6), m and rad, nuisances taken out
    turns: Array  # (n, 6, j), the pose's change with each joint's angle, a rad
    design: Array  # (6 n + p, p): whitened columns, then the priors
    scale: NoiseScale
    freedom: float

    @property
    def share(self) -> Array:
        """Of the chi² left without each term, what that one explains, (c,)."""
        return self.t_squared / (self.t_squared + self.freedom)

    def chi2(self, rows: IdentificationPoses, scale: NoiseScale) -> float:
        """Squared length of what is left, by a noise."""
        return float(np.sum(scale.whiten(rows, self.left) ** 2))


def fit_terms(
    start: ArmState,
    rows: IdentificationPoses,
    t: Array,
    parameters: tuple[Parameter, ...],
    terms: tuple[Term, ...] = (),
) -> TermFit:
    """Fit L parameters and terms to rows at t (n,), s; the noise is what they leave."""
    count, dof, length = len(rows), start.chain.dof, len(parameters)
    factors = np.zeros((count, dof, len(terms)))
    for k, term in enumerate(terms):
        factors[:, term.joint, k] = term.factor(rows.q, t)
    every = (*parameters, *offset_parameters(start.chain))
    priors = [one.tolerance / one.prior for one in parameters]
    ends = np.diag([*priors, *[ANGLE_UNIT] * len(terms), *[1.0] * rows.nuisance.shape[2]])
    scale = initial_scale(rows)

    def linearise(at: tuple[ArmState, Array]) -> tuple[Array, Array, Array]:
        taken = replace(rows, q=rows.q - factors @ at[1][length:] * ANGLE_UNIT)
        left, columns = scaled_columns(at[0], taken, every)
        own, turns = columns[:, :, :length], columns[:, :, length:]
        return left, np.concatenate([own, -turns @ factors, rows.nuisance], axis=2), turns

    def solve_step(at: tuple[ArmState, Array]) -> tuple[Array, Array]:
        left, columns, _ = linearise(at)
        white = scale.of(rows)
        design = np.vstack([(white @ columns).reshape(6 * count, -1), ends])
        known = np.concatenate([at[1], np.zeros(rows.nuisance.shape[2])])
        right = np.concatenate([(white @ left[:, :, None]).reshape(-1), -ends @ known])
        u, size, vt = np.linalg.svd(design, full_matrices=False)
        return (vt.T / size @ (u.T @ right))[: len(at[1])], (vt.T / size**2) @ vt

    def move(at: tuple[ArmState, Array], step: Array) -> tuple[ArmState, Array]:
        change = step[:length] * tolerances(parameters)
        return change_state(at[0], parameters, change), at[1] + step

    at = (start, np.zeros(length + len(terms)))
    for _ in range(MAX_ROUNDS):
        at, covariance = gauss_newton(
            at, solve_step, move, max_iterations=MAX_ITERATIONS, tol_step=TOL_STEP
        )
        left, columns, turns = linearise(at)
        left = without_nuisances(left, rows, scale)
        before, scale = scale, residual_scale(left, columns, covariance, rows, scale)
        if scale.near(before):
            break
    design = (scale.of(rows) @ columns).reshape(6 * count, -1)
    freedom = np.count_nonzero(rows.whitener.any(axis=2)) - np.sum(design @ covariance * design)
    variance = np.diag(covariance)[length : length + len(terms)]
    x = at[1][length:]
    return TermFit(
        terms, x * ANGLE_UNIT, x**2 / variance, at[0], left, turns / ANGLE_UNIT,
        np.vstack([design, ends]), scale, max(float(freedom), 1.0),
    )  # fmt: skip


def explain(
    written: TermFit,
    start: ArmState,
    rows: IdentificationPoses,
    t: Array,
    parameters: tuple[Parameter, ...],
    *,
    slips: bool,
) -> TermFit:
    """The scales, and slips where they are sought, that explain what a fit without any leaves."""
    joints, visits = range(start.chain.dof), np.unique(t)
    since = visits[MIN_SIDE : len(visits) - MIN_SIDE + 1].tolist() if slips else []
    groups = [tuple(Term(j, at) for j in joints) for at in (None, *since)]
    found = written
    for _ in range(MAX_STEPS):
        shares = [0.0 if g[0] in found.terms else _share(found, rows, t, g) for g in groups]
        if max(shares) < MIN_SHARE:
            break
        terms = (*found.terms, *groups[int(np.argmax(shares))])
        found = fit_terms(start, rows, t, parameters, terms)
    while found.terms:
        tests = 2.0 * (len(joints) * len(groups)) ** len(found.terms)
        least = float(t_isf(P_FALSE / tests, found.freedom)) ** 2
        weakest = int(np.argmin(found.t_squared))
        if found.t_squared[weakest] >= least and found.share[weakest] >= MIN_SHARE:
            break
        kept = (*found.terms[:weakest], *found.terms[weakest + 1 :])
        found = fit_terms(start, rows, t, parameters, kept)
    return found


def _share(fit: TermFit, rows: IdentificationPoses, t: Array, terms: tuple[Term, ...]) -> float:
    """Share of the chi² left that more terms of every joint would explain, to first order."""
    white, ends = fit.scale.of(rows), len(fit.design) - 6 * len(rows)
    factors = np.stack([term.factor(rows.q, t) for term in terms], axis=1)
    moved = np.concatenate([fit.left[:, :, None], fit.turns * factors[:, None]], axis=2)
    whole = np.vstack(
        [(white @ moved).reshape(6 * len(rows), -1), np.zeros((ends, 1 + len(terms)))]
    )
    basis = np.linalg.qr(fit.design)[0]
    open_part = whole - basis @ (basis.T @ whole)
    left, columns = open_part[:, 0], open_part[:, 1:]
    told = np.linalg.norm(columns, axis=0) > TOL_REDUNDANT * np.linalg.norm(whole[:, 1:], axis=0)
    across = np.linalg.qr(columns[:, told])[0].T @ left
    return float(across @ across / max(left @ left, np.finfo(float).tiny))
