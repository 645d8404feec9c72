"""Estimate an image's noise from its background and from the residuals of its spots.

Model of a pixel's variance, s being the signal above black:

    var(s) = read² + gain s,   DN²

    symbol  meaning                                             unit
    read    standard deviation in the dark, with quantisation   DN
    gain    shot noise: variance a unit of signal               DN
    black   level at which the signal is zero                   DN

Of five pixels a to e of a row a local cubic leaves the fourth difference a - 4 b + 6 c - 4 d + e,
whose variance is 70 times a pixel's; within classes of brightness its median bounds what belongs
to the background, and the quietest class shows read. On the spots, squared residuals follow

    E[r²] = dark + gain signal, weighed by 1 / (2 (dark + gain signal)²)
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled, compiled_sums
from verify.core.records import Array, Image
from verify.measurement.detection.kernels.patches import Fits, Picture, rows_of
from verify.measurement.detection.kernels.pixels import (
    QUANTISATION,
    ROW_CORE,
    ROW_MEAN,
    ROW_SIGNAL,
    ROW_USED,
    ROW_VALUE,
    ROW_VISIBLE,
    Pixels,
)
from verify.measurement.detection.kernels.quality import (
    COL_COUNT,
    COL_ELONGATION,
    COL_PEAK,
    COL_SOUND,
    MIN_NOISE_SHARE,
    N_FITTED,
    first_by,
)

# levels are whole thirty-fifths, differences whole: both can be counted
LEVEL_PARTS, LOWEST_LEVEL, N_LEVELS = 35, 6 * 255, 50 * 255 + 1  # a level in parts of one DN
N_DIFFERENCES = 1024  # the last stands for larger ones too: of a texture, not of noise
BLOCK_PIXELS = 64  # pixels that are looked at together
MIN_PIXELS = 32.0  # pixels: of fewer, the fit's own parameters take more than a quarter
# Fourth difference along a line: cubic shading vanishes; white noise of variance v leaves 70 v. The
# level beside it is a local cubic's, which has no bias.
STENCIL_GAIN = 70.0
MAD_OVER_SIGMA = 0.67449  # median of |x| over sigma, Gaussian
TRIM_SIGMA = 3.0  # sigma; the variance within it is TRIMMED_VARIANCE of the whole
TRIMMED_VARIANCE = 0.9733
MIN_ABOVE_BLACK = 5.0  # DN above the limit of black: nearer, clipping narrows the noise
CLASS_WIDTH = 12.0  # DN, width of a level class
N_CLASSES = math.ceil((256.0 - MIN_ABOVE_BLACK) / CLASS_WIDTH)
FIRST_LEVEL = LOWEST_LEVEL + int(LEVEL_PARTS * MIN_ABOVE_BLACK)
CLASS_PARTS = int(LEVEL_PARTS * CLASS_WIDTH)
PER_CLASS = np.float32(1.0 / CLASS_PARTS * (1.0 + 1e-6))  # a whole number of parts stays whole
BLACK_SHARE = 0.01  # share of a picture that is no brighter than black
MIN_STENCILS = 60  # stencils a level class must hold: 15 % on its variance
INDEPENDENT_SHARE = 0.5  # share of independent information: neighbouring stencils overlap
TYPICAL_GAIN = 1 / 35  # DN, 9,000 electrons over 255 DN: a usual small pixel
MIN_GAIN = 1e-4  # DN, 2.5 million electrons: no sensor holds more
MAX_GAIN = 0.2  # DN, 1,300 electrons: above, it is the shape that does not fit
N_SAMPLE_ROWS = 24  # rows sampled
N_SAMPLE = 10_000  # pixels of them at least: read noise to 2 %, a fifth of TEXTURE_SHARE
TYPICAL_READ = 1.5  # DN, where no unclipped dark pixel shows it
TEXTURE_SHARE = 0.1  # relative: what unseen texture may add to the dark variance
TYPICAL_SPREAD = 1.0  # relative, how far a sensor may be from typical
MAX_NOISE_SPOTS = 8  # spots whose residuals show the noise, brightest first: then come glints
MAX_MISFIT_RATIO = 1.7  # times the best misfit: more is a shape that the profiles do not have

Counts = NDArray[np.int32]


@compiled
def count_stencils(rows: Image, apart: int, levels: Counts, differences: Counts) -> int:
    """Count levels and fourth differences of five neighbours in a row, wherever nothing is clipped.

    `rows` (r, w), DN, of which one block of BLOCK_PIXELS in each `apart` is looked at. Filled:
    `levels` (N_LEVELS,), of the local cubic's value, in parts; `differences` (N_CLASSES,
    N_DIFFERENCES), of their size, DN, by classes of brightness. Gives how many pixels were looked
    at.
    """
    looked, places = 0, rows.shape[1] - 4
    row = np.empty(BLOCK_PIXELS + 4, np.int32)
    level, difference = np.empty(BLOCK_PIXELS, np.int32), np.empty(BLOCK_PIXELS, np.int32)
    clean, part = np.empty(BLOCK_PIXELS, np.bool_), np.empty(BLOCK_PIXELS, np.int32)
    for r in range(rows.shape[0]):
        for begin in range(r % apart * BLOCK_PIXELS, places, apart * BLOCK_PIXELS):
            count = min(BLOCK_PIXELS, places - begin)
            looked += count
            for k in range(count + 4):
                row[k] = rows[r, begin + k]
            for k in range(count):
                a, b, c, d, e = row[k], row[k + 1], row[k + 2], row[k + 3], row[k + 4]
                clean[k] = (min(a, b, c, d, e) > 0) & (max(a, b, c, d, e) < 255)
            for k in range(count):
                ends, sides, middle = row[k] + row[k + 4], row[k + 1] + row[k + 3], row[k + 2]
                level[k] = LOWEST_LEVEL - 3 * ends + 12 * sides + 17 * middle
                difference[k] = min(abs(ends - 4 * sides + 6 * middle), N_DIFFERENCES - 1)
            for k in range(count):
                above = np.float32(level[k] - FIRST_LEVEL)
                part[k] = np.int32(above * PER_CLASS) if above >= 0 else -1
            for k in range(count):
                if clean[k]:
                    levels[level[k]] += 1
                    if 0 <= part[k] < N_CLASSES:
                        differences[part[k], difference[k]] += 1
    return looked


@compiled
def counts_quantile(counts: Counts, number: int, share: float) -> tuple[int, int, float]:
    """Where a quantile of counted whole numbers lies: two of them, and how far in between.

    `counts`: how often each occurs, from 0 on; `number` (one at least): in all. A `share` of 0.5 is
    the median; interpolated as numpy does.
    """
    place = share * (number - 1)
    low = int(place)
    high = min(low + 1, number - 1)
    until, first, second = 0, -1, -1
    for value in range(len(counts)):
        until += counts[value]
        if first < 0 and until > low:
            first = value
        if until > high:
            second = value
            break
    return first, second, place - low


@compiled
def dark_variance(rows: Image, apart: int, lossy: bool) -> tuple[float, float, float, float]:
    """Find the class of brightness whose dark variance is least, its uncertainty included.

    `rows` and `apart` as for `count_stencils`; of a `lossy` image only black is found. Gives what
    share of the pixels is not clipped; the black level, DN, 0 where that is less than half; the
    dark variance, DN², nan where no class has members enough; its relative spread.
    """
    levels = np.zeros(N_LEVELS, np.int32)
    differences = np.zeros((N_CLASSES, N_DIFFERENCES), np.int32)
    looked, clean = count_stencils(rows, apart, levels, differences), levels.sum()
    black, best, spread, at = 0.0, np.inf, 0.0, np.nan
    if 2 * clean > looked:
        low, high, between = counts_quantile(levels, clean, BLACK_SHARE)
        black = (low + (high - low) * between - LOWEST_LEVEL) / LEVEL_PARTS
    for part in range(0 if lossy else N_CLASSES):
        members, total, first = 0, 0, FIRST_LEVEL + part * CLASS_PARTS
        for level in range(first, min(first + CLASS_PARTS, N_LEVELS)):
            members += levels[level]
            total += levels[level] * (level - LOWEST_LEVEL)
        if members < MIN_STENCILS:
            continue
        low, high, between = counts_quantile(differences[part], members, 0.5)
        most = TRIM_SIGMA * max((low + (high - low) * between) / MAD_OVER_SIGMA, 1.0)
        squares, count = 0.0, 0
        for size in range(min(int(most) + 1, N_DIFFERENCES)):
            squares += float(differences[part, size]) * size * size
            count += differences[part, size]
        variance = squares / count / TRIMMED_VARIANCE / STENCIL_GAIN
        dark = variance - TYPICAL_GAIN * (total / members / LEVEL_PARTS - black)
        relative = math.sqrt(2.0 / (INDEPENDENT_SHARE * count))
        if dark + 2.0 * relative * variance < best:
            best, spread, at = dark + 2.0 * relative * variance, relative, dark
    return clean / max(looked, 1), black, at, spread


@compiled
def background_noise(picture: Picture, lossy: bool, noise: Array) -> None:
    """Fill in the noise (4,) of the quietest part of an image.

    Read variance, DN²; gain, DN, a usual one; black, DN; the relative uncertainty of the first. Of
    BGR the green channel stands for all. Texture only ever adds to differences, so the quietest
    class of brightness is believed; of a JPEG, which smooths what is dark, none.
    """
    shape = picture.height, picture.width, picture.channels
    apart = max(picture.height // N_SAMPLE_ROWS, 1)
    rows = picture.values.reshape(shape)[::apart, :, picture.channels // 2]
    unclipped, black, dark, spread = dark_variance(rows, max(rows.size // N_SAMPLE, 1), lossy)
    # nothing unclipped, or what is not black here may be all texture
    hidden = not math.isfinite(dark) or (unclipped <= 0.5 and dark > TYPICAL_READ**2)
    noise[0] = TYPICAL_READ**2 if lossy or hidden else max(dark, QUANTISATION)
    noise[1] = TYPICAL_GAIN
    noise[2] = 0.0 if hidden and not lossy else black
    noise[3] = TYPICAL_SPREAD if lossy or hidden else spread + TEXTURE_SHARE


@compiled
def refine_noise(fits: Fits, assessed: Array, noise: Array, spread: float) -> None:
    """Let noise (3,) also explain the residuals of clean spots: bright pixels show the gain.

    `noise`: read variance, gain, black, of the background; `assessed` (n, 16), of the fits;
    `spread`, the relative standard uncertainty of the dark variance. Variance line by weighted
    regression of residual² on signal; misfitting spots left out.
    """
    shows, rank = np.empty(len(assessed), np.int64), np.empty(len(assessed))
    count = 0
    for n in range(len(assessed)):
        rank[n] = -assessed[n, COL_PEAK] / assessed[n, COL_ELONGATION]
        if assessed[n, COL_SOUND] > 0.0 and assessed[n, COL_COUNT] > 2 * N_FITTED:
            shows[count] = n
            count += 1
    brightest = shows[: first_by(rank, shows[:count], MAX_NOISE_SPOTS)]
    if len(brightest) == 0:
        return
    square, signal = np.empty(fits.begin[-1]), np.empty(fits.begin[-1])
    begin = np.zeros(len(brightest) + 1, np.int64)
    for m in range(len(brightest)):
        n, own = brightest[m], assessed[brightest[m], COL_COUNT]
        to = square[begin[m] :], signal[begin[m] :]
        begin[m + 1] = begin[m] + gather_residuals(rows_of(fits, n), fits.share[n], own, to)
    line, usual = np.empty(2), np.empty(2)
    line[0], line[1] = noise[0], TYPICAL_GAIN
    usual[0], usual[1] = 1.0 / (spread * noise[0]), 1.0 / (TYPICAL_SPREAD * TYPICAL_GAIN)
    variance_line(square, signal, begin, line, usual)
    noise[0], noise[1] = line[0], line[1]


@compiled
def gather_residuals(rows: Pixels, share: Array, own: float, to: tuple[Array, Array]) -> int:
    """Gather squared residuals, DN², and signals, DN above black, of a spot's unclipped pixels.

    `rows` (25, p) of the spot; `share` (2,), of the read variance and the gain; `own`, how many of
    its own pixels clipping leaves alone, more than N_FITTED; `to`, both (k,), filled from the first
    on. Gives how many are filled in.
    """
    (square, signal), count = to, 0
    paid = own / (own - N_FITTED)  # the fit's parameters took from those pixels
    for k in range(rows.shape[1]):
        if rows[ROW_USED, k] > 0.0 and rows[ROW_VISIBLE, k] > MIN_NOISE_SHARE:
            off = rows[ROW_VALUE, k] - rows[ROW_MEAN, k]
            # combined colours have a noise of their own; brought back to that of one channel
            enlarged = off * off * (paid if rows[ROW_CORE, k] > 0.0 else 1.0)
            square[count] = enlarged / share[0]
            signal[count] = rows[ROW_SIGNAL, k] * share[1] / share[0]
            count += 1
    return count


@compiled
def least_misfit(misfit: Array, begin: NDArray[np.int64]) -> float:
    """Least misfit of n spots, those of few pixels left out unless there is no other."""
    least, of_many = np.inf, np.inf
    for n in range(len(misfit)):
        least = min(least, misfit[n])
        many = begin[n + 1] - begin[n] >= MIN_PIXELS
        of_many = min(of_many, misfit[n] if many else np.inf)
    return of_many if of_many < np.inf else least


@compiled_sums
def variance_line(
    residual2: Array, signal: Array, begin: NDArray[np.int64], line: Array, usual: Array
) -> None:
    """Regress squared residuals (k,), DN², on signal (k,), DN, misfitting spots left out.

    `begin` (n + 1,): where each spot's pixels begin; `line` (2,), changed: dark variance and gain,
    the start; `usual` (2,): one over their standard uncertainties.
    """
    first0, first1, misfit = line[0], line[1], np.empty(len(begin) - 1)
    for _ in range(3):  # which spots are clean settles in two rounds
        dark, gain = line[0], line[1]
        for n in range(len(misfit)):
            total = 0.0
            for k in range(begin[n], begin[n + 1]):
                total += residual2[k] / (dark + gain * signal[k])
            misfit[n] = total / (begin[n + 1] - begin[n])
        most = MAX_MISFIT_RATIO * least_misfit(misfit, begin)
        a, b, d = usual[0] ** 2, 0.0, usual[1] ** 2
        u, v = a * first0, d * first1
        for n in range(len(misfit)):
            if misfit[n] > most:
                continue
            for k in range(begin[n], begin[n + 1]):
                weight = 1.0 / (dark + gain * signal[k])
                weight *= 0.5 * weight
                tilted = weight * signal[k]
                a += weight
                b += tilted
                d += tilted * signal[k]
                u += weight * residual2[k]
                v += tilted * residual2[k]
        determinant = a * d - b * b
        line[0] = max((d * u - b * v) / determinant, QUANTISATION)
        line[1] = min(max((a * v - b * u) / determinant, MIN_GAIN), MAX_GAIN)
