"""What a patch's pixels lead one to expect of its spot before it is fitted, compiled."""

import math

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.detection.kernel_clip import SENSOR_LIMIT
from verify.detection.kernel_pixels import FLOOR, PEAK, SLOPE_X, SLOPE_Y, STEEPNESS, X, Y
from verify.records import Array

FULL = 3.0  # DN below the limit: a top so near it is cut off, and higher than it seems
HIDDEN, SEEN = 1.3, 1.05  # peak over what the core shows: of a cut-off top, and of another
DEEPEST = 30.0  # DN about the floor: a neighbour is no slope
FLAT, STEEP = 0.3, 2.5  # logarithms: no guess of a steepness is beyond
BLURRED = 0.1  # likewise: by which counted pixels look steeper than the spot
HALO = 0.7  # DN, of a spot's light in the pixels that its floor is guessed from
MOST_BLACK = 0.98  # share of pixels: with more, how far below black the floor is cannot be guessed
LOGISTIC = 1.702  # scale on which a logistic law is a normal one, to 0.01 (Camilli, 1994)


@compiled
def expect_all(
    pixels: Array,
    scale: Array,
    read: float,
    usual: tuple[Array, Array],
    prior: tuple[Array, Array],
    start: Array,
    full: NDArray[np.bool_],
) -> None:
    """Say what is expected of peak, floor and slopes, and where the fit may start.

    Args:
        pixels: (n, 4, p): value, 1 where valid, column, row.
        scale: (n,), px, half-width that the fit starts from.
        read: DN, standard deviation of a dark pixel.
        usual: (10,) and (10,), mean and inverse variance of any spot's parameters.
        prior: (n, 10) and (n, 10), of these ones', filled.
        start: (n, 10), filled.
        full: (n,), filled: whether pixels on the spot are at the sensor's limit.
    """
    mean, weight = prior
    for n in range(len(pixels)):
        value, valid, column, row = pixels[n, 0], pixels[n, 1], pixels[n, 2], pixels[n, 3]
        mean[n], weight[n], start[n] = usual[0], usual[1], usual[0]
        floor = ranked(value, len(value) * 3 // 10)
        top = surroundings(value, valid, column, row, scale[n], floor, weight[n])
        mean[n, FLOOR] = floor
        mean[n, PEAK] = (HIDDEN if top > SENSOR_LIMIT - FULL else SEEN) * max(top - floor, 1.0)
        full[n] = False
        for k in range(len(value)):
            if value[k] >= SENSOR_LIMIT:
                near = column[k] * column[k] + row[k] * row[k] <= scale[n] * scale[n]
                full[n] = full[n] or near
        start[n, PEAK], start[n, FLOOR] = mean[n, PEAK], floor
        if not full[n]:  # a top that is cut off says nothing of its sides
            start[n, FLOOR] = (floor if floor > 0.0 else below_black(value, read)) - HALO
            start[n, PEAK] = top - start[n, FLOOR]
            begin(value, column, row, scale[n], floor, top, start[n])


@compiled
def ranked(value: Array, rank: int) -> float:
    """The value (p,), DN, that so many others are no greater than."""
    counts = np.zeros(int(SENSOR_LIMIT) + 1, np.int64)
    for one in value:
        whole = int(one)
        if whole != one:  # of combined colours
            return float(np.partition(value, rank)[rank])
        counts[whole] += 1
    level, below = 0, counts[0]
    while below <= rank:
        level += 1
        below += counts[level]
    return float(level)


@compiled
def surroundings(
    value: Array,
    valid: Array,
    column: Array,
    row: Array,
    scale: float,
    floor: float,
    weight: Array,
) -> float:
    """Hold the slopes (10,) as firmly as the pixels about the spot have none; give its top, DN."""
    core, ring = (0.5 * scale + 0.5) ** 2, (2.3 * scale + 1.0) ** 2
    total, count = 0.0, 0.0
    lean_x, lean_y, lever_x, lever_y = 0.0, 0.0, 0.0, 0.0
    for k in range(len(value)):
        if valid[k] <= 0.0:
            continue
        x, y = column[k], row[k]
        distance2 = x * x + y * y
        if distance2 <= core:
            total += value[k]
            count += 1.0
        elif distance2 > ring:
            excess = min(max(value[k] - floor, -DEEPEST), DEEPEST)
            lean_x += excess * x
            lean_y += excess * y
            lever_x += x * x
            lever_y += y * y
    # A slope costs the centre information, so it is let in as far as the surroundings have one.
    weight[SLOPE_X] = 1.0 / ((lean_x / max(lever_x, 1.0)) ** 2 + 1e-8)
    weight[SLOPE_Y] = 1.0 / ((lean_y / max(lever_y, 1.0)) ** 2 + 1e-8)
    return float(total / max(count, 1.0))


@compiled
def below_black(value: Array, read: float) -> float:
    """Guess the floor where black cuts it off, from how many pixels are black."""
    black = 0.0
    for k in range(len(value)):
        black += value[k] < 0.5
    share = min(black / len(value), MOST_BLACK)
    return 0.5 - read * math.log(share / (1.0 - share)) / LOGISTIC


@compiled
def begin(
    value: Array, column: Array, row: Array, scale: float, floor: float, top: float, start: Array
) -> None:
    """Guess a spot's place from its pixels over 1/4 of its height, its steepness from how many.

    Args:
        value: (p,), DN.
        column: (p,), px.
        row: (p,), px.
        scale: px, half-width that the fit starts from.
        floor: DN.
        top: DN.
        start: (10,), changed where the pixels tell.
    """
    height, wide, narrow = top - floor, 0.0, 0.0
    light, right, down = 0.0, 0.0, 0.0
    near = (2.2 * scale) ** 2
    for k in range(len(value)):
        over = value[k] - floor - 0.25 * height
        if over > 0.0 and column[k] * column[k] + row[k] * row[k] < near:
            wide += 1.0
            narrow += over > 0.5 * height
            light += over
            right += over * column[k]
            down += over * row[k]
    if light > 0.0:
        start[X], start[Y] = right / light, down / light
    if 4.0 <= narrow < wide:
        # areas go with the square of radii
        guess = math.log(2.0 * math.log(3.0) / math.log(wide / narrow)) - BLURRED
        start[STEEPNESS] = min(max(guess, FLAT), STEEP)
