"""What tells a clock's offset coarsely, compiled: motions seen and read, at every offset.

The pose that drawn spots ask for, in every draw: Gauss-Newton, compiled.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import factor, solve
from verify.core.records import Array
from verify.measurement.kernels.pose import move_pose, predict_spots

Flags = NDArray[np.bool_]


@compiled
def motion_misfits(
    instants: Array,
    known: Flags,
    grid: tuple[Array, Array],
    step: float,
    seen: tuple[Array, Array],
    most: float,
    cost: Array,
) -> None:
    """Fill in how badly the motions that were read fit those that were seen, at some offsets.

    Args:
        instants: (o, 2, n), s, beginning and end of each of n motions, on the readings' clock.
        known: (o, n), which of them have readings.
        grid: instants in order (g,), s, a step apart, and the flange there (g, 4, 4).
        step: s.
        seen: the motions' angle and distance, and the variance of each, (n, 2) both.
        most: of a squared misfit: a wild pair has one vote.
        cost: (o,), filled: mean squared misfit of the known ones.
    """
    times, poses = grid
    figures, variance = seen
    for o in range(len(instants)):
        total, count = 0.0, 0
        for n in range(len(figures)):
            if not known[o, n]:
                continue
            count += 2
            i = min(np.searchsorted(times, instants[o, 0, n] - step / 2), len(times) - 1)
            k = min(np.searchsorted(times, instants[o, 1, n] - step / 2), len(times) - 1)
            angle, distance = motion_between(poses[i], poses[k])
            total += min((angle - figures[n, 0]) ** 2 / variance[n, 0], most)
            total += min((distance - figures[n, 1]) ** 2 / variance[n, 1], most)
        cost[o] = total / count


@compiled
def motion_between(one: Array, other: Array) -> tuple[float, float]:
    """Give angle (rad) and distance (m) of the motion between two poses (4, 4)."""
    turn = away = 0.0
    for i in range(3):
        for j in range(3):
            turn += (one[i, j] - other[i, j]) ** 2
        away += (one[i, 3] - other[i, 3]) ** 2
    # the Frobenius norm of two rotations' difference is sqrt(8) times the sine of half the angle
    return 2.0 * math.asin(min(math.sqrt(turn / 8.0), 1.0)), math.sqrt(away)


@compiled
def motion_sizes(one: Array, other: Array, figures: Array) -> None:
    """Fill in the same of n pairs of poses (n, 4, 4): (n, 2)."""
    for n in range(len(figures)):
        figures[n, 0], figures[n, 1] = motion_between(one[n], other[n])


N_FREE = 6
# focal (d, 2, 2) and middle (d, 2), px; lens (d, 5); camera_R_rig (d, 3, 3); origin (d, 3), m
Drawn = tuple[Array, Array, Array, Array, Array]


@compiled
def fit_poses(
    poses: Array,
    spots: tuple[Array, Array],
    cameras: tuple[Drawn, Drawn],
    lefts: int,
    weight: Array,
    limits: tuple[int, float],
) -> None:
    """Move poses to where the spots ask for, until each has settled.

    Args:
        poses: (d, 4, 4), rig_T_flange, where to start; moved in place.
        spots: LEDs on the flange (d, s, 3), m, and where they are seen (d, s, 2), px.
        cameras: the left one and the right one.
        lefts: how many of the spots are the left camera's; they come first.
        weight: (2 s, 2 s), 1/px², symmetric.
        limits: steps at most, and the step (m and rad) that ends them.
    """
    points, seen = spots
    count = points.shape[1]
    focal, middle, lens = np.empty((count, 2, 2)), np.empty((count, 2)), np.empty((5, count))
    turn, origin = np.empty((count, 3, 3)), np.empty((count, 3))
    pixels, by_point = np.empty((count, 2)), np.empty((count, 2, 3))
    by_pose, off = np.empty((count, 2, N_FREE)), np.empty(2 * count)
    design, weighted = np.empty((N_FREE, 2 * count)), np.empty((N_FREE, 2 * count))
    normal, root = np.empty((N_FREE + 1, N_FREE)), np.empty((N_FREE, N_FREE))
    step = normal[N_FREE]
    for d in range(len(poses)):
        fill_camera(cameras[0], d, 0, lefts, (focal, middle, lens, turn, origin))
        fill_camera(cameras[1], d, lefts, count, (focal, middle, lens, turn, origin))
        for _ in range(limits[0]):
            predict_spots(
                poses[d], points[d], turn, origin, lens, focal, middle, pixels, by_point, by_pose
            )
            for s in range(count):
                for i in range(2):
                    off[2 * s + i] = seen[d, s, i] - pixels[s, i]
                    for k in range(N_FREE):
                        design[k, 2 * s + i] = by_pose[s, i, k]
            normal_equations(design, off, weight, weighted, normal)
            factor(normal[:N_FREE], 0.0, root)
            solve(root, step)
            move_pose(poses[d], step)
            largest = 0.0
            for i in range(N_FREE):
                largest = max(largest, abs(step[i]))
            if largest < limits[1]:
                break


@compiled
def fill_camera(camera: Drawn, d: int, first: int, last: int, laid: Drawn) -> None:
    """Give spots `first` to `last` - 1 what draw d makes of their camera; the lens as (5, s)."""
    for s in range(first, last):
        for i in range(2):
            laid[1][s, i] = camera[1][d, i]
            for j in range(2):
                laid[0][s, i, j] = camera[0][d, i, j]
        for i in range(5):
            laid[2][i, s] = camera[2][d, i]
        for i in range(3):
            laid[4][s, i] = camera[4][d, i]
            for j in range(3):
                laid[3][s, i, j] = camera[3][d, i, j]


@compiled_sums
def normal_equations(
    design: Array, off: Array, weight: Array, weighted: Array, normal: Array
) -> None:
    """Fill in normal equations: what spots say of the pose, and what they ask for.

    Args:
        design: (6, 2 s), derivative of the spots by the pose.
        off: (2 s,), px, seen less predicted.
        weight: (2 s, 2 s), 1/px², symmetric.
        weighted: (6, 2 s), filled: the design times the weight.
        normal: (7, 6), filled: the lower half of the information (6, 6), what is asked for below.
    """
    count = len(off)
    weighted[:] = 0.0
    for row in range(count):
        for i in range(N_FREE):
            share = design[i, row]
            for column in range(count):
                weighted[i, column] += share * weight[row, column]
    for i in range(N_FREE):
        total = 0.0
        for column in range(count):
            total += weighted[i, column] * off[column]
        normal[N_FREE, i] = total
        for j in range(i + 1):
            total = 0.0
            for column in range(count):
                total += weighted[i, column] * design[j, column]
            normal[i, j] = total
