"""Stretches of a session in which one joint moves and all others rest, by the readings alone.

Which joint was swept when: found in the encoders' readings alone.
"""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from verify.analysis.comparison import Comparison
from verify.core.readings import RATE_SPAN, Readings
from verify.core.records import Array

MIN_SPAN = np.deg2rad(10.0)  # a shorter arc hardly shows where its axis lies
MIN_PAIRS = 8  # an axis and its start pose have ten unknowns, each pair shows six
MIN_REST_BAND = np.deg2rad(0.05)  # a digit or two of a common read-out
NOISE_FACTOR = 10.0  # the range of hundreds of readings at rest, in their standard deviations
EDGE_SHARE = 0.3  # of that band about the middle reading: three standard deviations
MARGIN_PAIRS = 2  # pairs beyond, at ends where another joint moves
REST_DIGITS = 2.0  # of the last digit: a joint at rest flickers between two


@dataclass(frozen=True, slots=True)
class SweepSegment:
    """Compared pairs during which one joint alone moved."""

    joint: int  # from 0
    rows: NDArray[np.int64]  # (n,), of the comparison, in order of time
    direction: Array  # (n,), of travel, +1 or -1


def reading_noise(comparison: Comparison) -> Array:
    """Standard deviation of one reading, (j,), rad, from what it does to a rate."""
    noise: Array = np.sqrt(2 * comparison.rate_variance) * RATE_SPAN
    return noise


def rest_bands(comparison: Comparison, resolution: float | None) -> Array:
    """Range that readings of a joint at rest stay within, (j,), rad."""
    band = np.maximum(NOISE_FACTOR * reading_noise(comparison), MIN_REST_BAND)
    limit: Array = np.maximum(band, REST_DIGITS * (resolution or 0.0))
    return limit


def travel_direction(q: Array, band: float) -> Array:
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


def find_segments(comparison: Comparison, resolution: float | None) -> list[SweepSegment]:
    """Find where one joint turns by MIN_SPAN or more while the others stay within their noise.

    Args:
        comparison: readings at the compared pairs; those whose pose is not wholly known, or whose
            joint has not moved yet, are left out.
        resolution: rad, the readings' last digit; None: not known.

    Returns:
        Stretches in order of time; none overlaps another of its joint.
    """
    whole = np.flatnonzero([known.shape[1] == 6 for known in comparison.determined])
    q = comparison.q[whole]
    limit = rest_bands(comparison, resolution)
    rests = np.array([_rests(q[:, j], float(limit[j])) for j in range(q.shape[1])])
    found = []
    for joint in range(q.shape[1]):
        ends = np.delete(rests, joint, axis=0).min(axis=0, initial=len(q))
        for first, end in _widest(q[:, joint], ends):
            rows = whole[slice(*_trim_ends(q, joint, (first, end), limit))]
            direction = travel_direction(comparison.q[rows, joint], float(limit[joint]))
            rows, direction = rows[direction != 0], direction[direction != 0]
            if len(rows) >= MIN_PAIRS and np.ptp(comparison.q[rows, joint]) >= MIN_SPAN:
                found.append(SweepSegment(joint, rows, direction))
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


def _trim_ends(q: Array, joint: int, stretch: tuple[int, int], limit: Array) -> tuple[int, int]:
    """Leave out the ends of a stretch at which another joint still moves, or moves already.

    It does so below its readings' noise for a while, and the flange shows a tenth of that.
    """
    first, end = stretch
    others = np.delete(q[first:end], joint, axis=1)
    away = np.abs(others - np.median(others, axis=0)) > EDGE_SHARE * np.delete(limit, joint)
    still = ~np.any(away, axis=1)
    if not still.any():
        return first, first
    start, stop = first + int(np.argmax(still)), end - int(np.argmax(still[::-1]))
    return start + MARGIN_PAIRS * (first > 0), stop - MARGIN_PAIRS * (end < len(q))


def _widest(q: Array, ends: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Of the stretches [first, ends[first]) those in which q turns far, the widest first."""
    before = np.concatenate([[0], ends[:-1]])
    longest = np.flatnonzero((ends > before) & (ends - np.arange(len(ends)) >= MIN_PAIRS))
    stretches = [(int(first), int(ends[first])) for first in longest]
    stretches = [s for s in stretches if np.ptp(q[slice(*s)]) >= MIN_SPAN]
    taken: list[tuple[int, int]] = []
    for first, end in sorted(stretches, key=lambda s: -float(np.ptp(q[slice(*s)]))):
        for other, last in taken:  # what is left of one beside wider ones
            if first < last and other < end:
                sides = (first, min(end, other)), (max(first, last), end)
                first, end = max(sides, key=lambda s: s[1] - s[0])
        if end - first >= MIN_PAIRS and np.ptp(q[first:end]) >= MIN_SPAN:
            taken.append((first, end))
    return taken


# A joint counts as moving between two pairs from here on: five times what readings' noise makes of
# a difference, and never less than the last digits of a common read-out.
SWEEP_NOISE_FACTOR = 5.0 * np.sqrt(2)
MIN_SWEEP_TRAVEL = np.deg2rad(0.03)
MAX_REST_TRAVEL = np.deg2rad(
    0.1
)  # what the other joints may stray during a sweep: 0.2 mm at 100 mm
MIN_SWEEP_PAIRS = 6  # an axis has four unknowns and each pair one of its own


@dataclass(frozen=True, slots=True)
class MotionSegment:
    """Pairs in a row during which one joint alone moved."""

    joint: int  # counted from 0
    pairs: NDArray[np.int64]  # indices into the measured pairs
    q: Array  # (n, joints), rad, the encoders at those pairs

    @property
    def span(self) -> float:
        """From the joint's least to its largest reading, rad."""
        return float(np.ptp(self.q[:, self.joint]))


def find_sweeps(
    readings: Readings, t: Array, frame: NDArray[np.int64]
) -> tuple[list[MotionSegment], list[str]]:
    """Split pairs into sweeps.

    Args:
        readings: the encoders.
        t: (n,), s, the pairs' instants on the readings' clock.
        frame: (n,), the pairs' numbers, for the words.

    Returns:
        The sweeps in order of time, and what was left out and why, in sentences.
    """
    known = readings.known(t)
    q = readings.at(t)
    limit = np.maximum(SWEEP_NOISE_FACTOR * readings.noise, MIN_SWEEP_TRAVEL)
    sweeps: list[MotionSegment] = []
    notes: list[str] = []
    for joints, chosen in _runs(q, known, limit):
        named = " and ".join(str(j + 1) for j in joints)
        when = f"pairs {frame[chosen[0]]} to {frame[chosen[-1]]}"
        if len(joints) > 1:
            notes.append(f"Left out: in {when} joints {named} move together.")
            continue
        others = np.delete(np.ptp(q[chosen], axis=0), joints[0])
        if np.any(others > np.maximum(MAX_REST_TRAVEL, SWEEP_NOISE_FACTOR * readings.noise.max())):
            notes.append(f"Left out: joint {named} in {when}; another joint strays meanwhile.")
        elif len(chosen) < MIN_SWEEP_PAIRS:
            notes.append(
                f"Left out: joint {named} in {when}; an axis needs {MIN_SWEEP_PAIRS} pairs or more."
            )
        else:
            sweeps.append(MotionSegment(joints[0], chosen, q[chosen]))
    return sweeps, notes


def _runs(
    q: Array, known: NDArray[np.bool_], limit: Array
) -> list[tuple[tuple[int, ...], NDArray[np.int64]]]:
    """Stretches of pairs with the joints that move in them, from the first motion to the last.

    Pairs at rest between two motions of one joint belong to its stretch; those before another
    joint's motion do not: it may have begun already, too slowly to tell.
    """
    runs: list[tuple[tuple[int, ...], int, int]] = []
    places = np.flatnonzero(known)
    for before, now in pairwise(places.tolist()):
        joints = tuple(np.flatnonzero(np.abs(q[now] - q[before]) > limit).tolist())
        if not joints:
            continue
        if runs and runs[-1][0] == joints:
            runs[-1] = (joints, runs[-1][1], now)
        else:
            runs.append((joints, before, now))
    return [(joints, places[(places >= first) & (places <= last)]) for joints, first, last in runs]
