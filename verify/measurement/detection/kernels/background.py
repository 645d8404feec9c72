"""Sums over the pixels of spots that show how the room behind them is curved, and what it moves.

Symbols as in background.py: with D the derivatives by a spot's parameters, r its residuals and B
those by the curvature, all over the pixels' sigmas, A the information on the parameters,

    S = B'B - B'D A⁻¹ D'B,   h = B'r - B'D A⁻¹ D'r
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import factor, solve_each
from verify.core.records import Array, Image
from verify.measurement.detection.kernels.fit import MIN_INFORMATION, multiply_rows
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    NEIGHBOUR_RADIUS,
    PAR_FLOOR,
    PAR_X,
    PAR_Y,
    ROW_RADIUS2,
    ROW_RESIDUAL,
    ROW_USED,
    ROW_VARIANCE,
    ROW_VISIBLE,
)

N_TERMS = 7
N_RIGHT = N_TERMS + 1  # residuals and terms; a multiple of four
MIN_VISIBLE = 0.5  # share of the noise about a spot that clipping must leave: above black
Index = NDArray[np.int64]
Sums = tuple[Array, Array, Array, Array, Array]  # as `sum_curvature` gives them


@compiled
def surroundings_noise(model: Array) -> float:
    """Mean variance, DN², of a spot's pixels that show the room alone; 0 if it is below black.

    `model` (10, p), of the spot's pixels.
    """
    visible, variance, count = 0.0, 0.0, 0
    for k in range(model.shape[1]):
        if model[ROW_RADIUS2, k] > NEIGHBOUR_RADIUS**2 and model[ROW_USED, k] > 0.0:
            visible += model[ROW_VISIBLE, k]
            variance += model[ROW_VARIANCE, k]
            count += 1
    return variance / count if visible > MIN_VISIBLE * max(count, 1) else 0.0


@compiled
def fill_right(x: float, y: float, pixels: Array, whitened: Array, right: Array) -> None:
    """Fill in `right` (8, p): a spot's residuals, and the derivatives by the curvature's terms.

    `x`, `y`: the spot's centre, px from the patch's; `pixels` (4, p) and `whitened` (11, p).
    """
    scale = -1.0 / pixels[3, 0]  # the topmost pixel comes first
    for k in range(pixels.shape[1]):
        u, w, floor = (pixels[2, k] - x) * scale, (pixels[3, k] - y) * scale, whitened[PAR_FLOOR, k]
        uu, ww = floor * u * u, floor * w * w
        right[0, k], right[1, k] = whitened[ROW_RESIDUAL, k], uu
        right[2, k], right[3, k] = floor * u * w, ww
        right[4, k], right[5, k] = uu * u, uu * w
        right[6, k], right[7, k] = ww * u, ww * w


@compiled
def sum_curvature(
    spots: Index,
    parameters: Array,
    information: Array,
    pixels: Array,
    model: Array,
    whitened: Array,
    amplitudes: Array,
) -> tuple[Sums, Array]:
    """Sum up what m spots of a batch show of the room, and how likely curvature makes it.

    `spots` (m,), of the batch; its `parameters` (n, 10), `information` (n, 10, 10), `pixels`
    (n, 4, p), `model` (n, 10, p) and `whitened` (n, 11, p). `amplitudes` (k,), DN, rising.

    Gives `noise` (m,), DN², of a pixel of the room, 0 where that does not show: all else is void;
    `right` (m, 8, p), as by `fill_right`; `follow` (m, 10, 8), how the parameters follow r and B;
    `inverse` (m, 10, 2), A⁻¹, its columns of x and y; `solved` (m, k, 8, 3): (S + s⁻²)⁻¹ times h
    and the pull, from the second row on. And the log-likelihood ratio of curvature of each
    amplitude to none, (k,).
    """
    count, size, k = len(spots), pixels.shape[2], len(amplitudes)
    noise, right, evidence = np.zeros(count), np.empty((count, N_RIGHT, size)), np.zeros(k)
    follow, inverse = np.empty((count, N_PARAMETERS, N_RIGHT)), np.empty((count, N_PARAMETERS, 2))
    solved = np.empty((count, k, N_RIGHT, 3))
    root, products = np.empty((N_PARAMETERS, N_PARAMETERS)), np.empty((N_PARAMETERS, N_RIGHT))
    left = np.empty((N_RIGHT, N_RIGHT))
    for m in range(count):
        n = spots[m]
        noise[m] = surroundings_noise(model[n])
        if noise[m] == 0.0:
            continue
        fill_right(parameters[n, 0], parameters[n, 1], pixels[n], whitened[n], right[m])
        multiply_rows(whitened[n, :N_PARAMETERS], right[m], products)
        multiply_rows(right[m], right[m], left)
        factor(information[n], -MIN_INFORMATION, root)
        for a in range(N_PARAMETERS):
            for b in range(N_RIGHT):
                follow[m, a, b] = products[a, b]
            for b in range(2):
                inverse[m, a, b] = 1.0 if a == b else 0.0
        solve_each(root, follow[m])
        solve_each(root, inverse[m])
        for a in range(N_PARAMETERS):
            for b in range(N_RIGHT):
                for c in range(N_RIGHT):
                    left[b, c] -= products[a, b] * follow[m, a, c]
        if not solve_amplitudes(left, follow[m], amplitudes, solved[m], evidence):
            noise[m] = 0.0
    return (noise, right, follow, inverse, solved), evidence


@compiled
def solve_amplitudes(
    left: Array, follow: Array, amplitudes: Array, solved: Array, evidence: Array
) -> bool:
    """Fill in what a spot's curvature is at each of k amplitudes, DN, and add to their evidence.

    `left` (8, 8), r and B with themselves, the spot's parameters following: h and S are in it;
    others as `sum_curvature` gives them. False, and nothing added, where rounding leaves no S: of a
    spot far over the limit, which hardly determines its own parameters.
    """
    root = np.empty((N_TERMS, N_TERMS))
    for k in range(len(amplitudes) - 1, -1, -1):  # the largest has the least prior
        if not factor(left[1:, 1:], -1.0 / amplitudes[k] ** 2, root):
            return False
        for c in range(1, N_RIGHT):
            solved[k, c, 0] = left[c, 0]
            solved[k, c, 1], solved[k, c, 2] = -follow[PAR_X, c], -follow[PAR_Y, c]
        solve_each(root, solved[k, 1:])
        for c in range(N_TERMS):
            evidence[k] += 0.5 * solved[k, 1 + c, 0] * left[1 + c, 0]
            evidence[k] -= math.log(amplitudes[k] * root[c, c])
    return True


@compiled_sums
def add_rows(factors: Array, rows: Array, total: Array) -> None:
    """Add rows (m, p), each times its two factors (m, 2), to both of `total` (2, p)."""
    for i in range(2):
        for a in range(len(factors)):
            for k in range(rows.shape[1]):
                total[i, k] += factors[a, i] * rows[a, k]


@compiled_sums
def weigh_rows(model: Array, weight: Array, added: Array) -> tuple[float, float]:
    """Add to `weight` (2, p), both over the pixels' sigmas; give its sums of squares before."""
    first, second = 0.0, 0.0
    for k in range(weight.shape[1]):
        scale = math.sqrt(model[ROW_USED, k] / model[ROW_VARIANCE, k])
        one, other = weight[0, k] * scale, weight[1, k] * scale
        first += one * one
        second += other * other
        weight[0, k], weight[1, k] = one + added[0, k] * scale, other + added[1, k] * scale
    return first, second


@compiled_sums
def weigh_room(
    values: Image, channels: Array, begin: int, place: Index, weight: Array
) -> tuple[float, float]:
    """Sums of p pixels, less their mean, with each of two weights (2, p).

    `values` (v,), DN, of a picture, `channels` (c,) of which make a pixel, weighted so; `begin`
    plus `place` (p,): where each one's are.
    """
    mean, first, second, first_all, second_all = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(place)):
        at = begin + place[k]
        value = channels[0] * values[at]
        for c in range(1, len(channels)):
            value += channels[c] * values[at + c]
        mean += value
        first += value * weight[0, k]
        second += value * weight[1, k]
        first_all += weight[0, k]
        second_all += weight[1, k]
    mean /= len(place)
    return first - mean * first_all, second - mean * second_all


@compiled
def correct_centres(
    values: Image,
    size: tuple[int, int],
    channels: Array,
    lights: tuple[Array, Array],
    directions: Array,
    spots: Index,
    fit: tuple[Index, Array, Array, Array],
    share: Array,
    sums: Sums,
) -> tuple[Array, Array, Array]:
    """Correct m spots' centres, and apply their weights to the room beside them.

    `values` (h w c,), DN, of a picture, `size` its width and height; `channels` (n, c), the
    channels' weights; `lights` (l, 2) and (l,), px: place and reach of all lights; `directions`
    (d, 2), unit vectors, of the patches two radii away from a spot. `spots` (m,), of the batch; of
    that `fit`: centre pixels (n, 2), px, `pixels` (n, 4, p), `model` (n, 10, p), `whitened` (n, 11,
    p). `share` (k,): probability of each amplitude; `sums` as by `sum_curvature`.

    Gives shift and covariance, (m, 2, 3): px, px²; what noise and curvature explain of it, (m, 2)
    px²; what patches of the room would move a centre by, (m, d, 2) px, nan where one is beyond the
    picture or reached by a light.
    """
    (width, height), colours, count = size, channels.shape[1], fit[1].shape[2]
    noise, right, follow, inverse, solved = sums
    moved, explained = np.full((len(spots), len(directions), 2), np.nan), np.zeros((len(spots), 2))
    moments, place = np.zeros((len(spots), 2, 3)), np.empty(count, np.int64)
    reach, factors = np.empty((N_RIGHT, 2)), np.empty((N_PARAMETERS, 2))
    for m in range(len(spots)):
        if noise[m] == 0.0:
            continue
        n, radius = spots[m], -int(fit[1][spots[m], 3, 0])
        average_correction(follow[m], solved[m], share, reach, factors, moments[m])
        weight, added = np.zeros((2, count)), np.zeros((2, count))
        add_rows(inverse[m], fit[3][n], weight)
        add_rows(factors, fit[3][n], added)
        add_rows(reach, right[m], added)
        first, second = weigh_rows(fit[2][n], weight, added)
        explained[m, 0] = first * noise[m] + moments[m, 0, 1]
        explained[m, 1] = second * noise[m] + moments[m, 1, 2]
        for k in range(count):
            place[k] = colours * (width * int(fit[1][n, 3, k]) + int(fit[1][n, 2, k]))
        for side in range(len(directions)):
            x = fit[0][n, 0] + math.floor(2.0 * radius * directions[side, 0] + 0.5)
            y = fit[0][n, 1] + math.floor(2.0 * radius * directions[side, 1] + 0.5)
            clear = radius <= x < width - radius and radius <= y < height - radius
            for light in range(len(lights[1])):
                off = math.hypot(x - lights[0][light, 0], y - lights[0][light, 1])
                clear = clear and off > radius + lights[1][light]
            if clear:
                begin = colours * (width * y + x)
                moved[m, side, 0], moved[m, side, 1] = weigh_room(
                    values, channels[n], begin, place, weight
                )
    return moments, explained, moved


@compiled
def average_correction(
    follow: Array, solved: Array, share: Array, reach: Array, factors: Array, moments: Array
) -> None:
    """Average a spot's correction over k amplitudes, each with its `share` (k,).

    `follow` (10, 8) and `solved` (k, 8, 3) as by `sum_curvature`. Filled: `reach` (8, 2) and
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
