"""Carry spots to another instant along their image motion; box the LEDs that a pose predicts.

A spot taken at t_0 and its LED's sightings at t_1 ... t_n in n neighbouring pictures lie on a
polynomial; at the instant t it has the covariance of their sum, each with its Lagrange weight, and

    the lever  -(t - t_0) ... (t - t_n) / (n + 1)!

of the derivative of order n + 1 that these sightings do not show: acceleration, jerk or snap.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import dot, median
from verify.core.records import Array

Index = NDArray[np.int64]
# LED (m,), centre (m, 2) px, covariance (m, 2, 2) px², instant (m,) s of one picture's spots
SpotView = tuple[Index, Array, Array, Array]


@compiled
def carry_to_instant(
    now: SpotView, around: tuple[SpotView, SpotView, SpotView], t: float
) -> tuple[int, Array, Array, Array, Array]:
    """Carry m spots to an instant t, s, by what neighbouring pictures show of their LEDs.

    LEDs that no neighbour shows move like the others, with their spread as uncertainty. `around`:
    the spots of the pictures before, after, and before the one before, which counts only beside
    one of the others; empty where there is none.

    Gives how many LEDs a neighbour shows too, without which nothing else is of use; centre (m, 2);
    covariance (m, 2, 2); velocity (m, 2), px/s; levers (m, 3), s², s³, s⁴.
    """
    led, centre, covariance, taken = now
    m, count = len(led), 0
    place, spread, velocity = centre.copy(), np.zeros((m, 2, 2)), np.zeros((m, 2))
    lever, shared, shown = np.zeros((m, 3)), np.empty(m, np.int64), np.zeros(m, np.bool_)
    intervals, mean, instant = np.empty(m), np.zeros(2), np.empty(4)
    row, weight, slope = np.empty(3, np.int64), np.empty(4), np.empty(4)
    for i in range(m):
        instant[0], n = taken[i], 0
        for v in range(3):
            row[v] = row_of(around[v][0], led[i]) if v < 2 or n > 0 else -1
            if row[v] >= 0:
                n += 1
                instant[n] = around[v][3][row[v]]
        if n == 0:
            continue
        lever[i, n - 1] = lagrange_weights(instant[: n + 1], t, weight, slope)
        intervals[count] = taken[i] - instant[1] if n == 1 else -2.0 * (t - taken[i])
        for x in range(2):
            for y in range(2):
                spread[i, x, y] = weight[0] ** 2 * covariance[i, x, y]
        k = 0
        for v in range(3):
            if row[v] < 0:
                continue
            k += 1
            for x in range(2):
                away = around[v][1][row[v], x] - centre[i, x]
                place[i, x] += weight[k] * away
                velocity[i, x] += slope[k] * away
                for y in range(2):
                    spread[i, x, y] += weight[k] ** 2 * around[v][2][row[v], x, y]
        for x in range(2):
            mean[x] += velocity[i, x]
        shared[count], shown[i] = i, True
        count += 1
    if count == 0:
        return count, place, spread, velocity, lever
    for x in range(2):
        mean[x] /= count
    scatter = velocity_scatter(velocity, shared[:count], mean)
    typical = median(intervals[:count])
    for i in range(m):
        if shown[i]:
            continue
        shift = t - taken[i]
        for x in range(2):
            velocity[i, x] = mean[x]
            place[i, x] = centre[i, x] + mean[x] * shift
            for y in range(2):
                spread[i, x, y] = covariance[i, x, y] + shift**2 * scatter[x, y]
        lever[i, 0] = -0.5 * shift * (shift + typical)
    return count, place, spread, velocity, lever


@compiled
def row_of(led: Index, wanted: int) -> int:
    """Where an LED stands among a picture's, -1 where it does not."""
    for k in range(len(led)):
        if led[k] == wanted:
            return k
    return -1


@compiled
def lagrange_weights(instant: Array, t: float, weight: Array, slope: Array) -> float:
    """Fill in the weights of values at n + 1 instants in the value and the slope, 1/s, at t, s.

    Returns:
        The error, by one unit of the derivative of order n + 1 that the values do not show.
    """
    error = -1.0
    for a in range(len(instant)):
        error *= (t - instant[a]) / (a + 1.0)
        weight[a], slope[a] = 1.0, 0.0
        for b in range(len(instant)):
            if b == a:
                continue
            apart = instant[a] - instant[b]
            slope[a] = (slope[a] * (t - instant[b]) + weight[a]) / apart
            weight[a] *= (t - instant[b]) / apart
    return error


@compiled
def velocity_scatter(velocity: Array, known: Index, mean: Array) -> Array:
    """Covariance of one LED's velocity about the mean of the others, (2, 2), (px/s)²."""
    count, spread = len(known), np.zeros((2, 2))
    if count < 2:  # nothing better is known than its size
        for a in range(2):
            spread[a, a] = velocity[known[0], a] ** 2
        return spread
    for i in known:
        for a in range(2):
            for b in range(2):
                off = (velocity[i, a] - mean[a]) * (velocity[i, b] - mean[b])
                spread[a, b] += off / (count - 1) * (1.0 + 1.0 / count)
    return spread


@compiled
def led_boxes(
    camera_T_flange: Array,
    leds: Array,
    camera: tuple[Array, Array],
    half: tuple[float, float, float, float],
    size: tuple[int, int],
) -> Array:
    """Boxes about the LEDs in the image, (n, 4), px: x0, y0, x1, y1; those that overlap become one.

    `camera_T_flange` (4, 4); `leds` (n, 3), m, flange frame; `camera`: its matrix (3, 3), px, and
    k1, k2, p1, p2, k3; `half`: half a box: px; and at the LED's depth, m, m, and rad that the whole
    has turned; `size`, px, width and height of the image.
    """
    boxes, (matrix, lens) = np.empty((len(leds), 4)), camera
    width, height = float(size[0]), float(size[1])
    count, point, radius = 0, np.empty(3), 0.0
    for led in range(len(leds)):
        radius = max(radius, math.sqrt(dot(leds[led], leds[led])))
    around = half[1] + half[2] + half[3] * radius
    for led in range(len(leds)):
        for i in range(3):
            point[i] = camera_T_flange[i, 3]
            for j in range(3):
                point[i] += camera_T_flange[i, j] * leds[led, j]
        if point[2] <= 0.0:  # behind the camera there is nothing to look for
            continue
        u, v = to_pixels(point[0] / point[2], point[1] / point[2], matrix, lens)
        reach = half[0] + matrix[0, 0] * around / point[2]
        x0, x1, y0, y1 = u - reach, u + reach, v - reach, v + reach
        if x1 > 0.0 and y1 > 0.0 and x0 < width - 1.0 and y0 < height - 1.0:
            boxes[count, 0], boxes[count, 2] = max(x0, 0.0), min(x1, width)
            boxes[count, 1], boxes[count, 3] = max(y0, 0.0), min(y1, height)
            count += 1
    return boxes[: merge_boxes(boxes[:count])]


@compiled
def to_pixels(x: float, y: float, matrix: Array, lens: Array) -> tuple[float, float]:
    """Carry normalised coordinates to pixels, distortion included."""
    r2, twice = x * x + y * y, 2.0 * x * y
    radial = 1.0 + r2 * (lens[0] + r2 * (lens[1] + r2 * lens[4]))
    a = x * radial + lens[2] * twice + lens[3] * (r2 + 2.0 * x * x)
    b = y * radial + lens[2] * (r2 + 2.0 * y * y) + lens[3] * twice
    u = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2]
    return float(u), float(matrix[1, 1] * b + matrix[1, 2])


@compiled
def merge_boxes(boxes: Array) -> int:
    """Unite boxes (n, 4) that overlap, so that no spot is found twice; return their number."""
    one, count = 0, len(boxes)
    while one < count:
        other = one + 1
        while other < count:
            a, b = boxes[one], boxes[other]
            if a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]:
                for i in range(2):
                    a[i], a[i + 2] = min(a[i], b[i]), max(a[i + 2], b[i + 2])
                count -= 1
                for i in range(4):
                    boxes[other, i] = boxes[count, i]
                other = one  # it has grown: the others are looked at anew
            other += 1
        one += 1
    return count
