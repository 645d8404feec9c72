"""Correct spots for the room that a bright camera shows behind them, and widen them by the rest.

Model: to a spot's plane, polynomials of second and third order are added,

    background = plane + c · b(u, w),   b = (u², u w, w², u³, u² w, u w², w³),   c ~ N(0, s²)

with (u, w) the pixel's place from the spot's centre over the patch's radius. With D the derivatives
by the spot's parameters, r the residuals and B those by c, all over the pixels' sigmas, A the
information on the parameters,

    S = B'B - B'D A⁻¹ D'B,   h = B'r - B'D A⁻¹ D'r,   c = (S + s⁻²)⁻¹ h,   centre += pull c

    symbol  meaning                                                                 unit
    s       curvature of the room over a patch, one for all spots of a picture      DN
    S, h    information and gradient of c, the spot's parameters following          DN^-2, DN^-1
    pull    -A⁻¹ D'B, the rows of x and y                                           px/DN

s is averaged over AMPLITUDES by their evidence, the sum of (h c - ln |1 + s² S|) / 2. What is finer
than that is measured: the correction and the fit together are linear in the pixels, so the same
weights on N_AROUND patches of the room beside each spot show how far it would move a centre. Their
median square over what noise and curvature explain, of all spots of a picture, adds the excess; a
spot's own mean square does where it is MAX_OWN times that.
Where the room is below black there is nothing of it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import factor, median, solve_each
from verify.core.records import Array
from verify.measurement.detection.kernels.fit import MIN_INFORMATION, multiply_rows
from verify.measurement.detection.kernels.patches import (
    PATCH_REACH,
    Fits,
    Index,
    Picture,
    channel_weights,
    rows_of,
)
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    NEIGHBOUR_RADIUS,
    ONE,
    PAR_FLOOR,
    PAR_PEAK,
    PAR_X,
    PAR_Y,
    ROW_COLUMN,
    ROW_RADIUS2,
    ROW_RESIDUAL,
    ROW_ROW,
    ROW_USED,
    ROW_VARIANCE,
    ROW_VISIBLE,
    SENSOR_LIMIT,
    ZERO,
    Pixels,
    Real,
)
from verify.measurement.detection.kernels.quality import COL_MERGED

Flags = NDArray[np.bool_]
N_TERMS = 7
N_RIGHT = N_TERMS + 1  # residuals and terms; a multiple of four
MIN_VISIBLE = Real(0.5)  # share of the noise about a spot that clipping must leave: above black
AMPLITUDES: Array = 0.1 * np.exp2(np.arange(9))  # DN, beside none at all
N_AMPLITUDES = len(AMPLITUDES)
N_AROUND = 8  # patches of the room about each spot, two radii away
_ANGLES = 2 * np.pi / N_AROUND * np.arange(N_AROUND)
DIRECTIONS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
MIN_AROUND = 12  # responses, two a patch, of all spots of a picture: fewer show nothing
MIN_TEXTURE = 6.0  # of that median over what is explained, where dim lights are in the patches
MAX_DIM = 0.5  # of a spot's peak: a light that is less may be texture of the room
MAX_OWN = 3.0  # of the picture's: a spot's own surroundings move it more than chance
MEDIAN_CHI2 = 0.4549  # of chi² with one degree of freedom


@compiled_sums
def surroundings_noise(rows: Pixels) -> float:
    """Mean variance, DN², of a spot's pixels that show the room alone; 0 if it is below black."""
    visible, variance, count = ZERO, ZERO, ZERO
    for k in range(rows.shape[1]):
        used = rows[ROW_USED, k] > ZERO
        room = rows[ROW_RADIUS2, k] > NEIGHBOUR_RADIUS * NEIGHBOUR_RADIUS
        one = ONE if used & room else ZERO
        visible += one * rows[ROW_VISIBLE, k]
        variance += one * rows[ROW_VARIANCE, k]
        count += one
    return float(variance / count) if visible > MIN_VISIBLE * max(count, ONE) else 0.0


@compiled
def right_of(pool: Pixels, fits: Fits, n: int) -> Pixels:
    """Part of a pool (8 p,) of all spots' pixels that is one spot's, (8, p)."""
    begin, end = fits.begin[n], fits.begin[n + 1]
    return pool[N_RIGHT * begin : N_RIGHT * end].reshape((N_RIGHT, end - begin))


@compiled
def fill_right(p: Array, rows: Pixels, right: Pixels) -> None:
    """Fill in `right` (8, p): a spot's residuals, and the derivatives by the curvature's terms.

    `p` (10,): the spot's parameters.
    """
    scale = ONE / -rows[ROW_ROW, 0]  # the topmost pixel comes first
    x, y = Real(p[PAR_X]), Real(p[PAR_Y])
    for k in range(rows.shape[1]):
        u, w = (rows[ROW_COLUMN, k] - x) * scale, (rows[ROW_ROW, k] - y) * scale
        right[6, k], right[7, k] = u, w
    for k in range(rows.shape[1]):
        right[0, k] = rows[ROW_RESIDUAL, k]
    for k in range(rows.shape[1]):
        right[1, k] = rows[PAR_FLOOR, k] * right[6, k] * right[6, k]
        right[2, k] = rows[PAR_FLOOR, k] * right[6, k] * right[7, k]
    for k in range(rows.shape[1]):
        right[3, k] = rows[PAR_FLOOR, k] * right[7, k] * right[7, k]
    for k in range(rows.shape[1]):
        right[4, k], right[5, k] = right[1, k] * right[6, k], right[1, k] * right[7, k]
    for k in range(rows.shape[1]):
        right[6, k], right[7, k] = right[3, k] * right[6, k], right[3, k] * right[7, k]


@compiled
def sum_curvature(
    fits: Fits, n: int, right: Pixels, follow: Array, solved: Array, evidence: Array
) -> bool:
    """Sum up what a spot shows of the room, and how likely curvature makes it.

    `right` (8, p), as by `fill_right`. Filled: `follow` (10, 10): how the parameters follow r and
    B, and the columns of x and y of A⁻¹; `solved` (9, 8, 3): (S + s⁻²)⁻¹ times h and the pull, from
    the second row on. `evidence` (9,): log-likelihood ratio of curvature of each amplitude to none,
    added to. False, and nothing added, where rounding leaves no S.
    """
    rows, left = rows_of(fits, n), np.empty((N_RIGHT, N_RIGHT))
    root, products = np.empty((N_PARAMETERS, N_PARAMETERS)), np.empty((N_PARAMETERS, N_RIGHT))
    if fits.saturated[n]:  # as in `normal_equations`
        multiply_rows(rows[:N_PARAMETERS], right, products, np.float64)
        multiply_rows(right, right, left, np.float64)
    else:
        multiply_rows(rows[:N_PARAMETERS], right, products, Real)
        multiply_rows(right, right, left, Real)
    factor(fits.information[n], -MIN_INFORMATION, root)
    for a in range(N_PARAMETERS):
        for b in range(N_RIGHT):
            follow[a, b] = products[a, b]
        for b in range(2):
            follow[a, N_RIGHT + b] = 1.0 if a == b else 0.0
    solve_each(root, follow)
    for a in range(N_PARAMETERS):
        for b in range(N_RIGHT):
            for c in range(N_RIGHT):
                left[b, c] -= products[a, b] * follow[a, c]
    return solve_amplitudes(left, follow, solved, evidence)


@compiled
def solve_amplitudes(left: Array, follow: Array, solved: Array, evidence: Array) -> bool:
    """Fill in what a spot's curvature is at each amplitude, and add to their evidence.

    `left` (8, 8), r and B with themselves, the spot's parameters following: h and S are in it;
    others as `sum_curvature` gives them. False, and nothing added, where rounding leaves no S: of a
    spot far over the limit, which hardly determines its own parameters.
    """
    root = np.empty((N_TERMS, N_TERMS))
    for k in range(N_AMPLITUDES - 1, -1, -1):  # the largest has the least prior
        if not factor(left[1:, 1:], -1.0 / AMPLITUDES[k] ** 2, root):
            return False
        for c in range(1, N_RIGHT):
            solved[k, c, 0] = left[c, 0]
            solved[k, c, 1], solved[k, c, 2] = -follow[PAR_X, c], -follow[PAR_Y, c]
        solve_each(root, solved[k, 1:])
        volume = 1.0
        for c in range(N_TERMS):
            evidence[k] += 0.5 * solved[k, 1 + c, 0] * left[1 + c, 0]
            volume *= AMPLITUDES[k] * root[c, c]
        evidence[k] -= math.log(volume)
    return True


@compiled_sums
def add_rows(factors: Array, rows: Pixels, total: Array) -> None:
    """Add rows (m, p), each times its two factors (m, 2), to both of `total` (2, p); m is even.

    In double precision: of a spot far over the limit they nearly cancel.
    """
    for i in range(2):
        for a in range(0, len(factors), 2):
            one, other = factors[a, i], factors[a + 1, i]
            for k in range(rows.shape[1]):
                total[i, k] += one * rows[a, k] + other * rows[a + 1, k]


@compiled_sums
def weigh_rows(rows: Pixels, weight: Array, added: Array) -> Array:
    """Add to `weight` (2, p), both over the pixels' sigmas; give its sums of squares before, (2,).

    Less its mean, as the level of the room moves nothing.
    """
    squares, scale = np.zeros(2), np.empty(rows.shape[1])
    for k in range(len(scale)):
        scale[k] = math.sqrt(rows[ROW_USED, k] / rows[ROW_VARIANCE, k])
    for i in range(2):
        square, total = 0.0, 0.0
        for k in range(len(scale)):
            one = weight[i, k] * scale[k]
            square += one * one
            one += added[i, k] * scale[k]
            weight[i, k] = one
            total += one
        squares[i] = square
        for k in range(len(scale)):
            weight[i, k] -= total / len(scale)
    return squares


@compiled_sums
def weigh_room(room: Pixels, weight: Array) -> tuple[float, float]:
    """Sums of p pixels (p,), DN, with each of two weights (2, p)."""
    first, second = 0.0, 0.0
    for k in range(len(room)):
        first += room[k] * weight[0, k]
        second += room[k] * weight[1, k]
    return first, second


@compiled
def read_room(picture: Picture, channels: Array, begin: int, place: Index, room: Pixels) -> None:
    """Read p pixels at `begin` plus `place` (p,); `channels` (3,): the weights of B, G and R."""
    values = picture.values
    if picture.channels == 1:
        for k in range(len(place)):
            room[k] = values[begin + place[k]]
        return
    for k in range(len(place)):
        at = begin + place[k]
        room[k] = (
            channels[0] * values[at] + channels[1] * values[at + 1] + channels[2] * values[at + 2]
        )


@compiled
def look_around(
    picture: Picture, lights: Array, fits: Fits, n: int, weight: Array, moved: Array, dim: Flags
) -> None:
    """Say what patches of the room beside a spot would move its centre by, `moved` (8, 2), px.

    `lights` (l, 4): place and half width, px, and contrast, DN, of all lights; `weight` (2, p), of
    the pixels. nan where a patch is beyond the picture or reached by a light that is not dim beside
    the spot; `dim` (8,), filled: where a dim one reaches it.
    """
    bright = MAX_DIM * min(fits.parameters[n, PAR_PEAK], float(SENSOR_LIMIT))
    rows, channels = rows_of(fits, n), np.ones(3)
    if picture.channels > 1:
        channel_weights(fits.colour[n], channels)
    radius, place = -int(rows[ROW_ROW, 0]), np.empty(rows.shape[1], np.int64)
    room = np.empty(len(place), Real)
    for k in range(len(place)):
        offset = picture.width * int(rows[ROW_ROW, k]) + int(rows[ROW_COLUMN, k])
        place[k] = picture.channels * offset
    for side in range(N_AROUND):
        x = fits.origin[n, 0] + math.floor(2.0 * radius * DIRECTIONS[side, 0] + 0.5)
        y = fits.origin[n, 1] + math.floor(2.0 * radius * DIRECTIONS[side, 1] + 0.5)
        clear = radius <= x < picture.width - radius and radius <= y < picture.height - radius
        dim[side] = False
        for light in lights:
            reach = radius + PATCH_REACH * light[2]
            if clear and math.hypot(x - light[0], y - light[1]) <= reach:
                dim[side], clear = True, light[3] < bright
        moved[side, 0] = moved[side, 1] = math.nan
        if clear:
            begin = picture.channels * (picture.width * y + x)
            read_room(picture, channels, begin, place, room)
            moved[side, 0], moved[side, 1] = weigh_room(room, weight)


@compiled
def correct_for_room(
    picture: Picture, lights: Array, fits: Fits, kept: Index, assessed: Array, moments: Array
) -> None:
    """Correct m spots of a picture for the room behind them.

    `lights` (l, 4): place and half width, px, and contrast, DN, of all lights; `kept` (m,), of the
    fits; `assessed` (m, 16), theirs. `moments` (m, 2, 3): shift, px, and covariance,
    px², are added.
    """
    count, evidence, share = len(kept), np.zeros(N_AMPLITUDES), np.empty(N_AMPLITUDES)
    noise, own = np.zeros(count), np.zeros((count, 2, 3))
    follow = np.empty((count, N_PARAMETERS, N_RIGHT + 2))
    solved = np.empty((count, N_AMPLITUDES, N_RIGHT, 3))
    moved, explained = np.empty((count, N_AROUND, 2)), np.zeros((count, 2))
    dim = np.empty((count, N_AROUND), np.bool_)
    pool = np.empty(N_RIGHT * fits.begin[-1], Real)
    for m in range(count):
        n = kept[m]
        if assessed[m, COL_MERGED] == 0.0:
            noise[m] = surroundings_noise(rows_of(fits, n))
        if noise[m] > 0.0:
            right = right_of(pool, fits, n)
            fill_right(fits.parameters[n], rows_of(fits, n), right)
            if not sum_curvature(fits, n, right, follow[m], solved[m], evidence):
                noise[m] = 0.0
    share_out(evidence, share)
    reach, factors = np.empty((N_RIGHT, 2)), np.empty((N_PARAMETERS, 2))
    for m in range(count):
        if noise[m] == 0.0:
            continue
        n, rows = kept[m], rows_of(fits, kept[m])
        average_correction(follow[m], solved[m], share, reach, factors, own[m])
        weight, added = np.zeros((2, rows.shape[1])), np.zeros((2, rows.shape[1]))
        add_rows(follow[m, :, N_RIGHT:].copy(), rows, weight)
        add_rows(factors, rows, added)
        add_rows(reach, right_of(pool, fits, n), added)
        squares = weigh_rows(rows, weight, added)
        explained[m, 0] = squares[0] * noise[m] + own[m, 0, 1]
        explained[m, 1] = squares[1] * noise[m] + own[m, 1, 2]
        look_around(picture, lights, fits, n, weight, moved[m], dim[m])
    add_excess(moved, dim, explained, own)
    for m in range(count):
        for i in range(2):
            for j in range(3):
                moments[m, i, j] += own[m, i, j]


@compiled
def share_out(evidence: Array, share: Array) -> None:
    """Fill in the probability of each amplitude by its evidence; the rest is that of none."""
    highest, total = 0.0, 0.0
    for k in range(N_AMPLITUDES):
        highest = max(highest, evidence[k])
    for k in range(N_AMPLITUDES):
        share[k] = math.exp(evidence[k] - highest)
        total += share[k]
    for k in range(N_AMPLITUDES):
        share[k] /= total + math.exp(-highest)


@compiled
def add_excess(moved: Array, dim: Flags, explained: Array, moments: Array) -> None:
    """Widen the covariances of m spots by what the room beside them moves beyond what is explained.

    `moved` (m, 8, 2), px; `dim` (m, 8), which of the patches a dim light reaches: texture where it
    leaves too few others; `explained` (m, 2), px², of their squares, 0 of spots left alone.
    """
    ratio, own, pooled = np.empty(moved.size), np.empty(len(moved)), 0
    least, most = 1.0, MAX_OWN
    for textured in range(2):
        if pooled >= MIN_AROUND:
            break
        if textured == 1:  # what is left beside dim lights says it less well
            least, most = MIN_TEXTURE, math.inf
        pooled = 0
        for m in range(len(moved)):
            before, own[m] = pooled, 0.0
            for side in range(N_AROUND):
                for i in range(2):
                    one = moved[m, side, i] ** 2 / explained[m, i]
                    usable = explained[m, i] > 0.0 and one >= 0.0
                    if usable and (textured == 1 or not dim[m, side]):
                        ratio[pooled], own[m] = one, own[m] + one
                        pooled += 1
            own[m] /= max(pooled - before, 1)
    if pooled < MIN_AROUND:
        return
    usual = median(ratio[:pooled]) / MEDIAN_CHI2
    usual = usual if usual > least else 1.0
    for m in range(len(moved)):
        excess = (own[m] if own[m] > most * usual else usual) - 1.0
        for i in range(2):
            moments[m, i, 1 + i] += excess * explained[m, i]


@compiled
def average_correction(
    follow: Array, solved: Array, share: Array, reach: Array, factors: Array, moments: Array
) -> None:
    """Average a spot's correction over k amplitudes, each with its `share` (k,).

    `follow` (10, 10) and `solved` (k, 8, 3) as by `sum_curvature`. Filled: `reach` (8, 2) and
    `factors` (10, 2), px, by which the shift follows r and B, and D; `moments` (2, 3): the shift,
    px, and its covariance, px².
    """
    reach[:] = 0.0
    for k in range(len(share)):
        moved = np.zeros(2)
        for i in range(2):
            for c in range(1, N_RIGHT):
                moved[i] -= solved[k, c, 0] * follow[i, c]
                reach[c, i] += share[k] * solved[k, c, 1 + i]
            moments[i, 0] += share[k] * moved[i]
        for i in range(2):
            for j in range(2):
                moments[i, 1 + j] += share[k] * moved[i] * moved[j]
    for i in range(2):
        for j in range(2):
            moments[i, 1 + j] -= moments[i, 0] * moments[j, 0]
            for c in range(1, N_RIGHT):
                moments[i, 1 + j] -= follow[j, c] * reach[c, i]
        for a in range(N_PARAMETERS):
            factors[a, i] = 0.0
            for c in range(1, N_RIGHT):
                factors[a, i] -= follow[a, c] * reach[c, i]
