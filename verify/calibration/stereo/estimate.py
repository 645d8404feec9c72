"""Robust adjustment, and its estimate: noise, covariance of all parameters, boards, edge lengths.

Gross errors get Cauchy weights at first and are refused in the end. With the squared residual d² of
a corner in its stated covariance and the variance factor s² from the median of all d²:

    start    minimise sum of log(1 + d² / (3² s²)), by reweighting with 1 / (1 + d² / (3² s²))
    end      least squares on the corners with d² < chi²(p) s², s² that of their view if larger

p is such that one corner in a hundred calibrations with normal noise is refused.

The parameters p are those of `parameters`, with free directions B (47, q) that span what the
constraints leave; N_b is the information of the corners of pair b on p, as stated, N their sum with
what is known beforehand, g_b each pair's gradient:

    covariance(p) = noise² B R' M R B'     R' R = (B' N B)⁻¹
    noise²        = chi² / degrees of freedom          what the stated uncertainty is multiplied by
    M             = (1 - w) S + w effect, where the corners of a pair err together; else 1
    effect        = sum of g_b' N⁻¹ g_b / its expectation
    S             = sum of R B' g_b g_b' B R', each g_b for its leverage
    w             = |S - effect|² by chance alone / the one found, at most 1

S alone knows which parameters suffer, but few pairs show it by chance as well.

Source: the cluster-robust covariance of Liang and Zeger, Biometrika 73, 1986, with the leverage of
Bell and McCaffrey, Survey Methodology 28, 2002; Rao and Scott's design effect; the shrinkage of
Ledoit and Wolf, J. Multivariate Analysis 88, 2004, with normal gradients.
"""

from dataclasses import dataclass

import numpy as np

from verify.calibration.stereo import bundle, gauge
from verify.calibration.stereo.gauge import AdjustmentModel
from verify.calibration.stereo.parameters import BundleState, CornerStack
from verify.core.fiducials import Board
from verify.core.records import Array, Flags
from verify.core.statistics import chi2_ppf
from verify.measurement.triangulation import ray_midpoints, rays

P_FALSE_CLUSTERING = 0.01  # that independent corners seem to err together
MIN_SCATTER_PX = 1e-5  # corners that scatter by less were computed: rounding is left
MIN_PAIRS = 5  # fewer do not show how pairs differ
MIN_LEFT = 0.01  # of a direction that one pair determines alone: what the others say of it
MEDIAN_CHI2 = 1.386  # of chi² with two degrees of freedom
CAUCHY_SCALE = 3.0  # standard deviations at which a corner weighs half
MAX_ROUNDS = 8
TOL_COST = 0.01  # share of the cost; the adjustment with equal weights does the rest
MAX_FALSE_REFUSALS = 0.01  # expected in a whole calibration whose noise is normal


@dataclass(frozen=True, slots=True)
class Estimate:
    """An adjusted state with its uncertainty."""

    state: BundleState
    model: AdjustmentModel
    used: Flags  # (n,), corners that were not refused
    system: bundle.NormalEquations
    basis: Array  # (47, p), the free directions
    noise: float  # factor on the corners' stated uncertainty
    degrees_of_freedom: int
    covariance: Array  # (47, 47), SI units and pixels; 0 for what is held
    design_effect: float  # mean factor on variances, as a pair's corners err together, >= 1
    design_effect_degrees: float  # degrees of freedom of that factor

    @property
    def variance(self) -> float:
        """Factor on the inverse information."""
        return self.noise**2 * self.design_effect


def estimate_state(
    state: BundleState, corners: CornerStack, model: AdjustmentModel, used: Flags
) -> Estimate:
    """Find noise and covariance of an adjusted state by the corners (n,) that were not refused."""
    weight = used.astype(float)
    system = bundle.normal_equations(state, corners, model, weight)
    basis = gauge.free_directions(gauge.constraints(state, model, corners.pan[0]))
    degrees = 2 * int(used.sum()) - basis.shape[1] - 6 * len(state.boards)
    squares = bundle.cost(state, corners, model, weight)
    finest = MIN_SCATTER_PX / float(np.median(corners.uncertainty))
    noise = max(float(np.sqrt(squares / max(degrees, 1))), finest)
    root = inverse_root(basis.T @ system.total @ basis)
    share = root @ (basis.T @ system.information @ basis) @ root.T
    pull = system.gradient @ basis @ root.T / noise
    factor, factor_degrees = design_effect(share, pull)
    scatter = np.eye(len(root)) if factor == 1 else pair_scatter(share, pull, factor)
    half = noise * basis @ root.T
    covariance = half @ scatter @ half.T
    return Estimate(
        state, model, used, system, basis, noise, degrees, covariance, factor, factor_degrees
    )


def inverse_root(matrix: Array) -> Array:
    """A root R of the inverse of a positive definite matrix, R' R, whose rows differ in unit."""
    size = np.sqrt(np.diag(matrix))
    values, directions = np.linalg.eigh(matrix / np.outer(size, size))
    values = np.maximum(values, np.finfo(float).eps)
    root: Array = (directions / np.sqrt(values)).T / size
    return root


def readjust(found: Estimate, corners: CornerStack, model: AdjustmentModel) -> Estimate:
    """Adjust another model from an estimate's state with the corners that it used."""
    state = bundle.adjust(found.state, corners, model, found.used.astype(float))
    return estimate_state(state, corners, model, found.used)


def design_effect(share: Array, pull: Array) -> tuple[float, float]:
    """Test whether the corners of a pair err together, and by what factor variances then grow.

    A board that is not flat, or blur that shifts all corners of an image, makes the corners of a
    pair err together, which single residuals do not show but each pair's gradient does. The factor
    counts where chance exceeds it once in a hundred.

    Whitened, `share` (b, p, p) is each pair's share of all information and `pull` (b, p) its
    gradient at the adjusted state. Returns the mean factor on variances, 1 or more, and its degrees
    of freedom.
    """
    if len(pull) < MIN_PAIRS:
        return 1.0, np.inf
    # the gradients of two pairs are correlated through the parameters that both determine: of their
    # covariance M, blocks share_b less share_b share_c, the traces of M, M² and M³
    square = share @ share
    one, two, three, four = (
        np.sum(power, axis=0) for power in (share, square, share @ square, square @ square)
    )
    expected = float(np.trace(one - two))
    spread = 2 * float(np.trace(two - 2 * three + two @ two))
    skew = 8 * float(np.trace(three - 3 * four + 3 * three @ two - two @ two @ two))
    if expected <= 0 or spread <= 0 or skew <= 0:
        return 1.0, np.inf
    found, degrees = float(np.sum(pull**2)), 8 * spread**3 / skew**2
    unlikely = chi2_ppf(1 - P_FALSE_CLUSTERING, degrees)
    if found <= expected + (unlikely - degrees) * np.sqrt(spread / (2 * degrees)):
        return 1.0, np.inf
    factor, degrees = found / expected, 2 * expected**2 / spread
    return factor, float(degrees)


def pair_scatter(share: Array, pull: Array, factor: float) -> Array:
    """Scatter (p, p) of the whitened parameters by the pairs' gradients, shrunk to their mean."""
    unit = np.eye(share.shape[1])
    left, directions = np.linalg.eigh(unit - share)
    along = np.einsum("bji,bj->bi", directions, pull) / np.sqrt(np.maximum(left, MIN_LEFT))
    terms = np.einsum("bij,bj->bi", directions, along)
    scatter: Array = terms.T @ terms + factor * (unit - share.sum(axis=0))  # known beforehand
    # a pair's term is normal with covariance factor * share: the variance of its square
    chance = np.sum(np.einsum("bii->b", share) ** 2) + np.sum(share**2)
    apart = np.sum((scatter - factor * unit) ** 2)
    weight = min(1.0, float(factor**2 * chance / apart))
    return (1 - weight) * scatter + weight * factor * unit


def board_covariance(found: Estimate, covariance: Array) -> Array:
    """Covariance of each board's pose, (b, 6, 6), m and rad; `covariance` (47, 47): shared."""
    shared = found.system.shared[:, :6]
    own = found.variance * found.system.own[:, :6, :6]
    return own + shared @ covariance @ shared.transpose(0, 2, 1)


def square_edges(found: Estimate, corners: CornerStack, board: Board) -> tuple[float, float, float]:
    """Measure the squares' edges by triangulating corners that both cameras observed, m.

    Returns the mean edge, its standard uncertainty from the scatter of the pairs' means, and the
    standard deviation of single edges; NaN where no pair shows two neighbouring corners twice.
    """
    edges = []
    for pair in range(len(found.state.boards)):
        points = _triangulate_corners(found, corners, pair, board)
        # along the board's own axes: noise across an edge would make every distance longer
        grid = (points @ found.state.boards[pair][:3, :3]).reshape(board.rows, board.columns, 3)
        along, down = np.diff(grid[..., 0], axis=1), np.diff(grid[..., 1], axis=0)
        lengths = np.concatenate([along.ravel(), down.ravel()])
        edges.append(lengths[np.isfinite(lengths)])
    edges = [lengths for lengths in edges if len(lengths)]
    if not edges:
        return float("nan"), float("nan"), float("nan")
    every = np.concatenate(edges)
    means = np.array([lengths.mean() for lengths in edges])
    scatter = float(means.std(ddof=1) / np.sqrt(len(means))) if len(means) > 1 else float("nan")
    return float(every.mean()), scatter, float(every.std(ddof=1))


def _triangulate_corners(found: Estimate, corners: CornerStack, pair: int, board: Board) -> Array:
    """Triangulate one pair's corners, (corners of the board, 3), m, rig; NaN where not in both."""
    rows = found.used & (corners.board == pair)
    pixels = np.full((2, len(board), 2), np.nan)
    pixels[corners.camera[rows], corners.corner[rows]] = corners.observed[rows]
    both = np.flatnonzero(np.isfinite(pixels).all(axis=(0, 2)))
    points = np.full((len(board), 3), np.nan)
    if len(both):
        pan = corners.pan[pair] + found.state.pan_error[pair]
        left, right = (
            rays(camera, angle, own[both])
            for camera, angle, own in zip(found.state.cameras, pan, pixels, strict=True)
        )
        points[both] = ray_midpoints(*left, *right)[0]
    return points


def robust_scale(squares: Array) -> float:
    """Variance factor of corners from the median of their squared distances (n,)."""
    return float(np.median(squares)) / MEDIAN_CHI2 if len(squares) else 1.0


def adjust_cauchy(state: BundleState, corners: CornerStack, model: AdjustmentModel) -> BundleState:
    """Adjust with Cauchy weights, so that gross errors do not spoil the start."""
    squares, before = bundle.squared_distances(state, corners), np.inf
    for _ in range(MAX_ROUNDS):
        factor = max(robust_scale(squares), 1e-12)
        weight = 1 / (1 + squares / (CAUCHY_SCALE**2 * factor))
        state = bundle.adjust(state, corners, model, weight, iterations=2)
        squares = bundle.squared_distances(state, corners)
        now = float(np.sum(np.log1p(squares / (CAUCHY_SCALE**2 * factor))))
        if abs(before - now) < TOL_COST * now:
            break
        before = now
    return state


def good_corners(state: BundleState, corners: CornerStack) -> Flags:
    """Select the corners that the others of their own view do not contradict, (n,).

    A view's own scatter counts where it is above the others': of a blurred image not most corners
    are refused, which would leave the few best and too small an uncertainty.
    """
    squares = bundle.squared_distances(state, corners)
    limit = 2 * np.log(len(corners) / MAX_FALSE_REFUSALS)  # chi² with two degrees of freedom
    view = 2 * corners.board + corners.camera
    scale = np.full(len(corners), max(robust_scale(squares), 1e-12))
    for v in np.unique(view):
        own = view == v
        scale[own] = np.maximum(scale[own], robust_scale(squares[own]))
    kept: Flags = squares < limit * scale
    return kept


def adjust_robust(state: BundleState, corners: CornerStack, model: AdjustmentModel) -> Estimate:
    """Adjust with equal weights on the good corners, refusing the others."""
    used = good_corners(state, corners)
    for _ in range(3):  # a refused corner may come back once the state is better
        state = bundle.adjust(state, corners, model, used.astype(float))
        again = good_corners(state, corners)
        if np.array_equal(again, used):
            break
        used = again
    return estimate_state(state, corners, model, used)
