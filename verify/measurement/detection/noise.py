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
from verify.measurement.detection.kernels import noise as kernel
from verify.measurement.detection.kernels.noise import TYPICAL_GAIN
from verify.measurement.detection.kernels.pixels import QUANTISATION

N_SAMPLE_ROWS = 24  # rows sampled
N_SAMPLE = 10_000  # pixels of them at least: read noise to 2 %, a fifth of TEXTURE_SHARE
TYPICAL_READ = 1.5  # DN, where no unclipped dark pixel shows it
TYPICAL_SPREAD = 1.0  # relative, how far a sensor may be from typical
TEXTURE_SHARE = 0.1  # relative: what unseen texture may add to the dark variance


def background_noise(image: Image, *, lossy: bool = False) -> tuple[Noise, float]:
    """Noise of the quietest part of an image, with the relative uncertainty of its dark variance.

    The image is (h, w) grey or (h, w, 3) BGR, where the green channel stands for all. The
    shot-noise gain is a usual one. Texture only ever adds to differences, so the quietest class of
    brightness is believed; of a JPEG, which smooths what is dark, none.
    """
    grey = image if image.ndim == 2 else image[..., 1]
    rows = np.ascontiguousarray(grey[:: max(len(grey) // N_SAMPLE_ROWS, 1)])
    unclipped, black, dark, spread = kernel.dark_variance(rows, max(rows.size // N_SAMPLE, 1))
    if lossy:
        return Noise(TYPICAL_READ, TYPICAL_GAIN, black), TYPICAL_SPREAD
    if not np.isfinite(dark) or (unclipped <= 0.5 and dark > TYPICAL_READ**2):
        # nothing unclipped, or what is not black here may be all texture
        return Noise(TYPICAL_READ, TYPICAL_GAIN, 0.0), TYPICAL_SPREAD
    read = float(np.sqrt(max(dark, QUANTISATION)))
    return Noise(read, TYPICAL_GAIN, black), spread + TEXTURE_SHARE


def refine_noise(
    noise: Noise, dark_spread: float, residual2: Array, signal: Array, spot: NDArray[np.intp]
) -> Noise:
    """Noise that also explains the residuals of clean spots: bright pixels show the gain.

    `noise` is that of the background, `dark_spread` the relative standard uncertainty of its dark
    variance. `residual2` (k,), DN²: squared residuals of the profile fits at unclipped pixels of
    spots and around them, enlarged by what the fits' own parameters took; `signal` (k,), fitted DN
    above black; `spot` (k,), which spot each pixel belongs to, from 0 without gaps. Variance line
    by weighted regression of residual² on signal; misfitting spots left out.
    """
    if not len(spot):
        return noise
    dark = noise.read**2
    usual = np.array([1 / (dark_spread * dark), 1 / (TYPICAL_SPREAD * TYPICAL_GAIN)])
    line = np.array([dark, TYPICAL_GAIN])
    kernel.variance_line(residual2, signal, spot, line, usual)
    return Noise(float(np.sqrt(line[0])), float(line[1]), noise.black)
