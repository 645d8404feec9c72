"""Give each LED of a hypothesis the spot that it explains; count spots, measure departures.

With u an LED's predicted image, J its derivative by pose and shift, C their covariance, V that of
spot z, the spot costs

    (z - u)' (V + J C J' + play²)⁻¹ (z - u) + what it costs that z is merged with another

beyond the gate it is none of the LED's.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import dot
from verify.core.records import Array
from verify.measurement.correspondence.kernels.fit import N_FREE, HypothesisArrays, predict_image

Index = NDArray[np.int64]
Flags = NDArray[np.bool_]


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
    cameras: tuple[Array, Array, Array],
    spots: tuple[Array, Array, Flags],
    allowed: Flags,
    limits: tuple[float, float, float, float, float],
    leds: Array,
    hypotheses: HypothesisArrays,
) -> Index:
    """Give the spot (h, 2, n) that each LED gets in each image, -1 for none.

    `cameras`, `leds` and `hypotheses` are those of `fit_all`. `spots`: (2, s, 2) px, their
    covariance (2, s, 2, 2) px², and which are merged (2, s). `allowed` (2, n, s): this spot may be
    that LED. `limits`: nearest depth (m), an LED's play times the focal length (m px), the gate in
    standard deviations, the largest uncertainty (px) of an LED worth looking for, and what a merged
    spot costs.
    """
    camera_R_rig, center, focal = cameras
    pixels, noise, merged = spots
    nearest, play, gate, largest, merged_cost = limits
    rotation, position, shift, _, _, covariance, _ = hypotheses
    cost, image = np.empty((allowed.shape[1], allowed.shape[2])), np.empty(2)
    spot, slope = np.empty((len(covariance), 2, len(cost)), np.int64), np.zeros((2, N_FREE))
    for h in range(len(spot)):
        for side in range(2):
            slope[0, 6] = slope[1, 7] = float(side)
            for led in range(len(cost)):
                depth = predict_image(
                    leds[led], rotation[h], position[h], camera_R_rig[side], center[side],
                    focal[side], nearest, image, slope,
                )  # fmt: skip
                xx, xy, yy = 0.0, 0.0, 0.0  # variance of the predicted image, px²
                for i in range(N_FREE):
                    x, y = 0.0, 0.0
                    for j in range(N_FREE):
                        x += slope[0, j] * covariance[h, j, i]
                        y += slope[1, j] * covariance[h, j, i]
                    xx += x * slope[0, i]
                    xy += x * slope[1, i]
                    yy += y * slope[1, i]
                placed = xx + yy <= 2 * largest * largest and depth > nearest
                play2 = (play / max(depth, nearest)) ** 2
                for k in range(cost.shape[1]):
                    cost[led, k] = math.inf
                    x = pixels[side, k, 0] - (image[0] + side * shift[h, 0])
                    y = pixels[side, k, 1] - (image[1] + side * shift[h, 1])
                    a = noise[side, k, 0, 0] + (xx + play2)
                    b = noise[side, k, 0, 1] + xy
                    d = noise[side, k, 1, 1] + (yy + play2)
                    squared = (d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b)
                    if allowed[side, led, k] and placed and squared <= gate * gate:
                        cost[led, k] = squared + merged_cost * merged[side, k]
            choose_spots(cost, spot[h, side])
    return spot


@compiled
def count_all(spot: Index) -> Index:
    """Count, for assignments (h, 2, n), -1 for no spot, what they use; (3, h).

    Spots in use, LEDs with a spot in an image, and LEDs with one in both.
    """
    counts = np.zeros((3, len(spot)), np.int64)
    for h in range(len(spot)):
        for led in range(spot.shape[2]):
            left, right = spot[h, 0, led] >= 0, spot[h, 1, led] >= 0
            counts[0, h] += left + right
            counts[1, h] += left or right
            counts[2, h] += left and right
    return counts


@compiled
def departures_of_all(
    leds: Array,
    spot: Index,
    poses: tuple[Array, Array],
    rig_T_flange: Array,
    scales: tuple[float, float, float],
) -> Array:
    """Measure how far the LEDs of each hypothesis (h,) are from where a reference pose has them.

    `leds` (n, 3), m, flange frame; `spot` (h, 2, n), -1 for none; `poses`: rotations (h, 3, 3) and
    positions (h, 3) m of the hypotheses; `rig_T_flange` (4, 4), the reference; `scales`: position
    (m), rotation (rad), and how well a coarse pose places an LED (m).
    """
    rotation, position = poses
    along, about, coarse = scales
    moves, mean, middle = np.empty((len(leds), 3)), np.empty(3), np.empty(3)
    off = np.empty(len(position))
    for h in range(len(off)):
        count = 0
        for led in range(len(leds)):
            count += max(spot[h, 0, led], spot[h, 1, led]) >= 0
        mean[:], middle[:] = 0.0, 0.0
        share = 1.0 / max(count, 1)
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
    return off
