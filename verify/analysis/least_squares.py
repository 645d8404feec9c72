"""Weighted least squares over a session: whitened rows, free columns, and columns held by a prior.

A stated uncertainty that does not average out is a column whose coefficient is known to be zero
within that uncertainty. Fitting it beside the free ones gives estimates and uncertainties that
hold random and systematic parts together, without a covariance of all pairs with all pairs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from verify.analysis.comparison import Comparison
from verify.core.records import Array, Flags, Index

State = TypeVar("State")
Solution = TypeVar("Solution")

CHUNK = 4000  # rows reduced at a time
MIN_REDUCTION = 2  # rows a row of the triangular factor
MIN_PAIRS_CORRELATION = 12  # pairs; the bias correction needs more than its own size
MAX_CORRELATION = 0.95  # closer to 1 the length of the session says nothing any more
TOL_RANK = 1e-9  # singular values below this share of the largest are rounding


@dataclass(frozen=True, slots=True)
class Whitener:
    """Turns (n, 6, c) columns into rows of unit variance, undetermined directions left out."""

    factors: tuple[Array, ...]  # n of (d, 6)
    pair: Index  # (rows,), which pair each row belongs to

    def rows(self, columns: Array) -> Array:
        """Whiten (n, 6, c) to (rows, c)."""
        if not self.factors:
            return np.zeros((0, columns.shape[2]))
        if len({f.shape for f in self.factors}) == 1:
            stacked: Array = np.array(self.factors) @ columns
            return stacked.reshape(len(self.pair), columns.shape[2])
        return np.concatenate([f @ c for f, c in zip(self.factors, columns, strict=True)])

    def by_pair(self, rows: Array) -> Array:
        """Lay rows (r,) out as one line a pair, (n, 6), nan where a pair has fewer."""
        laid = np.full((len(self.factors), 6), np.nan)
        if self.factors:
            place = np.concatenate([np.arange(len(f)) for f in self.factors])
            laid[self.pair, place] = rows
        return laid


def whiten(comparison: Comparison, covariance: Array | None = None) -> Whitener:
    """Whitening of a comparison by what varies from pair to pair, or by another (n, 6, 6)."""
    spread = comparison.covariance if covariance is None else covariance
    alike: dict[int, list[int]] = {}  # pairs that know equally many directions, done together
    for i, known in enumerate(comparison.determined):
        alike.setdefault(known.shape[1], []).append(i)
    found: dict[int, Array] = {}
    for some in alike.values():
        turned = np.swapaxes(np.array([comparison.determined[i] for i in some]), 1, 2)
        lower = np.linalg.cholesky(turned @ spread[some] @ np.swapaxes(turned, 1, 2))
        found.update(zip(some, np.linalg.solve(lower, turned), strict=True))
    factors = [found[i] for i in range(len(found))]
    pair = np.repeat(np.arange(len(factors)), [len(f) for f in factors])
    return Whitener(tuple(factors), pair.astype(np.int64))


def pair_misfits(comparison: Comparison, count: int, usual: Array) -> tuple[Array, Array]:
    """Squared misfit of each of a track's pairs beside usual errors (j,), (n,); nan unread.

    And (j, n), what any error of one joint would leave of it.
    """
    white, rest = whiten(comparison), comparison.xi - comparison.jacobian @ usual
    rows = white.rows(np.concatenate([rest[:, :, None], comparison.jacobian], axis=2)).T
    of, by, own = (
        np.array([np.bincount(white.pair, row, len(comparison)) for row in product])
        for product in (rows[:1] ** 2, rows[0] * rows[1:], rows[1:] ** 2)
    )
    misfits = np.full((len(rows), count), np.nan)
    misfits[:, comparison.index] = np.concatenate([of, of - by**2 / own])
    return misfits[0], misfits[1:]


@dataclass(frozen=True, slots=True)
class RegressionFit:
    """A solved regression; c free columns."""

    value: Array  # (c,)
    covariance: Array  # (c, c), everything stated included; of use on estimable columns alone
    estimable: Flags  # (c,), the data determine this column's coefficient
    chi2: float  # of the rows and the prior together
    degrees_of_freedom: int
    held: Array  # (p,), coefficients of the prior columns, in their standard deviations


def solve(rows: Array, target: Array, prior: Array | None = None) -> RegressionFit:
    """Least squares of `target` (r,) on free columns `rows` (r, c) and prior columns (r, p).

    Prior columns are scaled so that their coefficients have unit variance about zero.
    """
    free = rows.shape[1]
    held = np.zeros((len(rows), 0)) if prior is None else prior
    count = free + held.shape[1]
    reduced = _append_prior(_triangular_factor(rows, held, target[:, None]), free, held.shape[1])
    design, wanted = reduced[:, :count], reduced[:, count]
    scale = np.linalg.norm(design, axis=0)
    empty = scale == 0
    scale[empty] = 1.0
    left, size, right = np.linalg.svd(design / scale, full_matrices=False)
    good = size > TOL_RANK * max(float(size[0]), 1e-300) if len(size) else np.zeros(0, dtype=bool)
    basis = right[good].T
    solution = basis @ ((left[:, good].T @ wanted) / size[good]) / scale
    covariance = (basis / size[good] ** 2) @ basis.T / np.outer(scale, scale)
    hidden = 1.0 - np.sum(right[good] ** 2, axis=0)
    hidden[empty] = 1.0
    residual = wanted - design @ solution
    return RegressionFit(
        value=solution[:free],
        covariance=covariance[:free, :free],
        estimable=hidden[:free] < 1e-6,  # a millionth of a share is rounding in the null space
        chi2=float(residual @ residual),
        degrees_of_freedom=int(len(target) - good.sum() + held.shape[1]),
        held=solution[free:],
    )


def gauss_newton(
    start: State,
    solve_step: Callable[[State], tuple[Array, Solution]],
    move: Callable[[State, Array], State],
    *,
    max_iterations: int,
    tol_step: float,
) -> tuple[State, Solution]:
    """Minimise a sum of squares by solving it linearised, again and again.

    `solve_step` gives the step (p,) of the problem linearised at some parameters, and what else of
    it is of use; the last one is returned beside the parameters. `move` takes a step; one with no
    entry larger than `tol_step` is the last.
    """
    state = start
    for _ in range(max_iterations):
        step, solution = solve_step(state)
        state = move(state, step)
        if np.abs(step).max(initial=0.0) < tol_step:
            break
    return state, solution


def residual_products(columns: Array, held: Array, targets: list[Array]) -> Array:
    """Products of what free columns and held ones leave of t target columns, (t, t).

    The targets come in parts, (r, ...) each, side by side.
    """
    free = columns.shape[1]
    count = free + held.shape[1]
    reduced = _append_prior(_triangular_factor(columns, held, *targets), free, held.shape[1])
    design, wanted = reduced[:, :count], reduced[:, count:]
    norm = np.linalg.norm(design, axis=0)
    design = design[:, norm > 0] / norm[norm > 0]
    left, size, _ = np.linalg.svd(design, full_matrices=False)
    basis = left[:, size > TOL_RANK * size[0]] if len(size) else left[:, :0]
    remaining = wanted - basis @ (basis.T @ wanted)
    return remaining.T @ remaining


def _triangular_factor(*parts: Array) -> Array:
    """The triangular factor of columns side by side, or their rows, where they are few.

    A chunk of rows at a time.

    All that least squares needs of rows is their products; the factor holds them without squaring
    the condition, and a session of any length fits into one chunk's memory.
    """
    width = sum(p.shape[1] for p in parts)
    triangle = np.zeros((0, width))
    for start in range(0, len(parts[0]), CHUNK):
        rows = np.concatenate([p[start : start + CHUNK] for p in parts], axis=1)
        triangle = np.concatenate([triangle, rows])  # the chunk itself is not needed beside it
        if len(triangle) > MIN_REDUCTION * width:  # else a factor costs more than it saves
            triangle = np.asarray(np.linalg.qr(triangle, mode="r"), dtype=np.float64)
    return triangle


def _append_prior(triangle: Array, free: int, held: int) -> Array:
    """Append one row of unit weight for each held column."""
    penalty = np.zeros((held, triangle.shape[1]))
    penalty[:, free : free + held] = np.eye(held)
    return np.concatenate([triangle, penalty])


def autocorrelation(by_pair: Array) -> Array:
    """By how much correlation from pair to pair inflates the variance of a mean, (6,), >= 1.

    `by_pair` (n, 6): whitened residuals in time order, nan where missing. One factor a whitened
    direction, as alignment correlates depth and leaves the rest alone: (1 + rho) / (1 - rho) with
    the lag-one correlation rho, corrected for its bias, where it is significant.
    """
    factors = np.ones(by_pair.shape[1])
    for i, column in enumerate(by_pair.T):
        series = column[~np.isnan(column)]
        n = len(series)
        series = series - series.mean() if n else series
        power = float(series @ series)
        if n < MIN_PAIRS_CORRELATION or power == 0:
            continue
        rho = float(series[1:] @ series[:-1]) / power
        if rho > 2 / np.sqrt(n):  # two standard deviations of white noise
            corrected = min((n * rho + 1) / (n - 4), MAX_CORRELATION)
            factors[i] = (1 + corrected) / (1 - corrected)
    return factors
