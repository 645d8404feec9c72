"""Costs and counts of the spots that assignments explain, compiled.

hypotheses.py has the model. In numpy, `gather_all` alone takes several times as long as the whole
correspondence of a pair (`make bench`, detection and chain).
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import dot
from verify.core.records import Array

Index = NDArray[np.int64]
Flags = NDArray[np.bool_]


@compiled
def spread_of(derivative: Array, covariance: Array) -> tuple[float, float, float]:
    """Covariance xx, xy, yy (px²) of an image (2, 8) under that of its pose and shift (8, 8)."""
    xx, xy, yy = 0.0, 0.0, 0.0
    for i in range(derivative.shape[1]):
        x, y = 0.0, 0.0
        for j in range(derivative.shape[1]):
            x += derivative[0, j] * covariance[j, i]
            y += derivative[1, j] * covariance[j, i]
        xx += x * derivative[0, i]
        xy += x * derivative[1, i]
        yy += y * derivative[1, i]
    return xx, xy, yy


@compiled
def weigh_spots(
    seen: tuple[Array, Array, Flags],
    limits: tuple[float, float, float, float, float],
    image: Array,
    derivative: Array,
    depth: float,
    covariance: Array,
    cost: Array,
) -> None:
    """Fill in what it costs to take each spot for an LED, inf for those outside its gate.

    Args:
        seen: spots (s, 2) px, their covariance (s, 2, 2) px², and which are merged (s,).
        limits: those of `gather_all`.
        image: (2,), px, predicted.
        derivative: (2, 8), by pose and shift.
        depth: m.
        covariance: (8, 8), of pose and shift.
        cost: (s,): those that may be the LED on entry finite; filled.
    """
    pixels, spread, merged = seen
    nearest, play, gate, largest, merged_cost = limits
    xx, xy, yy = spread_of(derivative, covariance)
    known = xx + yy <= 2 * largest * largest and depth > nearest
    allowance = (play / max(depth, nearest)) ** 2
    for k in range(len(pixels)):
        x, y = pixels[k, 0] - image[0], pixels[k, 1] - image[1]
        a, d = spread[k, 0, 0] + (xx + allowance), spread[k, 1, 1] + (yy + allowance)
        b = spread[k, 0, 1] + xy
        squared = (d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b)
        if known and squared <= gate * gate:
            cost[k] += squared + merged_cost * merged[k]
        else:
            cost[k] = math.inf


@compiled
def choose_spots(cost: Array, spot: Index) -> None:
    """Give every LED the cheapest of those spots (n, s) that no other LED gets cheaper."""
    leds, spots = cost.shape
    for k in range(spots):
        least = math.inf
        for led in range(leds):
            least = min(least, cost[led, k])
        for led in range(leds):
            if cost[led, k] > least:
                cost[led, k] = math.inf
    for led in range(leds):
        spot[led], least = -1, math.inf
        for k in range(spots):
            if cost[led, k] < least:
                spot[led], least = k, cost[led, k]


@compiled
def gather_all(
    seen: tuple[Array, Array, Flags],
    allowed: Flags,
    limits: tuple[float, float, float, float, float],
    predicted: tuple[Array, Array, Array],
    covariance: Array,
    spot: Index,
) -> None:
    """Fill in the spot (h, 2, n) that each LED gets in each image, -1 for none.

    Args:
        seen: spots (2, s, 2) px, their covariance (2, s, 2, 2) px², and which are merged (2, s).
        allowed: (2, n, s), this spot may be that LED.
        limits: nearest depth (m), an LED's play times the focal length (m px), the gate in
            standard deviations, the largest uncertainty (px) of an LED worth looking for, and
            what a merged spot costs.
        predicted: LED images (h, 2, n, 2) px, their derivative (h, 2, n, 2, 8), depths (h, 2, n) m.
        covariance: (h, 8, 8), of pose and shift.
        spot: filled.
    """
    pixels, spread, merged = seen
    image, derivative, depth = predicted
    cost = np.empty((allowed.shape[1], allowed.shape[2]))
    for h in range(len(spot)):
        for side in range(2):
            own = pixels[side], spread[side], merged[side]
            for led in range(len(cost)):
                for k in range(cost.shape[1]):
                    cost[led, k] = 0.0 if allowed[side, led, k] else math.inf
                weigh_spots(
                    own, limits, image[h, side, led], derivative[h, side, led],
                    depth[h, side, led], covariance[h], cost[led],
                )  # fmt: skip
            choose_spots(cost, spot[h, side])


@compiled
def count_all(spot: Index, counts: Index) -> None:
    """Count for assignments (h, 2, n), -1 for no spot; counts (3, h) are filled.

    They are the spots in use, the LEDs seen by a camera, and those seen by both.
    """
    counts[:] = 0
    for h in range(len(spot)):
        for led in range(spot.shape[2]):
            left, right = spot[h, 0, led] >= 0, spot[h, 1, led] >= 0
            counts[0, h] += left + right
            counts[1, h] += left or right
            counts[2, h] += left and right


@compiled
def departures_of_all(
    leds: Array,
    spot: Index,
    poses: tuple[Array, Array],
    rig_T_flange: Array,
    scales: tuple[float, float, float],
    off: Array,
) -> None:
    """Fill in how far the LEDs of each hypothesis (h,) are from where a reference pose has them.

    Args:
        leds: (n, 3), m, flange frame.
        spot: (h, 2, n), -1 for none.
        poses: rotations (h, 3, 3) and positions (h, 3) m of the hypotheses.
        rig_T_flange: (4, 4), the reference.
        scales: position (m), rotation (rad), and how well a coarse pose places an LED (m).
        off: (h,), filled.
    """
    rotation, position = poses
    along, about, coarse = scales
    moves, mean, middle = np.empty((len(leds), 3)), np.empty(3), np.empty(3)
    for h in range(len(off)):
        seen = 0
        for led in range(len(leds)):
            seen += max(spot[h, 0, led], spot[h, 1, led]) >= 0
        mean[:], middle[:] = 0.0, 0.0
        share = 1.0 / max(seen, 1)
        for led in range(len(leds)):
            weight = share if max(spot[h, 0, led], spot[h, 1, led]) >= 0 else 0.0
            for i in range(3):
                move = position[h, i] - rig_T_flange[i, 3]
                for j in range(3):
                    move += (rotation[h, i, j] - rig_T_flange[i, j]) * leds[led, j]
                moves[led, i] = move
                mean[i] += weight * move
                middle[i] += weight * leds[led, i]
        radius, turned = 0.0, 0.0
        for led in range(len(leds)):
            weight = share if max(spot[h, 0, led], spot[h, 1, led]) >= 0 else 0.0
            for i in range(3):
                radius += weight * (leds[led, i] - middle[i]) ** 2
                turned += weight * (moves[led, i] - mean[i]) ** 2
        lever, moved = math.sqrt(dot(middle, middle)), math.sqrt(dot(mean, mean))
        off[h] = math.hypot(
            moved / (along + about * lever + coarse),
            math.sqrt(turned) / (about * math.sqrt(radius) + coarse),
        )
