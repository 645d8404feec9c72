"""The family of radial profiles an LED's image may have: Moffat, Gaussian, blurred disc.

A profile is f(t; steepness), t the radius in half-widths: f(0) = 1, f(1) = 1/2. Its steepness is
-d ln f / d ln t at half height: 2 ln 2 for a Gaussian, more for a disc blurred by a Gaussian (a
uniform emissive sphere through a lens), less for a Moffat profile (a Gaussian with a halo). Both
sides leave the Gaussian along the same direction, f (t⁴ - t²), so the family is smooth.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr, chndtrinc, lambertw

from verify.core.records import Array

GAUSSIAN_STEEPNESS = 2 * np.log(2)
# halo of exponent 1.2 … a 40 px disc blurred by 0.5 px
MIN_LOG_STEEPNESS, MAX_LOG_STEEPNESS = np.log(1.05), np.log(32.0)
N_STEEPNESS_ROWS = 56  # 0.06 in ln steepness a row: linear blending errs by under 5e-4 of the peak
RADIUS_STEP = 1 / 128  # half-widths between samples: a first-order step errs by under 1e-3
MAX_RADIUS = 8.0  # half-widths; beyond it the last sample stands


@cache
def profile_table() -> NDArray[np.float32]:
    """Tabulate the family once, (rows, samples, 4), a row a steepness, a sample a radius.

    The four are f, its step to the next row (the last one has none), df / d(t²), and its step.
    """
    log_steepness = np.linspace(MIN_LOG_STEEPNESS, MAX_LOG_STEEPNESS, N_STEEPNESS_ROWS)
    t = np.arange(0, MAX_RADIUS + RADIUS_STEP / 2, RADIUS_STEP)
    ratios = np.geomspace(0.3, 60.0, 120)  # disc radius over blur
    steepness = np.array([blurred_disc_half_width(ratio)[1] for ratio in ratios])
    value = np.empty((N_STEEPNESS_ROWS, len(t)))
    slope = np.empty_like(value)
    for row, target in enumerate(np.exp(log_steepness)):
        if target <= steepness[0]:
            value[row] = moffat(t, min(target, GAUSSIAN_STEEPNESS - 1e-6))
        else:
            ratio = float(np.exp(np.interp(target, steepness, np.log(ratios))))
            value[row] = blurred_disc(t * blurred_disc_half_width(ratio)[0], ratio)
        slope[row, 1:] = np.gradient(value[row], RADIUS_STEP)[1:] / (2 * t[1:])
        slope[row, 0] = (value[row, 1] - value[row, 0]) / RADIUS_STEP**2
    value_step, slope_step = (np.diff(table, axis=0, append=table[-1:]) for table in (value, slope))
    return np.stack([value, value_step, slope, slope_step], axis=-1).astype(np.float32)


def blurred_disc(r: Array, ratio: float) -> Array:
    """Uniform disc of radius `ratio` convolved with a unit Gaussian, at radius r, 1 at the centre.

    The convolution is the probability that a point drawn from a Gaussian around r falls into the
    disc: a non-central chi² distribution with two degrees of freedom (Marcum's Q function).
    """
    value: Array = chndtr(ratio**2, 2.0, np.asarray(r) ** 2) / -np.expm1(-(ratio**2) / 2)
    return value


def blurred_disc_half_width(ratio: float) -> tuple[float, float]:
    """Radius at half height, in blurs, and the steepness there."""
    half = float(np.sqrt(chndtrinc(ratio**2, 2.0, -np.expm1(-(ratio**2) / 2) / 2)))
    h = 1e-4 * half
    below, above = blurred_disc(np.array([half - h, half + h]), ratio)
    return half, float(-(np.log(above) - np.log(below)) / (2 * h) * half)


def moffat(t: Array, steepness: float) -> Array:
    """Moffat's profile of half width 1 with a given steepness below the Gaussian's.

    Of an exponent b it is 2 b (1 - exp(-x)), x = ln 2 / b: Lambert's function tells x.
    """
    share = GAUSSIAN_STEEPNESS / steepness
    x = share + float(lambertw(-share * np.exp(-share)).real)
    value: Array = (1 + np.expm1(x) * t**2) ** (-np.log(2) / x)
    return value
