"""Compare motions at many clock offsets, and fit the pose of every Monte Carlo draw.

The misfit of an offset is the mean over motions of (read - measured)² / variance, angle and
distance alike, each bounded. A draw's pose T minimises, by Gauss-Newton, with u the predicted and z
the drawn spots and W their inverse covariance,

    (z - u(T))' W (z - u(T))

An analysis compares hundreds of motions at hundreds of offsets, and fits hundreds of draws of
several poses: in numpy either takes longer than the rest of a short session's analysis.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import factor, solve
from verify.core.records import Array
from verify.measurement.kernels.pose import move_pose, predict_spots

Flags = NDArray[np.bool_]
N_FREE = 6
# focal (d, 2, 2) and middle (d, 2), px; lens (d, 5); camera_R_rig (d, 3, 3); origin (d, 3), m
Drawn = tuple[Array, Array, Array, Array, Array]


@compiled
def motion_misfits(
    ends: NDArray[np.int64],
    known: Flags,
    poses: Array,
    measured: tuple[Array, Array],
    most: float,
    cost: Array,
) -> None:
    """Fill in `cost` (o,): mean squared misfit of the motions read to those measured, at o offsets.

    `ends` (o, 2, n): which of the flange's poses read (g, 4, 4) begins and ends each of n motions;
    `known` (o, n): those with readings. `measured`: the motions' angle and distance, and the
    variance of each, (n, 2) both. A squared misfit counts for `most` at most: a wild pair has one
    vote.
    """
    figures, variance = measured
    for o in range(len(ends)):
        total, count = 0.0, 0
        for n in range(len(figures)):
            if not known[o, n]:
                continue
            count += 2
            angle, distance = motion_between(poses[ends[o, 0, n]], poses[ends[o, 1, n]])
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


@compiled
def fit_poses(
    poses: Array,
    spots: tuple[Array, Array],
    cameras: tuple[Drawn, Drawn],
    lefts: int,
    weight: Array,
    limits: tuple[int, float],
) -> None:
    """Fit each draw's pose to its spots, until it has settled.

    `poses` (d, 4, 4), rig_T_flange, are the start and moved in place; `spots`: LEDs on the flange
    (d, s, 3), m, and their spots (d, s, 2), px, those of the left camera, `lefts` of them, first;
    `cameras`: left, right; `weight` (2 s, 2 s), 1/px², symmetric; `limits`: steps at most, and the
    step (m and rad) that ends them.
    """
    points, centre = spots
    count = points.shape[1]
    focal, middle, lens = np.empty((count, 2, 2)), np.empty((count, 2)), np.empty((5, count))
    turn, origin = np.empty((count, 3, 3)), np.empty((count, 3))
    pixels, by_point = np.empty((count, 2)), np.empty((count, 2, 3))
    by_pose, off = np.empty((count, 2, N_FREE)), np.empty(2 * count)
    design, weighted = np.empty((N_FREE, 2 * count)), np.empty((N_FREE, 2 * count))
    normal, root = np.empty((N_FREE + 1, N_FREE)), np.empty((N_FREE, N_FREE))
    step = normal[N_FREE]
    for d in range(len(poses)):
        for s in range(count):
            camera = cameras[0] if s < lefts else cameras[1]
            for i in range(2):
                middle[s, i] = camera[1][d, i]
                for j in range(2):
                    focal[s, i, j] = camera[0][d, i, j]
            for i in range(5):
                lens[i, s] = camera[2][d, i]
            for i in range(3):
                origin[s, i] = camera[4][d, i]
                for j in range(3):
                    turn[s, i, j] = camera[3][d, i, j]
        for _ in range(limits[0]):
            predict_spots(
                poses[d], points[d], turn, origin, lens, focal, middle, pixels, by_point, by_pose
            )
            for s in range(count):
                for i in range(2):
                    off[2 * s + i] = centre[d, s, i] - pixels[s, i]
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


@compiled_sums
def normal_equations(
    design: Array, off: Array, weight: Array, weighted: Array, normal: Array
) -> None:
    """Fill in the normal equations of a pose's step.

    From `design` (6, 2 s), the spots by the pose, `off` (2 s,), px, spots less their prediction,
    and `weight` (2 s, 2 s), 1/px², symmetric: `weighted` (6, 2 s), design times weight, and
    `normal` (7, 6), the lower half of the information (6, 6), the right side below.
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
