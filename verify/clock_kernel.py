"""What tells a clock's offset coarsely, compiled: motions seen and read, at every offset."""

import math

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.records import Array

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
def motions(one: Array, other: Array, figures: Array) -> None:
    """Fill in the same of n pairs of poses (n, 4, 4): (n, 2)."""
    for n in range(len(figures)):
        figures[n, 0], figures[n, 1] = motion_between(one[n], other[n])
