"""One joint's fixed axis and its encoder's error, fitted together to the poses of a sweep.

While joint j moves alone, all points of the flange run on circles about its axis (d, p):

    T_k = Rot(d, p; q_k - q_mid - sum_i c_i f_i(k)) T_0,    k = 1 ... n

==========  =====  ==========================================================
parameters  count  meaning
==========  =====  ==========================================================
d           2      tilt of the axis' direction, rad, across it
p           2      shift of a point on the axis, m, across it
T_0         6      pose at the middle of the readings: shift, then turn
c           k      size of each term f of the encoder's error
==========  =====  ==========================================================

No base, LED position or table of the arm enters: each only says in which frame the axis lies.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from robots.transforms import difference, displace, rotation_exp, rotation_log
from verify.analysis.joint_errors import MIN_PAIRS_PER_DIRECTION
from verify.analysis.least_squares import RegressionFit, autocorrelation, gauss_newton, solve
from verify.core.records import Array, Flags, Index, rigid_transform
from verify.core.statistics import chi2_sf

N_FREE = 10  # parameters of the axis and of the start pose
N_LINE = 4  # of the axis alone
MAX_ITERATIONS = 12
TOL_STEP = 1e-10  # m and rad: far below what poses are known to
P_FALSE_ECCENTRICITY = 1e-3  # chance of an eccentricity where there is none


@dataclass(frozen=True, slots=True)
class SweepData:
    """What is known of a sweep's n pairs; arrays a pair."""

    poses: Array  # (n, 4, 4), measured flange in any one frame
    covariance: Array  # (n, 6, 6), of the poses, m and rad, perturbation on the left
    held: Array  # (n, 6, p), columns of unit variance: what is stated and does not average out
    q: Array  # (n,), rad, reading
    reading_variance: Array  # (n,), rad²


@dataclass(frozen=True, slots=True)
class SweepPairs(SweepData):
    """A sweep's pairs with what the terms of the encoder's error need."""

    rows: Index  # (n,), of the comparison
    direction: Array  # (n,), of travel, +1 or -1
    rate: Array | None  # (n,), rad/s, of a clock that is fitted along

    def without(self, left_out: Flags) -> "SweepPairs":
        """The other pairs."""
        every = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{k: v[~left_out] for k, v in every.items() if v is not None})


@dataclass(frozen=True, slots=True)
class AxisFit:
    """A sweep fitted; k terms of the encoder's error."""

    value: Array  # (k,), of the terms
    covariance: Array  # (k, k)
    estimable: Flags  # (k,)
    turned: Array  # (n,), rad, the fitted angle about the axis, zero as the reading's
    angle_left: Array  # (n,), rad, measured angle less fitted
    angle_variance: Array  # (n,), rad², of that, the reading's own included
    rest: Array  # (n, 6), m and rad, what no turn about the axis explains
    chi2_angle: float  # of what is left of the angles
    chi2_rest: float


@dataclass(frozen=True, slots=True)
class AxisState:
    """The parameters."""

    direction: Array  # (3,), unit vector along which the joint's angle grows
    point: Array  # (3,), m, on the axis
    start: Array  # (4, 4), the flange where the reading is at its middle
    value: Array  # (k,), of the terms


@dataclass(frozen=True, slots=True)
class CircleFit:
    """The optimum, and the whitened linear problem there; r = 6 n rows."""

    state: AxisState
    solved: RegressionFit  # its covariance: axis, start pose, terms
    rows: Array  # (r, 10 + k)
    white: Array  # (n, 6, 6), whitening of each pose
    residual: Array  # (n, 6), whitened


@dataclass(frozen=True, slots=True)
class UncertainValue:
    """One figure with its standard uncertainty; nan where the sweep does not determine it."""

    value: float
    uncertainty: float


NO_FIGURE = UncertainValue(float("nan"), float("nan"))


@dataclass(frozen=True, slots=True)
class EncoderTerms:
    """Columns of the encoder's error: gain, hysteresis, sine and cosine, clock; -1: not there."""

    columns: Array  # (n, k)
    hysteresis: int
    circular: int  # the first of two
    clock: int


def fit_axis(swept: SweepData, terms: Array) -> AxisFit:
    """Fit axis, start pose and the encoder's error together.

    `terms` (n, k): what a unit of each adds to the reading. The fit's covariance holds what is
    stated of the poses, and pairs that repeat each other's errors count for fewer.
    """
    first = fit_circles(swept, terms)
    inflation = autocorrelation(first.residual)
    return _split_residuals(swept, terms, fit_circles(swept, terms, first.state, inflation))


def fit_circles(
    swept: SweepData, terms: Array, start: AxisState | None = None, inflation: Array | None = None
) -> CircleFit:
    """Fit axis, start pose and terms by weighted least squares, from `start` or in closed form.

    `terms` (n, k): what a unit of each adds to the reading; `inflation` (6,), 1 where not given: by
    which the variance of each whitened direction grows.
    """
    factor = np.ones(6) if inflation is None else np.sqrt(inflation)

    def step(state: AxisState) -> tuple[Array, CircleFit]:
        fitted, motion, by_state = _predict_poses(swept, terms, state)
        moved = motion * np.sqrt(swept.reading_variance)[:, None]  # the reading says where to be
        lower = np.linalg.cholesky(swept.covariance + moved[:, :, None] * moved[:, None, :])
        white = np.asarray(np.linalg.inv(lower * factor), dtype=np.float64)
        design = np.concatenate([by_state, -motion[:, :, None] * terms[:, None, :]], axis=2)
        rows = (white @ design).reshape(-1, design.shape[2])
        wanted = (white @ difference(swept.poses, fitted)[:, :, None]).reshape(-1)
        held = (white @ swept.held).reshape(len(rows), -1)
        fit = solve(rows, wanted, held)
        left = wanted - rows @ fit.value - held @ fit.held
        return fit.value, CircleFit(state, fit, rows, white, left.reshape(-1, 6))

    state, found = gauss_newton(
        start or _start(swept, terms),
        step,
        _apply_step,
        max_iterations=MAX_ITERATIONS,
        tol_step=TOL_STEP,
    )
    return replace(found, state=state)


def perpendiculars(direction: Array) -> Array:
    """Two unit vectors at right angles to a direction and to each other, (2, 3)."""
    return np.asarray(np.linalg.svd(direction[None])[2][1:], dtype=np.float64)


def fit_terms(swept: SweepPairs, *, circular: bool) -> tuple[EncoderTerms, AxisFit]:
    """Fit with terms of the true angle, which the first fit shows."""
    turned = swept.q
    for _ in range(2):
        terms = _terms(turned, swept.direction, swept.rate, circular=circular)
        fit = fit_axis(swept, terms.columns)
        turned = fit.turned
    return terms, fit


def term_figure(fit: AxisFit, place: int, misfit: float) -> UncertainValue:
    """One term with its uncertainty; `misfit` is by how much chi-squared is too large."""
    if place < 0 or not fit.estimable[place]:
        return NO_FIGURE
    return UncertainValue(
        float(fit.value[place]), float(np.sqrt(fit.covariance[place, place] * misfit))
    )


def find_eccentricity(
    terms: EncoderTerms, fit: AxisFit, misfit: float
) -> tuple[UncertainValue, UncertainValue, bool]:
    """Amplitude, phase, and whether it is there at all; `misfit` as of `term_figure`."""
    both = slice(terms.circular, terms.circular + 2)
    if not fit.estimable[both].all():
        return NO_FIGURE, NO_FIGURE, False
    part, spread = fit.value[both], fit.covariance[both, both] * misfit
    size = float(np.hypot(*part))
    there = bool(chi2_sf(float(part @ np.linalg.solve(spread, part)), 2) < P_FALSE_ECCENTRICITY)
    along = part / size if size > 0 else part
    # without a direction to speak of, the worst known one bounds it
    variance = along @ spread @ along if there else np.linalg.eigvalsh(spread)[-1]
    phase = NO_FIGURE
    if there:
        across = np.array([along[1], -along[0]])
        doubt = float(np.sqrt(across @ spread @ across)) / size
        phase = UncertainValue(float(np.arctan2(part[0], part[1])), doubt)
    return UncertainValue(size, float(np.sqrt(variance))), phase, there


def _start(swept: SweepData, terms: Array) -> AxisState:
    """The mean axis of the turns from pair to pair, and the line that they leave in place."""
    order = np.argsort(swept.q, kind="stable")
    poses, q = swept.poses[order], swept.q[order]
    middle = (q[0] + q[-1]) / 2
    half = len(q) // 2  # turns over half of the sweep: far above noise, below half a turn
    late, early = np.arange(half, len(q)), np.arange(len(q) - half)
    turn = rotation_log(poses[late, :3, :3] @ np.swapaxes(poses[early, :3, :3], 1, 2))
    direction = (q[late] - q[early]) @ turn
    direction = direction / np.linalg.norm(direction)
    first = int(np.argmin(np.abs(q - middle)))
    back = rotation_exp((q - q[first])[:, None] * direction)
    left = (np.eye(3) - back).reshape(-1, 3)
    shift = poses[:, :3, 3] - poses[first, :3, 3]
    arm = np.linalg.lstsq(left, shift.reshape(-1), rcond=1e-6)[0]
    point = poses[first, :3, 3] + arm - direction * (direction @ arm)
    home = rotation_exp(direction * (middle - q[first]))
    start = rigid_transform(
        home @ poses[first, :3, :3], point + home @ (poses[first, :3, 3] - point)
    )
    return AxisState(direction, point, start, np.zeros(terms.shape[1]))


def _predict_poses(swept: SweepData, terms: Array, state: AxisState) -> tuple[Array, Array, Array]:
    """Poses (n, 4, 4), how each moves with a turn about the axis (n, 6), and with it (n, 6, 10)."""
    middle = (swept.q.min() + swept.q.max()) / 2
    turn = rotation_exp((swept.q - middle - terms @ state.value)[:, None] * state.direction)
    places = state.point + turn @ (state.start[:3, 3] - state.point)
    fitted = rigid_transform(turn @ state.start[:3, :3], places)
    arm = places - state.point
    direction = np.tile(state.direction, (len(turn), 1))
    motion = np.concatenate([np.cross(state.direction, arm), direction], axis=1)
    design = np.zeros((len(turn), 6, N_FREE))
    for i, v in enumerate(perpendiculars(state.direction)):
        tilt = np.cross(state.direction, v)  # turns the direction towards v
        moved = tilt - turn @ tilt
        design[:, :3, i] = np.cross(moved, arm)
        design[:, 3:, i] = moved
        design[:, :3, 2 + i] = v - turn @ v
    design[:, :3, 4:7] = turn
    design[:, 3:, 7:10] = turn
    return fitted, motion, design


def _apply_step(state: AxisState, step: Array) -> AxisState:
    across = perpendiculars(state.direction)
    direction = state.direction + step[:2] @ across
    return AxisState(
        direction / np.linalg.norm(direction),
        state.point + step[2:4] @ across,
        displace(state.start, step[4:10]),
        state.value + step[N_FREE:],
    )


def _split_residuals(swept: SweepData, terms: Array, found: CircleFit) -> AxisFit:
    """Split what is left into turns about the axis and the rest."""
    fitted, motion, _ = _predict_poses(swept, terms, found.state)
    left = difference(swept.poses, fitted) - swept.held @ found.solved.held
    weighted = np.linalg.solve(swept.covariance, motion[:, :, None])[:, :, 0]
    information = np.sum(motion * weighted, axis=1)
    angle = np.sum(weighted * left, axis=1) / information
    variance = 1 / information + swept.reading_variance
    rest = left - motion * angle[:, None]
    chi2_rest = np.sum(rest * np.linalg.solve(swept.covariance, rest[:, :, None])[:, :, 0])
    return AxisFit(
        value=found.state.value,
        covariance=found.solved.covariance[N_FREE:, N_FREE:],
        estimable=found.solved.estimable[N_FREE:],
        turned=swept.q - terms @ found.state.value,
        angle_left=angle,
        angle_variance=variance,
        rest=rest,
        chi2_angle=float(np.sum(angle**2 / variance)),
        chi2_rest=float(chi2_rest),
    )


def _terms(turned: Array, direction: Array, rate: Array | None, *, circular: bool) -> EncoderTerms:
    middle = (turned.max() + turned.min()) / 2
    columns, places = [turned - middle], {"hysteresis": -1, "circular": -1, "clock": -1}
    if min(np.sum(direction > 0), np.sum(direction < 0)) >= MIN_PAIRS_PER_DIRECTION:
        places["hysteresis"] = len(columns)
        columns.append(direction / 2 - np.mean(direction / 2))
    if circular:
        places["circular"] = len(columns)
        columns += [np.sin(turned) - np.mean(np.sin(turned))]
        columns += [np.cos(turned) - np.mean(np.cos(turned))]
    if rate is not None:
        places["clock"] = len(columns)
        columns.append(rate - np.mean(rate))
    return EncoderTerms(np.stack(columns, axis=1), **places)
