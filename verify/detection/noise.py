"""The noise of an image, read from the image itself: its dark parts, then its spots' residuals."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from verify.records import Array, Image, Noise

# Fourth difference along a line: cubic shading vanishes; white noise of variance v leaves 70 v.
STENCIL = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
STENCIL_GAIN = float(STENCIL @ STENCIL)
LEVEL = np.array([-3.0, 12.0, 17.0, 12.0, -3.0]) / 35  # local cubic fit: the level without bias
MAD = 0.67449  # median of |x| over sigma, Gaussian
TRIM = 3.0  # sigma; the variance within it is TRIMMED of the whole
TRIMMED = 0.9733
QUANTISATION = 1 / 12  # DN², the least variance that whole numbers have
ROWS = 24  # rows sampled: some 30,000 stencils, read noise to about 1 %
CLEAR = 5.0  # DN above the limit of black: nearer, clipping narrows the noise
CLASS = 12.0  # DN, width of a level class
FEWEST = 60  # stencils a level class must hold: 15 % on its variance
EFFECTIVE = 0.5  # share of independent information: neighbouring stencils overlap
TYPICAL_READ = 1.5  # DN, where no unclipped dark pixel shows it
TYPICAL_GAIN = 1 / 35  # DN, 9,000 electrons over 255 DN: a usual small pixel
LOWEST_GAIN = 1e-4  # DN, 2.5 million electrons: no sensor holds more
HIGHEST_GAIN = 0.2  # DN, 1,300 electrons: above, it is the shape that does not fit
TYPICAL_SPREAD = 1.0  # relative, how far a sensor may be from typical
TEXTURE = 0.1  # relative: what unseen texture may add to the dark variance
LIKELY = 8  # spots, brightest first, that may speak on noise: behind them come glints and paint
CLEAN = 1.7  # times the best of their misfits: more is a shape that the profiles do not have


def background_noise(image: Image) -> tuple[Noise, float]:
    """Noise of the quietest part of an image, with a usual shot-noise gain.

    Texture only ever adds to differences, so the quietest class of brightness is believed.

    Args:
        image: (h, w) grey or (h, w, 3) BGR; of a colour image the green channel stands for all.

    Returns:
        The noise, and the relative standard uncertainty of its dark variance.
    """
    grey = image if image.ndim == 2 else image[..., 1]
    rows = grey[:: max(len(grey) // ROWS, 1)]
    typical = Noise(TYPICAL_READ, TYPICAL_GAIN, 0.0)
    if rows.shape[1] < len(STENCIL):
        return typical, TYPICAL_SPREAD
    row, column = np.nonzero((rows[:, 2:-2] > 0) & (rows[:, 2:-2] < 255))
    values = np.array([rows[row, column + k] for k in range(len(STENCIL))])
    values = values[:, (values.min(axis=0) > 0) & (values.max(axis=0) < 255)].astype(float)
    level, difference = LEVEL @ values, np.abs(STENCIL @ values)
    black = float(np.percentile(level, 1)) if values.shape[1] > rows.size // 2 else 0.0
    best, spread, at = np.inf, TYPICAL_SPREAD, 0.0
    order = np.argsort(level)
    bounds = np.searchsorted(level[order], np.arange(CLEAR, 256.0 + CLASS, CLASS))
    for part in (order[a:b] for a, b in pairwise(bounds) if b - a >= FEWEST):
        size = difference[part]
        inner = size[size <= TRIM * max(np.median(size) / MAD, 1.0)]
        variance = float(inner @ inner) / len(inner) / TRIMMED / STENCIL_GAIN
        dark = variance - TYPICAL_GAIN * float(level[part].mean() - black)
        relative = float(np.sqrt(2 / (EFFECTIVE * len(inner))))
        if dark + 2 * relative * variance < best:
            best, spread, at = dark + 2 * relative * variance, relative, dark
    if values.shape[1] < rows.size // 2 and at > TYPICAL_READ**2:
        # What is not black here may be all texture.
        return typical, TYPICAL_SPREAD
    if not np.isfinite(best):
        return typical, TYPICAL_SPREAD
    return Noise(float(np.sqrt(max(at, QUANTISATION))), TYPICAL_GAIN, black), spread + TEXTURE


def refined(
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
    count = np.bincount(spot)
    dark = noise.read**2
    usual = np.array([1 / (dark_spread * dark), 1 / (TYPICAL_SPREAD * TYPICAL_GAIN)])
    line = np.array([dark, TYPICAL_GAIN])
    for _ in range(3):  # which spots are clean settles in two rounds
        variance = line[0] + line[1] * signal
        misfit = np.bincount(spot, residual2 / variance) / count
        clean = misfit <= CLEAN * misfit.min()
        use = clean[spot]
        weight = 1 / (np.sqrt(2) * variance[use])
        rows = np.column_stack([weight, weight * signal[use]])
        line = np.linalg.solve(
            np.diag(usual**2) + rows.T @ rows,
            usual**2 * [dark, TYPICAL_GAIN] + rows.T @ (weight * residual2[use]),
        )
        line = np.clip(line, [QUANTISATION, LOWEST_GAIN], [np.inf, HIGHEST_GAIN])
    return Noise(float(np.sqrt(line[0])), float(line[1]), noise.black)
