"""Spots carried along their image velocity, compiled."""

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.records import Array

Index = NDArray[np.int64]


@compiled
def carry(
    led: tuple[Index, Index],
    centre: tuple[Array, Array],
    covariance: tuple[Array, Array],
    taken: tuple[Array, Array],
    t: float,
    carried: tuple[Array, Array, Array, Array],
) -> int:
    """Carry m spots to an instant, along the lines through them and a neighbour's.

    LEDs new to this pair move like the others, give or take their spread.

    Args:
        led: (m,) and the neighbour's (k,).
        centre: (m, 2) and (k, 2), px.
        covariance: (m, 2, 2) and (k, 2, 2), px².
        taken: (m,) and (k,), s.
        t: s, to where.
        carried: filled: centre (m, 2); covariance (m, 2, 2); velocity (m, 2), px/s; lever (m,),
            s², of an acceleration that two sightings do not show.

    Returns:
        How many LEDs the neighbour has seen too; with none nothing is filled in.
    """
    place, spread, velocity = carried[0], carried[1], carried[2]
    match = matches(led[0], led[1])
    known = np.flatnonzero(match >= 0)
    if len(known) == 0:
        return 0
    intervals = np.empty(len(known))
    mean = np.zeros(2)
    for n in range(len(known)):
        i = int(known[n])
        k = int(match[i])
        interval = taken[0][i] - taken[1][k]
        intervals[n] = interval
        share = (t - taken[0][i]) / interval
        for a in range(2):
            velocity[i, a] = (centre[0][i, a] - centre[1][k, a]) / interval
            mean[a] += velocity[i, a] / len(known)
            for b in range(2):
                own, other = covariance[0][i, a, b], covariance[1][k, a, b]
                spread[i, a, b] = (1.0 + share) ** 2 * own + share**2 * other
    scatter = scattering(velocity, known, mean)
    typical = np.median(intervals)
    for i in range(len(match)):
        shift = t - taken[0][i]
        interval = taken[0][i] - taken[1][match[i]] if match[i] >= 0 else typical
        for a in range(2):
            if match[i] < 0:
                velocity[i, a] = mean[a]
                for b in range(2):
                    spread[i, a, b] = covariance[0][i, a, b] + shift**2 * scatter[a, b]
            place[i, a] = centre[0][i, a] + velocity[i, a] * shift
        carried[3][i] = -0.5 * shift * (shift + interval)
    return len(known)


@compiled
def matches(led: Index, others: Index) -> Index:
    """Give each LED's place among others (m,), -1 where it is not there; the last of several."""
    found = np.full(len(led), -1, dtype=np.int64)
    for i in range(len(led)):
        for k in range(len(others)):
            if others[k] == led[i]:
                found[i] = k
    return found


@compiled
def scattering(velocity: Array, known: Index, mean: Array) -> Array:
    """Covariance of one LED's velocity about the mean of the others, (2, 2), (px/s)²."""
    count, spread = len(known), np.zeros((2, 2))
    if count < 2:  # nothing better is known than its size
        for a in range(2):
            spread[a, a] = velocity[known[0], a] ** 2
        return spread
    for i in known:
        for a in range(2):
            for b in range(2):
                off = (velocity[i, a] - mean[a]) * (velocity[i, b] - mean[b])
                spread[a, b] += off / (count - 1) * (1.0 + 1.0 / count)
    return spread
