"""What an adjustment says of its parameters: noise, covariance, and whether views err together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.calibration.stereo import bundle, gauge
from verify.calibration.stereo.gauge import AdjustmentModel
from verify.calibration.stereo.parameters import BundleState, CornerStack
from verify.calibration.stereo.records import Residuals
from verify.core.records import Array
from verify.core.statistics import chi2_ppf

P_FALSE_CLUSTERING = 0.01  # that pairs which err independently seem to err together
MIN_SCATTER_PX = 1e-5  # corners that scatter by less were computed, and what is left is rounding
MIN_PAIRS = 5  # fewer say nothing about how pairs differ


@dataclass(frozen=True, slots=True)
class Estimate:
    """An adjusted state with its uncertainty."""

    state: BundleState
    model: AdjustmentModel
    used: NDArray[np.bool_]  # (n,), corners that were not refused
    system: bundle.NormalEquations
    rows: Array  # (c, 44), constraints
    place: dict[str, int]  # at which row each held coefficient stands
    basis: Array  # (44, p), the free directions
    noise: float  # what the corners' stated uncertainty has to be multiplied with
    degrees_of_freedom: int
    together: float  # by how much the covariance grows because a pair's corners err together, >= 1
    together_degrees: float  # degrees of freedom of that factor

    @property
    def information(self) -> Array:
        """Of the free directions, (p, p), for corners as stated."""
        full: Array = self.basis.T @ self.system.information.sum(axis=0) @ self.basis
        return full

    @property
    def variance(self) -> float:
        """Factor on the inverse information."""
        return self.noise**2 * self.together

    @property
    def covariance(self) -> Array:
        """Of all parameters, (44, 44), SI units and pixels; 0 for what is held."""
        full: Array = self.variance * self.basis @ invert(self.information) @ self.basis.T
        return full


def invert(matrix: Array) -> Array:
    """Invert a positive definite matrix whose rows differ in unit."""
    size = np.sqrt(np.diag(matrix))
    inner = np.linalg.inv(matrix / np.outer(size, size))
    inverse: Array = (inner + inner.T) / 2 / np.outer(size, size)
    return inverse


def estimate_state(
    state: BundleState, corners: CornerStack, model: AdjustmentModel, used: NDArray[np.bool_]
) -> Estimate:
    """Take stock of an adjusted state."""
    return estimate_constrained(
        state, corners, model, used, gauge.constraints(state, model, corners.pan[0])
    )


def estimate_constrained(
    state: BundleState,
    corners: CornerStack,
    model: AdjustmentModel,
    used: NDArray[np.bool_],
    constraints: tuple[Array, dict[str, int]],
) -> Estimate:
    """Take stock of an adjusted state with what was held given.

    Args:
        state: adjusted.
        corners: of all views.
        model: what was adjusted.
        used: (n,), corners that were not refused.
        constraints: rows that hold the rest, and their place, as of `gauge.constraints`.
    """
    weight = used.astype(float)
    system = bundle.normal_equations(state, corners, model, weight)
    rows, place = constraints
    basis = gauge.free_directions(rows)
    degrees = 2 * int(used.sum()) - basis.shape[1] - 6 * len(state.boards)
    squares = bundle.cost(state, corners, model, weight)
    finest = MIN_SCATTER_PX / float(np.median(corners.uncertainty))
    noise = max(float(np.sqrt(squares / max(degrees, 1))), finest)
    together, own_degrees = design_effect(system, basis, noise)
    return Estimate(
        state, model, used, system, rows, place, basis, noise, degrees, together, own_degrees
    )


def collect_residuals(
    found: Estimate, corners: CornerStack, frames: NDArray[np.int64]
) -> Residuals:
    """Residuals of all corners by their pictures' frames, each with what it was weighed by."""
    return Residuals(
        camera=corners.camera,
        frame=frames[corners.board],
        corner=corners.corner,
        seen=corners.seen,
        residual=corners.seen - bundle.predict(found.state, corners),
        uncertainty=corners.uncertainty * found.noise,
        used=found.used,
    )


def design_effect(
    system: bundle.NormalEquations, basis: Array, noise: float
) -> tuple[float, float]:
    """By how much pairs pull at the parameters harder than independent corners would.

    A board that is not flat, or a blur that shifts all corners of a picture, makes the corners of
    a pair err together, which the scatter of single residuals does not show. Each pair's pull at
    the parameters does: its square, measured in the parameters' own information and summed over
    pairs, against what independent corners give. The factor counts where chance exceeds it once
    in a hundred.

    Args:
        system: the normal equations, a block a pair, at the adjusted state.
        basis: (44, p), the free directions.
        noise: what the corners' stated uncertainty has to be multiplied with.

    Returns:
        Factor on the variances, 1 or more, and the degrees of freedom that it rests on.

    Source: the cluster-robust covariance of Liang and Zeger, Biometrika 73, 1986, averaged over
    the parameters, as there are too few pairs to fill a matrix; Rao and Scott's design effect.
    """
    count = len(system.information)
    if count < MIN_PAIRS:
        return 1.0, np.inf
    information = basis.T @ system.information @ basis
    pull = system.gradient @ basis / noise
    inverse = invert(information.sum(axis=0))
    share = inverse @ information  # (b, p, p)
    seen = float(np.einsum("bi,ij,bj->", pull, inverse, pull))
    squared = np.einsum("bij,bji->b", share, share)
    expected = len(inverse) - float(squared.sum())
    # the pulls of two pairs are correlated through the parameters that both helped to find
    own = share - share @ share
    spread = 2 * float(np.einsum("bij,bji->", own, own))
    if expected <= 0 or spread <= 0:
        return 1.0, np.inf
    degrees = 2 * expected**2 / spread
    factor = seen / expected
    if factor <= 1 or factor * degrees <= chi2_ppf(1 - P_FALSE_CLUSTERING, degrees):
        return 1.0, np.inf
    return factor, float(degrees)


def board_covariance(found: Estimate, covariance: Array) -> Array:
    """Of each board's pose, (b, 6, 6), m and rad, with the rig's own share (44, 44)."""
    shared = found.system.shared[:, :6]
    own = found.variance * found.system.own[:, :6, :6]
    full: Array = own + shared @ covariance @ shared.transpose(0, 2, 1)
    return full


def held_response(found: Estimate, names: tuple[str, ...]) -> Array:
    """How the estimate moves when held coefficients are held elsewhere, (44, h).

    A unit of each named coefficient (which the model holds); the others stay held.
    """
    full = found.system.information.sum(axis=0)
    forced = np.linalg.pinv(found.rows)[:, [found.place[n] for n in names]]
    pulled = found.basis.T @ full @ forced
    moved: Array = forced - found.basis @ invert(found.information) @ pulled
    return moved
