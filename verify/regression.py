"""Weighted least squares over a session: whitened rows, free columns, and columns held by a prior.

A stated uncertainty that does not average out is a column whose coefficient is known to be zero
within that uncertainty. Fitting it beside the free ones gives estimates and uncertainties that
hold random and systematic parts together, without a covariance of all pairs with all pairs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.comparison import Comparison
from verify.records import Array

RANK = 1e-9  # singular values below this share of the largest are rounding


@dataclass(frozen=True, slots=True)
class Whitener:
    """Turns (n, 6, c) columns into rows of unit variance, undetermined directions left out."""

    factors: tuple[Array, ...]  # n of (d, 6)
    pair: NDArray[np.int64]  # (rows,), which pair each row belongs to

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
    factors: list[Array] = []
    for block, known in zip(spread, comparison.determined, strict=True):
        lower = np.linalg.cholesky(known.T @ block @ known)
        factors.append(np.asarray(np.linalg.solve(lower, known.T), dtype=np.float64))
    pair = np.repeat(np.arange(len(factors)), [len(f) for f in factors])
    return Whitener(tuple(factors), pair.astype(np.int64))


@dataclass(frozen=True, slots=True)
class Fit:
    """A solved regression; c free columns."""

    value: Array  # (c,)
    covariance: Array  # (c, c), everything stated included; inf-free only on estimable columns
    estimable: NDArray[np.bool_]  # (c,), the data determine this column's coefficient
    chi2: float  # of the rows and the prior together
    degrees_of_freedom: int
    residual: Array  # (rows,), whitened, with all fitted columns taken off


def solve(rows: Array, target: Array, prior: Array | None = None) -> Fit:
    """Least squares of `target` (r,) on free columns `rows` (r, c) and prior columns (r, p).

    Prior columns are scaled so that their coefficients have unit variance about zero.
    """
    free = rows.shape[1]
    held = np.zeros((len(rows), 0)) if prior is None else prior
    design = np.concatenate([rows, held], axis=1)
    penalty = np.concatenate([np.zeros((held.shape[1], free)), np.eye(held.shape[1])], axis=1)
    design = np.concatenate([design, penalty])
    wanted = np.concatenate([target, np.zeros(held.shape[1])])
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0] = 1.0
    left, size, right = np.linalg.svd(design / scale, full_matrices=False)
    good = size > RANK * max(float(size[0]), 1e-300) if len(size) else np.zeros(0, dtype=bool)
    basis = right[good].T
    solution = basis @ ((left[:, good].T @ wanted) / size[good]) / scale
    covariance = (basis / size[good] ** 2) @ basis.T / np.outer(scale, scale)
    hidden = np.sum(right[~good] ** 2, axis=0) if (~good).any() else np.zeros(design.shape[1])
    residual = wanted - design @ solution
    return Fit(
        value=solution[:free],
        covariance=covariance[:free, :free],
        estimable=hidden[:free] < 1e-6,  # a millionth of a share is rounding in the null space
        chi2=float(residual @ residual),
        degrees_of_freedom=int(len(target) - good.sum() + held.shape[1]),
        residual=residual[: len(target)],
    )


def project_out(columns: Array, target: Array, prior: Array | None = None) -> Array:
    """What free columns (and held ones) leave of target columns, with the prior's rows appended."""
    held = np.zeros((len(target), 0)) if prior is None else prior
    design = np.concatenate(
        [
            np.concatenate([columns, held], axis=1),
            np.concatenate([np.zeros((held.shape[1], columns.shape[1])), np.eye(held.shape[1])], 1),
        ]
    )
    wanted = np.concatenate([target, np.zeros((held.shape[1], target.shape[1]))])
    norm = np.linalg.norm(design, axis=0)
    design = design[:, norm > 0] / norm[norm > 0]
    left, size, _ = np.linalg.svd(design, full_matrices=False)
    basis = left[:, size > RANK * size[0]] if len(size) else left[:, :0]
    remaining: Array = wanted - basis @ (basis.T @ wanted)
    return remaining


def autocorrelation_factor(by_pair: Array) -> float:
    """By how much correlation from pair to pair inflates the variance of a mean, >= 1.

    1 + 2 sum rho over the first run of lags in which rho is significant.

    Args:
        by_pair: (n, 6) whitened residuals in time order, nan where missing.
    """
    series = np.nan_to_num(by_pair - np.nanmean(by_pair, axis=0)) if len(by_pair) else by_pair
    power = float(np.sum(series**2))
    if len(series) < 10 or power == 0:
        return 1.0  # fewer pairs show no correlation
    limit = 2 / np.sqrt(series.size)  # two standard deviations of rho for white noise
    total = 0.0
    for lag in range(1, len(series) // 4):
        rho = float(np.sum(series[lag:] * series[:-lag])) / power
        if rho < limit:
            break
        total += rho
    return 1 + 2 * total
