"""Where a pose's LEDs should show, compiled."""

import math

import numpy as np

from verify.compiled import compiled
from verify.records import Array
from verify.small_matrices import dot


@compiled
def boxes_about(
    camera_T_flange: Array,
    leds: Array,
    camera: tuple[Array, Array],
    half: tuple[float, float, float, float],
    size: tuple[int, int],
    boxes: Array,
) -> int:
    """Fill in the boxes about the LEDs that stand in the image; those that overlap become one.

    Args:
        camera_T_flange: (4, 4).
        leds: (n, 3), m, flange frame.
        camera: its matrix (3, 3), px, and k1, k2, p1, p2, k3.
        half: half a box: px; and seen at the LED's depth, m, m, and rad that the whole has turned.
        size: px, width and height of the image.
        boxes: (n, 4), px, filled: x0, y0, x1, y1.

    Returns:
        How many there are.
    """
    matrix, lens = camera
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
        u, v = seen(point[0] / point[2], point[1] / point[2], matrix, lens)
        reach = half[0] + matrix[0, 0] * around / point[2]
        x0, x1, y0, y1 = u - reach, u + reach, v - reach, v + reach
        if x1 > 0.0 and y1 > 0.0 and x0 < width - 1.0 and y0 < height - 1.0:
            boxes[count, 0], boxes[count, 2] = max(x0, 0.0), min(x1, width)
            boxes[count, 1], boxes[count, 3] = max(y0, 0.0), min(y1, height)
            count += 1
    return unite(boxes, count)


@compiled
def seen(x: float, y: float, matrix: Array, lens: Array) -> tuple[float, float]:
    """Carry normalised coordinates to pixels, distortion included."""
    r2, twice = x * x + y * y, 2.0 * x * y
    radial = 1.0 + r2 * (lens[0] + r2 * (lens[1] + r2 * lens[4]))
    a = x * radial + lens[2] * twice + lens[3] * (r2 + 2.0 * x * x)
    b = y * radial + lens[2] * (r2 + 2.0 * y * y) + lens[3] * twice
    u = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2]
    return float(u), float(matrix[1, 1] * b + matrix[1, 2])


@compiled
def unite(boxes: Array, count: int) -> int:
    """Unite boxes that overlap, so that no spot is found twice; gives how many are left."""
    one = 0
    while one < count:
        other = one + 1
        while other < count:
            a, b = boxes[one], boxes[other]
            if a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]:
                for i in range(2):
                    a[i], a[i + 2] = min(a[i], b[i]), max(a[i + 2], b[i + 2])
                count -= 1
                boxes[other] = boxes[count]
                other = one  # it has grown: the others are looked at anew
            other += 1
        one += 1
    return count
