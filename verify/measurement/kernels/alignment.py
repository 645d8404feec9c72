"""Carry spots to another instant along their image velocity; box the LEDs that a pose predicts.

A spot z taken at t1, its LED's z0 at t0 in a neighbouring picture, is at the instant t

    z + v (t - t1),  v = (z - z0) / (t1 - t0)

with the covariance of that sum, and the lever -(t - t1) (t - t0) / 2 of an acceleration that two
pictures do not show.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import dot, median
from verify.core.records import Array

Index = NDArray[np.int64]


@compiled
def carry_to_instant(
    led: tuple[Index, Index],
    centre: tuple[Array, Array],
    covariance: tuple[Array, Array],
    taken: tuple[Array, Array],
    t: float,
) -> tuple[int, Array, Array, Array, Array]:
    """Carry m spots to an instant, along the lines through them and a neighbour's.

    LEDs new to this pair move like the others, with their spread as uncertainty.

    Args:
        led: (m,) and the neighbour's (k,).
        centre: (m, 2) and (k, 2), px.
        covariance: (m, 2, 2) and (k, 2, 2), px².
        taken: (m,) and (k,), s.
        t: s, to where.

    Returns:
        How many LEDs the neighbour shows too, without which nothing else is of use; centre (m, 2);
        covariance (m, 2, 2); velocity (m, 2), px/s; lever (m,), s².
    """
    m, count = len(led[0]), 0
    place, spread, velocity = np.empty((m, 2)), np.empty((m, 2, 2)), np.empty((m, 2))
    lever, match, shared = np.empty(m), np.empty(m, np.int64), np.empty(m, np.int64)
    for i in range(m):
        match[i] = -1
        for k in range(len(led[1])):
            if led[1][k] == led[0][i]:
                match[i] = k
        if match[i] >= 0:
            shared[count] = i
            count += 1
    if count == 0:
        return count, place, spread, velocity, lever
    known, intervals = shared[:count], np.empty(count)
    mean = np.zeros(2)
    for n in range(count):
        i = int(known[n])
        k = int(match[i])
        interval = taken[0][i] - taken[1][k]
        intervals[n] = interval
        share = (t - taken[0][i]) / interval
        for a in range(2):
            velocity[i, a] = (centre[0][i, a] - centre[1][k, a]) / interval
            mean[a] += velocity[i, a] / count
            for b in range(2):
                own, other = covariance[0][i, a, b], covariance[1][k, a, b]
                spread[i, a, b] = (1.0 + share) ** 2 * own + share**2 * other
    scatter = velocity_scatter(velocity, known, mean)
    typical = median(intervals)
    for i in range(len(match)):
        shift = t - taken[0][i]
        interval = taken[0][i] - taken[1][match[i]] if match[i] >= 0 else typical
        for a in range(2):
            if match[i] < 0:
                velocity[i, a] = mean[a]
                for b in range(2):
                    spread[i, a, b] = covariance[0][i, a, b] + shift**2 * scatter[a, b]
            place[i, a] = centre[0][i, a] + velocity[i, a] * shift
        lever[i] = -0.5 * shift * (shift + interval)
    return count, place, spread, velocity, lever


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

    Args:
        camera_T_flange: (4, 4).
        leds: (n, 3), m, flange frame.
        camera: its matrix (3, 3), px, and k1, k2, p1, p2, k3.
        half: half a box: px; and at the LED's depth, m, m, and rad that the whole has turned.
        size: px, width and height of the image.
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
