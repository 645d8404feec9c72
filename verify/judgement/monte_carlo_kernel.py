"""The pose that drawn spots ask for, in every draw: Gauss-Newton, compiled."""

import numpy as np

from verify.compiled import compiled, compiled_sums
from verify.pose_kernel import move
from verify.pose_prediction import predict_spots
from verify.records import Array
from verify.small_matrices import factor, solve

FREE = 6
# focal (d, 2, 2) and middle (d, 2), px; lens (d, 5); camera_R_rig (d, 3, 3); origin (d, 3), m
Drawn = tuple[Array, Array, Array, Array, Array]


@compiled
def fit_all(
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
    by_pose, off = np.empty((count, 2, FREE)), np.empty(2 * count)
    design, weighted = np.empty((FREE, 2 * count)), np.empty((FREE, 2 * count))
    normal, root = np.empty((FREE + 1, FREE)), np.empty((FREE, FREE))
    step = normal[FREE]
    for d in range(len(poses)):
        lay_out(cameras[0], d, 0, lefts, (focal, middle, lens, turn, origin))
        lay_out(cameras[1], d, lefts, count, (focal, middle, lens, turn, origin))
        for _ in range(limits[0]):
            predict_spots(
                poses[d], points[d], turn, origin, lens, focal, middle, pixels, by_point, by_pose
            )
            for s in range(count):
                for i in range(2):
                    off[2 * s + i] = seen[d, s, i] - pixels[s, i]
                    for k in range(FREE):
                        design[k, 2 * s + i] = by_pose[s, i, k]
            weigh(design, off, weight, weighted, normal)
            factor(normal[:FREE], 0.0, root)
            solve(root, step)
            move(poses[d], step)
            largest = 0.0
            for i in range(FREE):
                largest = max(largest, abs(step[i]))
            if largest < limits[1]:
                break


@compiled
def lay_out(camera: Drawn, d: int, first: int, last: int, laid: Drawn) -> None:
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
def weigh(design: Array, off: Array, weight: Array, weighted: Array, normal: Array) -> None:
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
        for i in range(FREE):
            share = design[i, row]
            for column in range(count):
                weighted[i, column] += share * weight[row, column]
    for i in range(FREE):
        total = 0.0
        for column in range(count):
            total += weighted[i, column] * off[column]
        normal[FREE, i] = total
        for j in range(i + 1):
            total = 0.0
            for column in range(count):
                total += weighted[i, column] * design[j, column]
            normal[i, j] = total
