"""Pair spots of two images whose rays nearly meet, and say where they meet and how well.

Rays a, b from the centres c1, c2 have the common normal n = a x b; their feet on it are at

    c1 + a ((c2 - c1) x b) . n / n²  and  c2 + b ((c2 - c1) x a) . n / n²

and the gap is the feet's distance. Each spot of one image is tried with each of the other.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import distance, factor, invert
from verify.core.records import Array
from verify.measurement.correspondence.kernels.fit import Scene
from verify.measurement.triangulation import MIN_SIN2

Index = NDArray[np.int64]

MAX_DEVIATION = 4.0  # standard deviations: a true LED is turned away once in 16,000
MAX_DEPTH = 10.0  # m, no camera of this kind resolves a marker there
MIN_MARKER_PX = 8.0  # px, a marker that looks smaller than this cannot be read


@compiled
def insert_cost(cost: float, costs: Array, rows: Index, count: np.int64) -> np.int64 | int:
    """Open a place among the least costs, in rising order, equal ones as they came.

    Of `costs` (m,) and `rows` (m, k), what costs so much, the first `count` are taken; the greatest
    is lost where all are. Gives the place; its row is for the caller to fill. -1 where m others
    cost no more.
    """
    place = count
    if count == len(costs):
        if count == 0 or not cost < costs[count - 1]:
            return -1
        place = count - 1
    while place > 0 and cost < costs[place - 1]:
        costs[place] = costs[place - 1]
        for k in range(rows.shape[1]):
            rows[place, k] = rows[place - 1, k]
        place -= 1
    costs[place] = cost
    return place


@compiled
def ray_midpoint(center: Array, a: Array, b: Array, point: Array) -> float:
    """Fill in the point (3,) midway between rays a and b (3,) from two centres (2, 3).

    Gives the gap between the rays, m; NaN where they are parallel or meet behind a camera. Source:
    verify.measurement.triangulation.ray_midpoints.
    """
    nx, ny, nz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    square = nx * nx + ny * ny + nz * nz
    a_square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    b_square = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    if not square > MIN_SIN2 * (a_square * b_square):
        return math.nan
    x, y, z = center[1, 0] - center[0, 0], center[1, 1] - center[0, 1], center[1, 2] - center[0, 2]
    along_a = (y * b[2] - z * b[1]) * nx + (z * b[0] - x * b[2]) * ny + (x * b[1] - y * b[0]) * nz
    along_b = (y * a[2] - z * a[1]) * nx + (z * a[0] - x * a[2]) * ny + (x * a[1] - y * a[0]) * nz
    if not (along_a > 0.0 and along_b > 0.0):
        return math.nan
    gap = 0.0
    for i in range(3):
        foot_a = center[0, i] + along_a / square * a[i]
        foot_b = center[1, i] + along_b / square * b[i]
        point[i] = (foot_a + foot_b) / 2
        gap += (foot_b - foot_a) ** 2
    return math.sqrt(gap)


@compiled
def find_points(
    scene: Scene, mean_focal: float, skew: float, limit: int
) -> tuple[Index, Array, Array]:
    """List pairs of spots on each other's epipolar line (c, 2), left and right, best first.

    `mean_focal`, px; `skew`, px, by how much the marker may have moved between the images. At most
    `limit` pairs are listed, by mismatch over its noise. Gives their points, (c, 3), m, and the
    points' covariance, (c, 3, 3), m².
    """
    camera_R_rig, center, focal, pixels, covariance, _, allowed, leds = scene
    most, count, size = pixels.shape[1], np.int64(0), 0.0
    where, costs, spot = np.empty((most, most, 3)), np.empty(limit), np.empty((limit, 2), np.int64)
    for one in range(len(leds)):
        for other in range(one):
            size = max(size, distance(leds[one], leds[other]))
    # further away the marker is too small in the image
    farthest = min(size * mean_focal / MIN_MARKER_PX, MAX_DEPTH) if len(leds) > 1 else MAX_DEPTH
    rays = np.empty((2, most, 3))  # of unit depth, rig axes
    for side in range(2):
        turn = camera_R_rig[side]
        for k in range(most):
            x, y = pixels[side, k, 0] / focal[side, 0], pixels[side, k, 1] / focal[side, 1]
            for i in range(3):
                rays[side, k, i] = x * turn[0, i] + y * turn[1, i] + turn[2, i]
    for left in range(most):
        for right in range(most):
            point, depth = where[left, right], 0.0
            gap = ray_midpoint(center, rays[0, left], rays[1, right], point)
            for i in range(3):
                depth += (point[i] - center[0, i]) * camera_R_rig[0, 2, i]
            a, b = covariance[0, left], covariance[1, right]
            noise = math.sqrt((a[0, 0] + a[1, 1]) / 2 + (b[0, 0] + b[1, 1]) / 2)
            mismatch = gap * mean_focal / depth
            # NaN, rays that do not meet, fails
            if not (mismatch <= skew + MAX_DEVIATION * noise and depth < farthest):
                continue
            same_colour = False
            for led in range(len(leds)):
                same_colour = same_colour or (allowed[0, led, left] and allowed[1, led, right])
            if not same_colour:
                continue
            place = insert_cost(mismatch / noise, costs, spot, count)
            if place >= 0:
                spot[place, 0], spot[place, 1] = left, right
                if count < len(costs):
                    count += 1
    rig, spread = locate_points(scene, where, spot[:count])
    return spot[:count], rig, spread


@compiled
def locate_points(scene: Scene, where: Array, spot: Index) -> tuple[Array, Array]:
    """Place the points of c pairs of spots (c, 3), m, with their covariance (c, 3, 3), m².

    `where` (s, s, 3), m: those of all pairs; `spot` (c, 2), left and right.
    """
    camera_R_rig, center, focal, _, spread, _, _, _ = scene
    rig, covariance = np.empty((len(spot), 3)), np.empty((len(spot), 3, 3))
    local, slope = np.empty(3), np.empty(3)
    information, root = np.empty((3, 3)), np.empty((3, 3))
    for c in range(len(spot)):
        for i in range(3):
            rig[c, i] = where[spot[c, 0], spot[c, 1], i]
            for j in range(3):
                information[i, j] = 0.0
        for side in range(2):
            for i in range(3):
                local[i] = 0.0
                for j in range(3):
                    local[i] += camera_R_rig[side, i, j] * (rig[c, j] - center[side, j])
            for axis in range(2):
                scale = focal[side, axis] / local[2]
                lean = -local[axis] * scale / local[2]
                weight = 1.0 / spread[side, spot[c, side], axis, axis]
                for j in range(3):
                    slope[j] = scale * camera_R_rig[side, axis, j] + lean * camera_R_rig[side, 2, j]
                for i in range(3):
                    for j in range(3):
                        information[i, j] += slope[i] * weight * slope[j]
        factor(information, 0.0, root)
        invert(root, covariance[c])
    return rig, covariance
