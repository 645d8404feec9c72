"""Fit faults of readings along with an arm, and keep those that explain much.

    readings = angles + offset + Σ F_c x_c      F_c (n, w), w numbers x_c of a term
    poses = model + Σ M_c x_c                   M_c (n, 6, w)

F is a joint's readings q (a scale), 1 from some pose on (a slip of its belt), cos q and sin q (an
eccentric encoder), or half the last direction of travel (backlash); M moves the base, or the
target, from some pose on. The terms are added by steps, each time the one that explains most of
what is left for its numbers (BIC), as long as of every term

    g² / (g² + degrees of freedom) >= MIN_SHARE,     g² = x' C⁻¹ x >= w F_P

with C (w, w) the covariance of x: the share of the chi² left without a term that it explains; and
noise alone keeps any in less than P of the recordings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import fdtri

from verify.analysis.least_squares import gauss_newton
from verify.calibration.kinematics.chain import (
    ANGLE_UNIT,
    AXES,
    ArmState,
    Parameter,
    change_state,
    offset_parameters,
)
from verify.calibration.kinematics.fit import scaled_columns, tolerances, without_nuisances
from verify.calibration.kinematics.model import predict_with_jacobian
from verify.calibration.kinematics.noise import NoiseScale, initial_scale, residual_scale
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array

P_FALSE = 1e-3  # of a recording without any of these faults, that one is kept
MIN_SHARE = 0.2  # of the chi² left without it, that a step explains, and each term
MAX_STEPS = 3
MIN_SIDE = 6  # poses on either side of a slip
MOVE_SIGMA = np.array([0.05] * 3 + [0.1] * 3)  # m, rad: no base moves farther meanwhile
MAX_ROUNDS = 4  # of fit and noise
MAX_ITERATIONS = 20
TOL_STEP = 1e-4  # of 1 mm or 1°
TOL_REDUNDANT = 1e-6  # of a column: what is left of one that the others make up


@dataclass(frozen=True, slots=True, eq=False)  # arrays have no plain equality
class Term:
    """A fault of one joint's readings, or a move of base or target, in n rows."""

    joint: int  # from 0; -1: no joint's
    kind: str  # "scale", "eccentricity", "backlash" or "slip"; "base" or "target"
    factors: Array  # (n, w), what its w numbers are multiplied with; of a move (n, 6, w)
    since: float | None = None  # s, of a slip or a move


@dataclass(frozen=True, slots=True)
class TermFit:
    """Parameters and c terms that fit n rows best; p columns in all."""

    terms: tuple[Term, ...]
    x: tuple[Array, ...]  # c of (w,), of scales without unit, of moves in MOVE_SIGMA, else in rad
    gain: Array  # (c,), x' C⁻¹ x
    state: ArmState
    left: Array  # (n, 6), m and rad, nuisances taken out
    turns: Array  # (n, 6, j), the pose's change with each joint's angle, a rad
    design: Array  # (6 n + p, p): whitened columns, then the priors
    scale: NoiseScale
    freedom: float

    @property
    def share(self) -> Array:
        """Of the chi² left without each term, what that one explains, (c,)."""
        return self.gain / (self.gain + self.freedom)

    def chi2(self, rows: IdentificationPoses, scale: NoiseScale) -> float:
        """Squared length of what is left, by a noise."""
        return float(np.sum(scale.whiten(rows, self.left) ** 2))


def fit_terms(
    start: ArmState,
    rows: IdentificationPoses,
    parameters: tuple[Parameter, ...],
    terms: tuple[Term, ...] = (),
) -> TermFit:
    """Fit L parameters and terms to rows; the noise is what they leave."""
    count, dof, length = len(rows), start.chain.dof, len(parameters)
    ends = length + np.cumsum([0, *(term.factors.shape[-1] for term in terms)])
    own = [slice(*pair) for pair in pairwise(ends.tolist())]
    factors = np.zeros((count, dof, int(ends[-1]) - length))
    moves = np.zeros((count, 6, int(ends[-1]) - length))
    for term, part in zip(terms, own, strict=True):
        into = moves if term.joint < 0 else factors[:, term.joint]
        into[..., part.start - length : part.stop - length] = term.factors
    every = (*parameters, *offset_parameters(start.chain))
    priors = [one.tolerance / one.prior for one in parameters]
    priors += [ANGLE_UNIT] * factors.shape[2] + [1.0] * rows.nuisance.shape[2]
    held = np.diag(priors)
    scale = initial_scale(rows)

    def linearise(at: tuple[ArmState, Array]) -> tuple[Array, Array, Array]:
        taken = replace(rows, q=rows.q - factors @ at[1][length:] * ANGLE_UNIT)
        left, columns = scaled_columns(at[0], taken, every)
        own, turns = columns[:, :, :length], columns[:, :, length:]
        left = left - moves @ at[1][length:] * ANGLE_UNIT
        changes = moves * ANGLE_UNIT - turns @ factors
        return left, np.concatenate([own, changes, rows.nuisance], axis=2), turns

    def solve_step(at: tuple[ArmState, Array]) -> tuple[Array, Array]:
        left, columns, _ = linearise(at)
        white = scale.of(rows)
        design = np.vstack([(white @ columns).reshape(6 * count, -1), held])
        known = np.concatenate([at[1], np.zeros(rows.nuisance.shape[2])])
        right = np.concatenate([(white @ left[:, :, None]).reshape(-1), -held @ known])
        u, size, vt = np.linalg.svd(design, full_matrices=False)
        return (vt.T / size @ (u.T @ right))[: len(at[1])], (vt.T / size**2) @ vt

    def move(at: tuple[ArmState, Array], step: Array) -> tuple[ArmState, Array]:
        change = step[:length] * tolerances(parameters)
        return change_state(at[0], parameters, change), at[1] + step

    at = (start, np.zeros(int(ends[-1])))
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
    freedom = rows.numbers - np.sum(design @ covariance * design)
    x = [at[1][part] for part in own]
    gain = [
        y @ np.linalg.pinv(covariance[part, part], hermitian=True) @ y
        for y, part in zip(x, own, strict=True)
    ]
    return TermFit(
        terms, tuple(y * ANGLE_UNIT for y in x), np.array(gain), at[0], left, turns / ANGLE_UNIT,
        np.vstack([design, held]), scale, max(float(freedom), 1.0),
    )  # fmt: skip


def explain(
    written: TermFit,
    start: ArmState,
    rows: IdentificationPoses,
    t: Array,
    direction: Array,
    parameters: tuple[Parameter, ...],
    *,
    slips: bool,
) -> TermFit:
    """The faults, slips and moves where they are sought, that explain what a fit without leaves.

    The rows are at t (n,), s; `direction` (n, j) is every joint's last one of travel, ±1, or 0
    where there was none.
    """
    visits = np.unique(t)
    since = visits[MIN_SIDE : len(visits) - MIN_SIDE + 1].tolist() if slips else []
    kinds: list[tuple[str, Array, float | None]] = [
        ("scale", rows.q[:, :, None], None),
        ("eccentricity", np.stack([np.cos(rows.q), np.sin(rows.q)], axis=2), None),
        ("backlash", direction[:, :, None] / 2, None),
    ]
    kinds += [("slip", np.ones((*rows.q.shape, 1)) * (t >= s)[:, None, None], s) for s in since]
    every = [
        Term(j, kind, factors[:, j], s)
        for kind, factors, s in kinds
        for j in range(start.chain.dof)
    ]
    every += [
        Term(-1, what, move * (t >= s)[:, None, None], s)
        for what, move in _moves(written.state, rows)
        for s in since
    ]
    found = written
    for _ in range(MAX_STEPS):
        order = np.argsort(_shares(found, rows, every)).tolist()
        best = {every[k].kind: every[k] for k in order}  # of each kind: first order misleads
        tried = (fit_terms(start, rows, parameters, (*found.terms, one)) for one in best.values())
        bic = np.log(rows.numbers)  # price of each number
        more = min(tried, key=lambda one: one.chi2(rows, found.scale) + bic * sum(map(len, one.x)))
        width = np.array([len(x) for x in more.x])
        least = width * fdtri(width, more.freedom, 1 - P_FALSE / len(every))
        if (more.gain < least).any() or more.share.min() < MIN_SHARE:
            break
        found = more
    return found


def _moves(state: ArmState, rows: IdentificationPoses) -> Iterator[tuple[str, Array]]:
    """Change of the poses, (n, 6, 6), by moves of the base, and of the targets, by MOVE_SIGMA."""
    for what, kind, places in (("base", "base", state.base), ("target", "tool", state.tool)):
        every = [tuple(Parameter(kind, k, axis) for axis in AXES) for k in range(len(places))]
        columns = (predict_with_jacobian(state, rows.q, rows.base, rows.tool, p)[1] for p in every)
        yield what, sum(columns, np.zeros((len(rows), 6, 6))) * MOVE_SIGMA


def _shares(fit: TermFit, rows: IdentificationPoses, terms: Sequence[Term]) -> list[float]:
    """Share of the chi² left that each of further terms would explain, to first order."""
    white, ends = fit.scale.of(rows), len(fit.design) - 6 * len(rows)
    basis = np.linalg.qr(fit.design)[0]

    def open_part(moved: Array) -> Array:
        whole = (white @ moved).reshape(6 * len(rows), -1)
        whole = np.vstack([whole, np.zeros((ends, whole.shape[1]))])
        open_ones = whole - basis @ (basis.T @ whole)
        told = np.linalg.norm(open_ones, axis=0) > TOL_REDUNDANT * np.linalg.norm(whole, axis=0)
        return np.asarray(open_ones[:, told])

    left = open_part(fit.left[:, :, None]).sum(axis=1)
    size = max(float(left @ left), np.finfo(float).tiny)
    shares = []
    for term in terms:
        turns = fit.turns[:, :, term.joint, None]
        columns = open_part(term.factors if term.joint < 0 else turns * term.factors[:, None])
        across = np.linalg.qr(columns)[0].T @ left
        shares.append(0.0 if term in fit.terms else float(across @ across) / size)
    return shares
