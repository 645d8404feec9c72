"""Compare motions at many clock offsets.

The misfit of an offset is the mean over motions of (read - measured)² / variance, angle and
distance alike, each bounded. An analysis compares hundreds of motions at hundreds of offsets: in
numpy that takes longer than the rest of a short session's analysis.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array

Flags = NDArray[np.bool_]


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
