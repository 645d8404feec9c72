"""Interpolate joint readings: values, interpolation errors, directions of travel.

Between readings h apart, s the share of h passed, values follow the cubic with the speeds v0, v1
of second-order differences at both ends (Catmull-Rom); an error e0, e1 of these speeds makes

    h s (1 - s) (e0 (1 - s) + e1 s)
"""

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array

N_END_READINGS = 4  # through which a cubic gives the speed at an end


# Of the time from a turning point to the threshold, a parabola is within half of it for 0.71.
RESTED = 0.85


@compiled
def slope_at(t: Array, q: Array, i: int, joint: int, longest: float) -> float:
    """Joint's speed at reading i by second-order differences, as numpy.gradient; 0 beside a gap."""
    before = t[i] - t[i - 1] if i > 0 else 0.0
    after = t[i + 1] - t[i] if i < len(t) - 1 else 0.0
    if before > longest or after > longest:
        return 0.0  # a slope across a gap means nothing
    if before == 0.0 or after == 0.0:
        way, most = 1 if before == 0.0 else -1, min(N_END_READINGS, len(t))
        return one_sided_slope(t, q, i, way, joint, longest, most)
    late, early = before * before * q[i + 1, joint], after * after * q[i - 1, joint]
    middle = (after * after - before * before) * q[i, joint]
    return float((late + middle - early) / (before * after * (before + after)))


@compiled
def one_sided_slope(
    t: Array, q: Array, i: int, way: int, joint: int, longest: float, most: int
) -> float:
    """Give a joint's speed at reading i from those on one side of it, by a polynomial.

    The newest interval is all that a live pair has: a straight line there errs by 7 % of
    acceleration times interval squared, 0.3° for a brisk joint read at 9 Hz. t (m,), s, increasing,
    two at least; q (m, j), rad. Neighbours lie `way`, 1 or -1; those beyond a gap longer than
    `longest`, s, are left alone. The polynomial goes through `most` readings if there are as many.

    Source: Newton's divided differences.
    """
    slope, lever = 0.0, 1.0
    columns = np.empty(most)
    for k in range(most):
        at = i + way * k
        if at < 0 or at >= len(t) or (k > 0 and abs(t[at] - t[at - way]) > longest):
            break
        columns[k] = q[at, joint]
        for order in range(1, k + 1):  # the next divided difference, in place
            first = k - order
            columns[first] = (columns[first + 1] - columns[first]) / (t[at] - t[at - way * order])
        if k > 0:
            slope += lever * columns[0]
            lever *= t[i] - t[at]
    return slope


@compiled
def interpolate(t: Array, q: Array, longest: float, instants: Array) -> Array:
    """Readings (n, j), rad, at instants (n,), s: cubic between four readings (Catmull-Rom).

    t (m,), s, increasing, two at least; q (m, j), rad. Across a gap longer than `longest`, s, the
    nearest reading is held.
    """
    values = np.empty((len(instants), q.shape[1]))
    for n in range(len(instants)):
        instant = min(max(instants[n], t[0]), t[-1])
        after = min(max(np.searchsorted(t, instant), 1), len(t) - 1)
        width, passed = t[after] - t[after - 1], instant - t[after - 1]
        for j in range(q.shape[1]):
            early, late = q[after - 1, j], q[after, j]
            if width > longest:
                values[n, j] = early if passed < t[after] - instant else late
                continue
            straight = (late - early) / width
            begin = slope_at(t, q, after - 1, j, longest)
            end = slope_at(t, q, after, j, longest)
            twist = (begin + end - 2.0 * straight) / width
            bend = (straight - begin) / width - twist
            values[n, j] = early + passed * (begin + passed * (bend + passed * (twist / width)))
    return values


@compiled
def slope_difference(t: Array, q: Array, i: int, joint: int, longest: float) -> float:
    """Say how much a joint's speed at reading i differs from what another polynomial makes it.

    At an end, one of an order less; of two readings alone, rest.
    """
    at_end = i == 0 or i == len(t) - 1
    other = min(N_END_READINGS, len(t)) - (1 if at_end else 0)
    way = -1 if i > 1 or i == len(t) - 1 else 1
    beside = max(t[i] - t[i - 1] if i > 0 else 0.0, t[i + 1] - t[i] if i < len(t) - 1 else 0.0)
    if beside > longest:
        return 0.0
    return abs(
        slope_at(t, q, i, joint, longest) - one_sided_slope(t, q, i, way, joint, longest, other)
    )


@compiled
def interpolation_error(t: Array, q: Array, longest: float, instants: Array) -> Array:
    """Error that `interpolate` may have at some instants, (n, j), rad; arguments are the same.

    A cubic takes a speed's error at one of its ends to h s (1 - s)², s the share of h from there.
    """
    values = np.zeros((len(instants), q.shape[1]))
    for n in range(len(instants)):
        instant = min(max(instants[n], t[0]), t[-1])
        after = min(max(np.searchsorted(t, instant), 1), len(t) - 1)
        width = t[after] - t[after - 1]
        late = (instant - t[after - 1]) / width
        early = 1.0 - late
        for j in range(q.shape[1] if width <= longest else 0):
            begin = slope_difference(t, q, after - 1, j, longest)
            end = slope_difference(t, q, after, j, longest)
            values[n, j] = width * late * early * (begin * early + end * late)
    return values


@compiled
def travel_directions(q: Array, thresholds: Array) -> NDArray[np.int8]:
    """Joints' direction of travel (m, j) after each reading: +1, -1, or 0 before any.

    q (m, j), rad; beyond its threshold (j,), rad, from its extreme a joint has turned back. From
    when on, is then sought.
    """
    directions = np.empty(q.shape, np.int8)
    for j in range(q.shape[1]):
        extreme, direction = q[0, j], 0
        for i in range(len(q)):
            value = q[i, j]
            if (value - extreme) * direction > 0:
                extreme = value
            elif abs(value - extreme) > thresholds[j]:
                direction = 1 if value > extreme else -1
                for k in range(_turning_point(q[:, j], i, extreme, thresholds[j]), i):
                    directions[k, j] = direction
                extreme = value
            directions[i, j] = direction
    return directions


@compiled
def _turning_point(q: Array, found: int, extreme: float, threshold: float) -> int:
    """Reading from which on a joint moves back, of q (m,), rad, beyond the threshold at `found`.

    A joint that turns without a rest is as long on its way there as on its way back. After a rest,
    it moves from the last reading on that is within half of the threshold.
    """
    begin, last = found - 1, -1
    while begin >= 0 and abs(q[begin] - extreme) <= threshold:
        if last < 0 and abs(q[begin] - extreme) <= threshold / 2:
            last = begin
        begin -= 1
    middle = (begin + found + 1) // 2
    rested = begin < 0 or last - middle > RESTED * (found - middle)
    return last + 1 if rested else middle
