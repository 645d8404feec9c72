"""Stretches of a session in which one joint moves and all others rest, by the readings alone."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.comparison import Comparison
from verify.readings import RATE_SPAN
from verify.records import Array

LEAST_SPAN = np.deg2rad(10.0)  # a shorter arc hardly shows where its axis lies
FEWEST_PAIRS = 8  # an axis and its start pose have ten unknowns, each pair shows six
STILL = np.deg2rad(0.05)  # a digit or two of a common read-out
NOISE_FACTOR = 10.0  # the range of hundreds of readings at rest, in their standard deviations
EDGE = 0.3  # of that band about the middle reading: three standard deviations
MARGIN = 2  # pairs beyond, at ends where another joint moves
DIGITS = 2.0  # of the last digit: a joint at rest flickers between two


@dataclass(frozen=True, slots=True)
class Stretch:
    """Compared pairs during which one joint alone moved."""

    joint: int  # from 0
    rows: NDArray[np.int64]  # (n,), of the comparison, in order of time
    direction: Array  # (n,), of travel, +1 or -1


def reading_noise(comparison: Comparison) -> Array:
    """Standard deviation of one reading, (j,), rad, from what it does to a rate."""
    noise: Array = np.sqrt(2 * comparison.rate_variance) * RATE_SPAN
    return noise


def bands(comparison: Comparison, resolution: float | None) -> Array:
    """Range that readings of a joint at rest stay within, (j,), rad."""
    band = np.maximum(NOISE_FACTOR * reading_noise(comparison), STILL)
    limit: Array = np.maximum(band, DIGITS * (resolution or 0.0))
    return limit


def travel(q: Array, band: float) -> Array:
    """Direction of travel at each pair (n,): +1, -1, 0 before any; kept at rest.

    A joint has turned back once it left its extreme by more than `band`, and it did so from the
    first pair on that noise does not put there. A long rest, whose noise wanders far, turns nothing
    back, and of a joint that has not moved yet nothing is said.
    """
    directions = np.zeros(len(q))
    extreme, direction = 0, 0.0
    for i, value in enumerate(q.tolist()):
        away = value - float(q[extreme])
        if direction != 0 and away * direction >= 0:
            extreme = i
        elif abs(away) > band:
            left = i
            while direction != 0 and abs(float(q[left - 1] - q[extreme])) > band / 2:
                left -= 1
            direction = float(np.sign(away))
            directions[left:i] = direction
            extreme = i
        directions[i] = direction
    return directions


def find_stretches(comparison: Comparison, resolution: float | None) -> list[Stretch]:
    """Find where one joint turns by LEAST_SPAN or more while the others stay within their noise.

    Args:
        comparison: readings at the compared pairs; those whose pose is not wholly known, or whose
            joint has not moved yet, are left out.
        resolution: rad, the readings' last digit; None: not known.

    Returns:
        Stretches in order of time; none overlaps another of its joint.
    """
    whole = np.flatnonzero([known.shape[1] == 6 for known in comparison.determined])
    q = comparison.q[whole]
    limit = bands(comparison, resolution)
    rests = np.array([_rests(q[:, j], float(limit[j])) for j in range(q.shape[1])])
    found = []
    for joint in range(q.shape[1]):
        ends = np.delete(rests, joint, axis=0).min(axis=0, initial=len(q))
        for first, end in _widest(q[:, joint], ends):
            rows = whole[slice(*_settled(q, joint, (first, end), limit))]
            direction = travel(comparison.q[rows, joint], float(limit[joint]))
            rows, direction = rows[direction != 0], direction[direction != 0]
            if len(rows) >= FEWEST_PAIRS and np.ptp(comparison.q[rows, joint]) >= LEAST_SPAN:
                found.append(Stretch(joint, rows, direction))
    return sorted(found, key=lambda s: (int(s.rows[0]), s.joint))


def _rests(q: Array, limit: float) -> NDArray[np.int64]:
    """Where from each pair on (n,) a joint first leaves a band of `limit`, (n,)."""
    ends = np.zeros(len(q), dtype=np.int64)
    high: deque[int] = deque()
    low: deque[int] = deque()
    values, end = q.tolist(), 0
    for first in range(len(values)):
        while end < len(values):
            # places of the greatest and the least reading since `first`, then of those after them
            while high and values[high[-1]] <= values[end]:
                high.pop()
            while low and values[low[-1]] >= values[end]:
                low.pop()
            high.append(end)
            low.append(end)
            if values[high[0]] - values[low[0]] > limit:
                break
            end += 1
        ends[first] = end
        for places in (high, low):
            if places and places[0] == first:
                places.popleft()
    return ends


def _settled(q: Array, joint: int, stretch: tuple[int, int], limit: Array) -> tuple[int, int]:
    """Leave out the ends of a stretch at which another joint still moves, or moves already.

    It does so below its readings' noise for a while, and the flange shows a tenth of that.
    """
    first, end = stretch
    others = np.delete(q[first:end], joint, axis=1)
    away = np.abs(others - np.median(others, axis=0)) > EDGE * np.delete(limit, joint)
    still = ~np.any(away, axis=1)
    if not still.any():
        return first, first
    start, stop = first + int(np.argmax(still)), end - int(np.argmax(still[::-1]))
    return start + MARGIN * (first > 0), stop - MARGIN * (end < len(q))


def _widest(q: Array, ends: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Of the stretches [first, ends[first]) those in which q turns far, the widest first."""
    before = np.concatenate([[0], ends[:-1]])
    longest = np.flatnonzero((ends > before) & (ends - np.arange(len(ends)) >= FEWEST_PAIRS))
    stretches = [(int(first), int(ends[first])) for first in longest]
    stretches = [s for s in stretches if np.ptp(q[slice(*s)]) >= LEAST_SPAN]
    taken: list[tuple[int, int]] = []
    for first, end in sorted(stretches, key=lambda s: -float(np.ptp(q[slice(*s)]))):
        for other, last in taken:  # what is left of one beside wider ones
            if first < last and other < end:
                sides = (first, min(end, other)), (max(first, last), end)
                first, end = max(sides, key=lambda s: s[1] - s[0])
        if end - first >= FEWEST_PAIRS and np.ptp(q[first:end]) >= LEAST_SPAN:
            taken.append((first, end))
    return taken
