"""In which order the poses are visited, and over which ways: short, and clear all along."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from verify.planning.constraints import Constraints, Rows
from verify.planning.roadmap import Roadmap, clear
from verify.records import Array

ROUNDS = 20  # of improvements by turning parts of the tour around


@dataclass(frozen=True, slots=True)
class Stop:
    """One posture on the way."""

    q: Array  # (j,), rad
    pose: int | None  # which of the poses, from 0; None: only passed


def tour(constraints: Constraints, known: Roadmap, chosen: list[int], *, back: bool) -> list[Stop]:
    """Order the chosen postures and join them.

    Args:
        constraints: that the direct ways must keep.
        known: postures and ways between them.
        chosen: of its postures, the poses.
        back: the same way back as well, so that every pose is come to from either side.

    Returns:
        The stops, the first pose first.
    """
    places = np.array(chosen, dtype=np.int64)
    q = known.q[places]
    length = known.time[np.ix_(places, places)].copy()
    direct = np.abs(q[:, None] - q).max(axis=2)
    one, other = np.triu_indices(len(q), 1)
    free = clear(constraints, q[one], q[other])
    straight = np.zeros(length.shape, dtype=bool)
    straight[one[free], other[free]] = straight[other[free], one[free]] = True
    length[straight] = direct[straight]
    order = _order(length)
    stops = [Stop(q[order[0]], 0)]
    for number, (a, b) in enumerate(pairwise(order), start=1):
        if not straight[a, b]:
            way = known.way(int(places[a]), int(places[b]))[:-1]
            stops += [Stop(row, None) for row in _cut(constraints, q[a], known.q[way], q[b])]
        stops.append(Stop(q[b], number))
    return stops + stops[-2::-1] if back else stops


def _order(length: Array) -> Rows:
    """A short open tour: the nearest next, then parts turned around while that shortens it."""
    n = len(length)
    tours = [_improved(_nearest(length, start), length) for start in range(min(n, 5))]
    return min(tours, key=lambda one: _sum(one, length))


def _nearest(length: Array, start: int) -> Rows:
    order, left = [start], set(range(len(length))) - {start}
    while left:
        order.append(min(left, key=lambda k: length[order[-1], k]))
        left.remove(order[-1])
    return np.array(order, dtype=np.int64)


def _improved(order: Rows, length: Array) -> Rows:
    n = len(order)
    for _ in range(ROUNDS):
        before = _sum(order, length)
        for i in range(n - 1):
            for k in range(i + 1, n):
                turned = np.concatenate([order[:i], order[i : k + 1][::-1], order[k + 1 :]])
                if _sum(turned, length) < _sum(order, length) - 1e-9:
                    order = turned
        if _sum(order, length) > before - 1e-9:
            break
    return order


def _sum(order: Rows, length: Array) -> float:
    return float(length[order[:-1], order[1:]].sum())


def _cut(constraints: Constraints, start: Array, way: Array, end: Array) -> list[Array]:
    """Leave out postures of a way where the leg past them is clear as well."""
    whole = [start, *way, end]
    kept, at = [], 0
    while at < len(whole) - 1:
        ahead = np.array(whole[at + 1 :])
        free = clear(constraints, np.tile(whole[at], (len(ahead), 1)), ahead)
        free[0] = True  # a leg of the roadmap
        at += 1 + int(np.flatnonzero(free)[-1])
        kept.append(whole[at])
    return kept[:-1]
