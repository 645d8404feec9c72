"""Sum up the noise of an image over its pixels, and regress it on the signal.

Of five pixels a to e of a row a local cubic leaves the fourth difference a - 4 b + 6 c - 4 d + e,
whose variance is 70 times a pixel's; within classes of brightness its median bounds what belongs
to the background. On the spots, squared residuals follow

    E[r²] = dark + gain signal, weighed by 1 / (2 (dark + gain signal)²)

Every image passes through it: in numpy each function here takes several times as long.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array, Image

# what `stencils` gives of whole numbers from 0 to 255 is whole again, and can be counted
LEVEL_PARTS, LOWEST_LEVEL, N_LEVELS = 35, 6 * 255, 50 * 255 + 1  # a level in parts of one DN
N_DIFFERENCES = 8 * 255 + 1
BLOCK_PIXELS = 64  # pixels that are looked at together
MIN_PIXELS = 32.0  # pixels: of fewer, the fit's own parameters take more than a quarter


@compiled
def stencils(rows: Image, level: Array, difference: Array) -> int:
    """Level and fourth difference at every place where nothing is clipped.

    Args:
        rows: (r, w), DN.
        level: (r w,), filled from the begin: a local cubic's value, DN.
        difference: (r w,), likewise: size of the fourth difference, DN.

    Returns:
        How many places there are.
    """
    count, places = 0, rows.shape[1] - 4
    inside, clean = np.empty(rows.shape[1], np.bool_), np.empty(places, np.bool_)
    for r in range(rows.shape[0]):
        row = rows[r]
        for k in range(rows.shape[1]):
            inside[k] = (row[k] != 0) & (row[k] != 255)
        for k in range(places):
            clean[k] = inside[k] & inside[k + 1] & inside[k + 2] & inside[k + 3] & inside[k + 4]
        for begin in range(0, places, BLOCK_PIXELS):
            end, some = min(begin + BLOCK_PIXELS, places), False
            for k in range(begin, end):
                some = some | clean[k]
            if not some:  # as nearly everywhere in a dark picture
                continue
            for k in range(begin, end):
                if clean[k]:
                    a, b, c = float(row[k]), float(row[k + 1]), float(row[k + 2])
                    d, e = float(row[k + 3]), float(row[k + 4])
                    level[count] = (-3.0 * (a + e) + 12.0 * (b + d) + 17.0 * c) / 35.0
                    difference[count] = abs(a - 4.0 * b + 6.0 * c - 4.0 * d + e)
                    count += 1
    return count


@compiled
def counts_quantile(counts: NDArray[np.int64], number: int, share: float) -> tuple[int, int, float]:
    """Where a quantile of counted whole numbers lies: two of them, and how far in between.

    Args:
        counts: how often each number occurs, from 0 on.
        number: how many were counted, one at least.
        share: 0.5 is the median; interpolated as numpy does.
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
def level_quantile(level: Array, share: float) -> float:
    """A quantile of levels (k,), k > 0, as `stencils` gives them: whole thirty-fifths."""
    counts = np.zeros(N_LEVELS, np.int64)
    for value in level:
        counts[int(value * LEVEL_PARTS + LOWEST_LEVEL + 0.5)] += 1
    first, second, between = counts_quantile(counts, len(level), share)
    low = (first - LOWEST_LEVEL) / LEVEL_PARTS
    above = (second - LOWEST_LEVEL) / LEVEL_PARTS
    return float(low + (above - low) * between)


@compiled
def quietest_class(
    level: Array,
    difference: Array,
    black: float,
    classes: tuple[float, float, int],
    trim: tuple[float, float, float],
    gain: tuple[float, float, float],
) -> tuple[float, float, float]:
    """Find the class of brightness whose dark variance is least, its doubt included.

    Args:
        level: (k,), DN, as `stencils` gives them.
        difference: (k,), DN, likewise: whole numbers.
        black: DN.
        classes: where the first begins (DN), how wide each is (DN), fewest members.
        trim: MAD over sigma, sigma beyond which none counts, the share of variance within.
        gain: of the stencil's variance, DN a DN of signal, share of independent stencils.

    Returns:
        The least (inf where no class has members enough), its relative spread, its dark variance.
    """
    begin, width, fewest = classes
    mad, reach, within = trim
    stencil_gain, shot, effective = gain
    number = math.ceil((256.0 + width - begin) / width)
    best, spread, at = np.inf, 0.0, 0.0
    counts = np.empty((number, N_DIFFERENCES), np.int64)
    levels, members = np.zeros(number), np.zeros(number, np.int64)
    for k in range(len(level)):
        part = math.floor((level[k] - begin) / width)
        if 0 <= part < number:
            if members[part] == 0:  # few classes have any
                counts[part] = 0
            counts[part, int(difference[k])] += 1
            levels[part] += level[k]
            members[part] += 1
    for part in range(number - 1):
        if members[part] < fewest:
            continue
        first, second, between = counts_quantile(counts[part], members[part], 0.5)
        most = reach * max((first + (second - first) * between) / mad, 1.0)
        total, count = 0.0, 0
        for value in range(min(int(most) + 1, N_DIFFERENCES)):
            total += float(counts[part, value]) * value * value
            count += counts[part, value]
        variance = total / count / within / stencil_gain
        dark = variance - shot * (levels[part] / members[part] - black)
        relative = math.sqrt(2.0 / (effective * count))
        if dark + 2.0 * relative * variance < best:
            best, spread, at = dark + 2.0 * relative * variance, relative, dark
    return best, spread, at


@compiled
def gather_residuals(
    pixels: Array,
    known: Array,
    shares: tuple[Array, Array],
    rows: tuple[int, int, int, int, int],
    limits: tuple[float, float],
    own: Array,
    number: NDArray[np.int64],
    gathered: tuple[Array, Array, NDArray[np.int64]],
    at: int,
) -> int:
    """Squared residuals and signals of spots' unclipped pixels, for `refined`.

    Args:
        pixels: (n, 4, p), as fitted.
        known: (n, 10, p), of the pixels.
        shares: (n,) and (n,), read share and gain share of the patches.
        rows: of `known`: mean, signal, used, visible, core.
        limits: share of visible noise that a pixel must exceed; parameters that a fit takes.
        own: (n,), how many of each spot's own pixels clipping leaves alone; over `fitted` where
            asked for.
        number: (n,), of the spot among those asked for, -1 for the others.
        gathered: (k,) each: squares, DN²; signals, DN; the spot's number. Filled from `at` on.
        at: how many are gathered before.

    Returns:
        How many are gathered now.
    """
    mean, above, used, visible, mine = rows
    visible_share, fitted = limits
    square, signal, spot = gathered
    for n in range(len(pixels)):
        if number[n] < 0:
            continue
        paid = own[n] / (own[n] - fitted)  # what the fit's parameters took, they took from those
        for k in range(pixels.shape[2]):
            if known[n, used, k] > 0.0 and known[n, visible, k] > visible_share:
                off = pixels[n, 0, k] - known[n, mean, k]
                # combined colours have a noise of their own; brought back to that of one channel
                square[at] = off * off * (paid if known[n, mine, k] > 0.0 else 1.0) / shares[0][n]
                signal[at] = known[n, above, k] * shares[1][n] / shares[0][n]
                spot[at] = number[n]
                at += 1
    return at


@compiled
def least_misfit(misfit: Array, count: Array) -> float:
    """Least misfit of n spots, those of few pixels left out unless there is no other."""
    least, of_many = np.inf, np.inf
    for n in range(len(misfit)):
        least = min(least, misfit[n])
        of_many = min(of_many, misfit[n] if count[n] >= MIN_PIXELS else np.inf)
    return of_many if of_many < np.inf else least


@compiled
def variance_line(
    residual2: Array,
    signal: Array,
    spot: NDArray[np.int64],
    line: Array,
    usual: Array,
    limits: tuple[float, float, float, float],
) -> None:
    """Regress squared residuals on signal, misfitting spots left out; `line` is changed.

    Args:
        residual2: (k,), DN².
        signal: (k,), DN.
        spot: (k,), which spot each pixel belongs to, from 0 without gaps.
        line: (2,), dark variance and gain to begin with.
        usual: (2,), one over their standard uncertainties.
        limits: how much worse than the best a clean spot may be; least dark variance; least and
            largest gain.
    """
    clean, darkest, lowest, highest = limits
    first0, first1 = line[0], line[1]
    spots = 0
    for one in spot:
        spots = max(spots, one + 1)
    for _ in range(3):  # which spots are clean settles in two rounds
        misfit, count = np.zeros(spots), np.zeros(spots)
        for k in range(len(spot)):
            misfit[spot[k]] += residual2[k] / (line[0] + line[1] * signal[k])
            count[spot[k]] += 1.0
        for n in range(spots):
            misfit[n] /= count[n]
        most = clean * least_misfit(misfit, count)
        a, b, d = usual[0] ** 2, 0.0, usual[1] ** 2
        u, v = a * first0, d * first1
        for k in range(len(spot)):
            if misfit[spot[k]] > most:
                continue
            weight = 0.5 / (line[0] + line[1] * signal[k]) ** 2
            a += weight
            b += weight * signal[k]
            d += weight * signal[k] ** 2
            u += weight * residual2[k]
            v += weight * signal[k] * residual2[k]
        determinant = a * d - b * b
        line[0] = max((d * u - b * v) / determinant, darkest)
        line[1] = min(max((a * v - b * u) / determinant, lowest), highest)
