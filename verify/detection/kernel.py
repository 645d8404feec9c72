"""The fit's inner loop, compiled: the way down to a patch's spot."""

import math

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled, compiled_sums
from verify.detection.kernel_clip import SENSOR_LIMIT
from verify.detection.kernel_pixels import (
    FLOOR,
    FOOT,
    MEAN,
    OUTLIER,
    OWN,
    PARAMETERS,
    PEAK,
    RADIUS2,
    RESIDUAL,
    SLOPE_X,
    SLOPE_Y,
    STEEPNESS,
    VARIANCE,
    VISIBLE,
    WHITENED,
    XX,
    XY,
    YY,
    X,
    Y,
    weigh,
)
from verify.records import Array
from verify.small_matrices import factor, solve

FIRST_DAMPING = 1e-4
UNTOLD = 1e-9  # information in every direction: of a patch none of whose pixels counts
CORE = 1.5  # half-widths: the spot's own pixels, by which its fit is judged
CORE_LEAST = 3.0  # px, likewise for the smallest: 28 pixels against 8 parameters
SEEN = 0.9  # share of a pixel's noise that clipping must leave for its residual to count


@compiled_sums
def sum_products(rows: Array, products: Array) -> None:
    """Products of every row (m, p) with every other, (m, m); m is odd.

    Two rows by two at once: what is loaded is used twice.
    """
    last = rows.shape[0] - 1
    for a in range(0, last, 2):
        for b in range(0, a + 1, 2):
            first, right, below, both = 0.0, 0.0, 0.0, 0.0
            for k in range(rows.shape[1]):
                first += rows[a, k] * rows[b, k]
                right += rows[a, k] * rows[b + 1, k]
                below += rows[a + 1, k] * rows[b, k]
                both += rows[a + 1, k] * rows[b + 1, k]
            products[a, b] = products[b, a] = first
            products[a, b + 1] = products[b + 1, a] = right
            products[a + 1, b] = products[b, a + 1] = below
            products[a + 1, b + 1] = products[b + 1, a + 1] = both
    for b in range(last + 1):
        total = 0.0
        for k in range(rows.shape[1]):
            total += rows[last, k] * rows[b, k]
        products[last, b] = products[b, last] = total


@compiled
def normal_equations(
    p: Array, rows: Array, out: float, prior: Array, information: Array, gradient: Array
) -> float:
    """Sum the pixels up; `prior` (2, 10) is mean and inverse variance. Gives chi²."""
    products = np.empty((WHITENED, WHITENED))
    sum_products(rows, products)
    chi2 = products[RESIDUAL, RESIDUAL] + out
    for a in range(PARAMETERS):
        off = prior[0, a] - p[a]
        information[a] = products[a, :PARAMETERS]
        information[a, a] += prior[1, a]
        gradient[a] = products[RESIDUAL, a] + prior[1, a] * off
        chi2 += prior[1, a] * off * off
    return float(chi2)


@compiled
def shorten(step: NDArray[np.floating], p: Array) -> bool:
    """Shorten a step that leaves the region in which the linearisation means anything.

    Returns:
        Whether it did.
    """
    least = min(p[XX], p[YY])
    ratio = max(abs(step[X]), abs(step[Y])) / 1.5  # px
    ratio = max(ratio, abs(step[PEAK]) / (0.7 * p[PEAK]))
    ratio = max(ratio, abs(step[FLOOR]) / 30.0)  # DN
    ratio = max(ratio, max(abs(step[SLOPE_X]), abs(step[SLOPE_Y])) / 5.0)  # DN a px
    ratio = max(ratio, max(abs(step[XX]), abs(step[XY]), abs(step[YY])) / (0.45 * least))
    ratio = max(ratio, abs(step[STEEPNESS]) / 0.5)
    if ratio > 1.0:
        step /= ratio
    return bool(ratio > 1.0)


@compiled
def carry_means(step: Array, rows: Array, known: Array) -> None:
    """Let the means of the pixels that count follow a small step (10,), to first order."""
    moved = np.zeros(rows.shape[1])
    for a in range(PARAMETERS):
        for k in range(rows.shape[1]):
            moved[k] += step[a] * rows[a, k]
    for k in range(rows.shape[1]):
        known[MEAN, k] += moved[k] * math.sqrt(known[VARIANCE, k])


@compiled
def mark_own(p: Array, pixels: Array, known: Array) -> None:
    """Mark the pixels that are the spot's own: its core, and for the smallest a few about it."""
    for k in range(pixels.shape[1]):
        x, y = pixels[2, k] - p[X], pixels[3, k] - p[Y]
        near = known[RADIUS2, k] < CORE**2 or x * x + y * y < CORE_LEAST**2
        known[OWN, k] = pixels[1, k] if near else 0.0


@compiled_sums
def deviation(p: Array, pixels: Array, known: Array, variance: Array, prior: Array) -> float:
    """Chi² of a patch at p under given variances (p,): `known` tells the means alone."""
    total = 0.0
    for k in range(pixels.shape[1]):
        residual = pixels[0, k] - known[MEAN, k]
        square = residual * residual / variance[k]
        outside = known[RADIUS2, k] > FOOT**2 and square > OUTLIER**2
        total += pixels[1, k] * (OUTLIER**2 if outside else square)
    for a in range(PARAMETERS):
        off = prior[0, a] - p[a]
        total += prior[1, a] * off * off
    return total


@compiled
def descend(
    p: Array,
    pixels: Array,
    scale: float,
    noise: Array,
    table: Array,
    prior: Array,
    steps: int,
    settled: float,
    known: Array,
    rows: Array,
    information: Array,
    gradient: Array,
) -> float:
    """Fit one patch by Gauss-Newton with Levenberg's damping until it settles.

    Args:
        p: (10,), to begin with; the best met, afterwards.
        pixels: as for `weigh`, and so are scale, noise and table.
        scale: px.
        noise: of this patch.
        table: of the profiles.
        prior: as for `normal_equations`.
        steps: at most; 0 looks how the pixels stand at p.
        settled: of chi² that a step may still gain. It is taken, and nothing is looked at anew.
        known: filled as by `weigh`, where the last step but that one ended, the means alone where
            that one does.
        rows: whitened derivatives and residual, where the last step but that one ended.
        information: (10, 10), filled.
        gradient: (10,), filled.

    Returns:
        chi².
    """
    size = pixels.shape[1]
    tried_information, tried_gradient = np.empty_like(information), np.empty_like(gradient)
    root, step = np.empty_like(information), np.empty_like(gradient)
    out = weigh(p, pixels, scale, noise, table, known, rows)
    chi2 = normal_equations(p, rows, out, prior, information, gradient)
    variance, stands = known[VARIANCE].copy(), chi2
    damping, refused = FIRST_DAMPING, False
    for _ in range(steps):
        damped = information.copy()
        for a in range(PARAMETERS):
            damped[a, a] = damped[a, a] * (1.0 + damping) + UNTOLD
        factor(damped, 0.0, root)
        step[:] = gradient
        solve(root, step)
        shortened = shorten(step, p)
        gained = float(step @ gradient)  # what the step takes from chi²
        if gained <= settled * (1.0 + chi2 / size) and not shortened:
            p += step
            chi2 -= gained
            carry_means(step, rows, known)
            break
        tried = p + step
        out = weigh(tried, pixels, scale, noise, table, known, rows)
        trial = normal_equations(tried, rows, out, prior, tried_information, tried_gradient)
        # The weights move with the model, and chi² with them: a step is judged by those that it
        # was found with.
        refused = not deviation(tried, pixels, known, variance, prior) <= 1.1 * stands + 1.0
        if refused:
            damping *= 30.0
            continue
        p[:], chi2, damping = tried, trial, damping / 10.0
        information[:], gradient[:] = tried_information, tried_gradient
        variance[:], stands = known[VARIANCE], chi2
    if refused:
        weigh(p, pixels, scale, noise, table, known, rows)
    mark_own(p, pixels, known)
    return float(chi2)


@compiled
def descend_all(
    p: Array,
    pixels: Array,
    scale: Array,
    shares: tuple[Array, Array],
    noise: tuple[float, float, float],
    table: Array,
    prior: tuple[Array, Array],
    limits: tuple[int, float],
    state: tuple[Array, Array, Array, Array, Array],
) -> None:
    """Fit n patches, a row a patch: see `descend`.

    Args:
        p: (n, 10).
        pixels: (n, 4, p).
        scale: (n,).
        shares: (n,) and (n,), by which patches' read variance and gain are those of one channel.
        noise: read variance, gain and black of one channel.
        table: of the profiles.
        prior: (n, 10) and (n, 10), mean and inverse variance.
        limits: steps and settled.
        state: known, rows, information, gradient and chi², filled.
    """
    known, rows, information, gradient, chi2 = state
    own, held = np.empty(3), np.empty((2, PARAMETERS))
    for n in range(len(p)):
        own[0], own[1], own[2] = shares[0][n] * noise[0], shares[1][n] * noise[1], noise[2]
        held[0], held[1] = prior[0][n], prior[1][n]
        chi2[n] = descend(
            p[n], pixels[n], scale[n], own, table, held, limits[0], limits[1], known[n], rows[n],
            information[n], gradient[n],
        )  # fmt: skip


@compiled
def tally(pixels: Array, known: Array) -> Array:
    """Count what judges n spots by their own pixels, (n, 4).

    Pixels that clipping leaves alone; their squared residuals over the variance, summed; the
    same in DN²; and how many of all are at the sensor's limit.
    """
    told = np.zeros((len(pixels), 4))
    for n in range(len(pixels)):
        for k in range(pixels.shape[2]):
            if known[n, OWN, k] == 0.0:
                continue
            told[n, 3] += pixels[n, 0, k] >= SENSOR_LIMIT
            if known[n, VISIBLE, k] > SEEN:
                square = (pixels[n, 0, k] - known[n, MEAN, k]) ** 2
                told[n, 0] += 1.0
                told[n, 1] += square / known[n, VARIANCE, k]
                told[n, 2] += square
    return told
