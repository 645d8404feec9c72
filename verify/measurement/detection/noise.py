"""Estimate an image's noise from its background and from the residuals of its spots.

Model of a pixel's variance, s being the signal above black:

    var(s) = read² + gain s,   DN²

    symbol  meaning                                             unit
    read    standard deviation in the dark, with quantisation   DN
    gain    shot noise: variance a unit of signal               DN
    black   level at which the signal is zero                   DN

`background_noise` takes read from the fourth differences along rows (variance 70 var for white
noise) in the quietest class of brightness, `refine_noise` fits the line to the spots' residuals.
"""

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Image, Noise
from verify.measurement.detection.kernels import noise as kernels_noise

# Fourth difference along a line: cubic shading vanishes; white noise of variance v leaves 70 v. The
# level beside it is a local cubic's, which has no bias.
STENCIL_GAIN, STENCIL_WIDTH = 70.0, 5
MAD_OVER_SIGMA = 0.67449  # median of |x| over sigma, Gaussian
TRIM_SIGMA = 3.0  # sigma; the variance within it is TRIMMED_VARIANCE of the whole
TRIMMED_VARIANCE = 0.9733
QUANTISATION = 1 / 12  # DN², the least variance that whole numbers have
N_SAMPLE_ROWS = 24  # rows sampled: some 30,000 stencils, read noise to about 1 %
MIN_ABOVE_BLACK = 5.0  # DN above the limit of black: nearer, clipping narrows the noise
CLASS_WIDTH = 12.0  # DN, width of a level class
MIN_STENCILS = 60  # stencils a level class must hold: 15 % on its variance
INDEPENDENT_SHARE = 0.5  # share of independent information: neighbouring stencils overlap
TYPICAL_READ = 1.5  # DN, where no unclipped dark pixel shows it
TYPICAL_GAIN = 1 / 35  # DN, 9,000 electrons over 255 DN: a usual small pixel
MIN_GAIN = 1e-4  # DN, 2.5 million electrons: no sensor holds more
MAX_GAIN = 0.2  # DN, 1,300 electrons: above, it is the shape that does not fit
TYPICAL_SPREAD = 1.0  # relative, how far a sensor may be from typical
TEXTURE_SHARE = 0.1  # relative: what unseen texture may add to the dark variance
MAX_SPOTS = 8  # spots, brightest first, that may speak on noise: behind them come glints and paint
MAX_MISFIT_RATIO = 1.7  # times the best misfit: more is a shape that the profiles do not have


def background_noise(image: Image) -> tuple[Noise, float]:
    """Noise of the quietest part of an image, with a usual shot-noise gain.

    Texture only ever adds to differences, so the quietest class of brightness is believed.

    Args:
        image: (h, w) grey or (h, w, 3) BGR; of a colour image the green channel stands for all.

    Returns:
        The noise, and the relative standard uncertainty of its dark variance.
    """
    grey = image if image.ndim == 2 else image[..., 1]
    rows = np.ascontiguousarray(grey[:: max(len(grey) // N_SAMPLE_ROWS, 1)])
    typical = Noise(TYPICAL_READ, TYPICAL_GAIN, 0.0)
    if rows.shape[1] < STENCIL_WIDTH:
        return typical, TYPICAL_SPREAD
    level, difference = np.empty(rows.size), np.empty(rows.size)
    count = kernels_noise.stencils(rows, level, difference)
    level, difference = level[:count], difference[:count]
    black = kernels_noise.level_quantile(level, 0.01) if count > rows.size // 2 else 0.0
    best, spread, at = kernels_noise.quietest_class(
        level, difference, black, (MIN_ABOVE_BLACK, CLASS_WIDTH, MIN_STENCILS),
        (MAD_OVER_SIGMA, TRIM_SIGMA, TRIMMED_VARIANCE),
        (STENCIL_GAIN, TYPICAL_GAIN, INDEPENDENT_SHARE),
    )  # fmt: skip
    if not np.isfinite(best) or (count < rows.size // 2 and at > TYPICAL_READ**2):
        # nothing unclipped, or what is not black here may be all texture
        return typical, TYPICAL_SPREAD
    return Noise(float(np.sqrt(max(at, QUANTISATION))), TYPICAL_GAIN, black), spread + TEXTURE_SHARE


def refine_noise(
    noise: Noise, dark_spread: float, residual2: Array, signal: Array, spot: NDArray[np.intp]
) -> Noise:
    """Noise that also explains the residuals of clean spots: bright pixels show the gain.

    Args:
        noise: what the background says.
        dark_spread: relative standard uncertainty of its dark variance.
        residual2: (k,), DN², squared residuals of the profile fits at unclipped pixels of spots
            and around them, enlarged by what the fits' own parameters took.
        signal: (k,), fitted DN above black.
        spot: (k,), which spot each pixel belongs to, from 0 without gaps.

    Returns:
        Variance line by weighted regression of residual² on signal; misfitting spots left out.
    """
    if not len(spot):
        return noise
    dark = noise.read**2
    usual = np.array([1 / (dark_spread * dark), 1 / (TYPICAL_SPREAD * TYPICAL_GAIN)])
    line = np.array([dark, TYPICAL_GAIN])
    limits = (MAX_MISFIT_RATIO, QUANTISATION, MIN_GAIN, MAX_GAIN)
    kernels_noise.variance_line(residual2, signal, spot, line, usual, limits)
    return Noise(float(np.sqrt(line[0])), float(line[1]), noise.black)
