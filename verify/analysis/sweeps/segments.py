"""Segments of a session in which one joint moves and all others rest, by the readings alone.

A joint rests where its readings stay within a band. A segment is a run of pairs, as long as can be,
during which all joints but one rest; the widest turns of a joint are taken first.
"""

from collections import deque
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from verify.analysis.comparison import Comparison
from verify.core.readings import Readings
from verify.core.records import Array, Index

MIN_SPAN = np.deg2rad(10.0)  # a shorter arc hardly shows where its axis lies
MIN_PAIRS = 8  # an axis and its start pose have ten unknowns, each pair shows six
MIN_REST_BAND = np.deg2rad(0.05)  # a digit or two of a common read-out
NOISE_FACTOR = 10.0  # the range of hundreds of readings at rest, in their standard deviations
EDGE_SHARE = 0.3  # of that band about the middle reading: three standard deviations
MARGIN_PAIRS = 2  # pairs beyond, at ends where another joint moves
REST_DIGITS = 2.0  # of the last digit: a joint at rest flickers between two
# A joint counts as moving between two pairs from here on: five times what readings' noise makes of
# a difference, and never less than the last digits of a common read-out.
STEP_NOISE_FACTOR = 5.0 * np.sqrt(2)
MIN_STEP = np.deg2rad(0.03)
MAX_REST_TRAVEL = np.deg2rad(0.1)  # of the other joints during a sweep: 0.2 mm at 100 mm
MIN_PAIRS_FREE = 6  # an axis has four unknowns and each pair one of its own


@dataclass(frozen=True, slots=True)
class SweepSegment:
    """Pairs in order of time during which one joint alone moved."""

    joint: int  # from 0
    rows: Index  # (n,), of the compared or measured pairs
    q: Array  # (n, joints), rad, readings at those pairs

    @property
    def span(self) -> float:
        """From the joint's least to its largest reading, rad."""
        return float(np.ptp(self.q[:, self.joint]))


@dataclass(frozen=True, slots=True)
class SegmentLimits:
    """What makes a segment."""

    band: Array  # (joints,), rad, range that readings of a joint at rest stay within
    min_span: float  # rad, of the joint that moves
    min_pairs: int
    edge_share: float = 1.0  # of `band` about the median: beyond it, at an end, another joint moves
    margin_pairs: int = 0  # left out beyond such an end


def comparison_segments(
    comparison: Comparison, resolution: float | None
) -> list[tuple[SweepSegment, Array]]:
    """Find where one joint turns by MIN_SPAN or more while the others stay within their noise.

    Pairs whose pose is not wholly known, or whose joint has not moved yet, are left out.
    `resolution`, rad, is the readings' last digit; None: not known. Segments in order of time, none
    of which overlaps another of its joint, each with its directions of travel (n,), +1 or -1.
    """
    whole = np.flatnonzero([known.shape[1] == 6 for known in comparison.determined])
    # what readings of a joint at rest stay within, (j,), rad
    band = np.maximum(NOISE_FACTOR * comparison.reading_noise, MIN_REST_BAND)
    band = np.maximum(band, REST_DIGITS * (resolution or 0.0))
    limits = SegmentLimits(band, MIN_SPAN, MIN_PAIRS, EDGE_SHARE, MARGIN_PAIRS)
    found = []
    for segment in find_segments(comparison.q[whole], limits):
        direction = travel_directions(segment, float(band[segment.joint]))
        rows = whole[segment.rows[direction != 0]]
        moved = SweepSegment(segment.joint, rows, comparison.q[rows])
        if len(rows) >= MIN_PAIRS and moved.span >= MIN_SPAN:
            found.append((moved, direction[direction != 0]))
    return sorted(found, key=lambda one: (int(one[0].rows[0]), one[0].joint))


def find_sweeps(readings: Readings, t: Array, frame: Index) -> tuple[list[SweepSegment], list[str]]:
    """Find where one joint moves alone, however little, and name joints that move together.

    t (n,), s: the pairs' instants on the readings' clock; `frame` (n,): their numbers, for the
    notes. Gives the segments in order of time, from the joint's first motion to its last, and what
    was left out and why, in sentences.
    """
    known = np.flatnonzero(readings.available(t))
    q = readings.at(t)[known]
    moving = np.abs(np.diff(q, axis=0)) > np.maximum(STEP_NOISE_FACTOR * readings.noise, MIN_STEP)
    rest = max(MAX_REST_TRAVEL, float(STEP_NOISE_FACTOR * readings.noise.max()))
    sweeps = []
    for found in find_segments(q, SegmentLimits(np.full(q.shape[1], rest), rest, MIN_PAIRS_FREE)):
        steps = np.flatnonzero(moving[found.rows[:-1], found.joint])
        if len(steps) and steps[-1] + 2 - steps[0] >= MIN_PAIRS_FREE:
            rows = found.rows[steps[0] : steps[-1] + 2]
            sweeps.append(SweepSegment(found.joint, known[rows], q[rows]))
    notes = []
    steps = np.flatnonzero(moving.any(axis=1))
    for joints, run in groupby(steps.tolist(), key=lambda k: tuple(np.flatnonzero(moving[k]) + 1)):
        if len(joints) > 1:
            these = list(run)
            first, last = frame[known[these[0]]], frame[known[these[-1] + 1]]
            named = " and ".join(str(j) for j in joints)
            notes.append(f"Left out: in pairs {first} to {last} joints {named} move together.")
    return sorted(sweeps, key=lambda s: (int(s.rows[0]), s.joint)), notes


def find_segments(q: Array, limits: SegmentLimits) -> list[SweepSegment]:
    """Find the segments of readings (n, joints), rad, joint by joint, the widest first."""
    rests = np.array([_rests(q[:, j], float(limits.band[j])) for j in range(q.shape[1])])
    found = []
    for joint in range(q.shape[1]):
        ends = np.delete(rests, joint, axis=0).min(axis=0, initial=len(q))
        for run in _widest(q[:, joint], ends, limits):
            rows = np.arange(*_trim_ends(q, joint, run, limits))
            found.append(SweepSegment(joint, rows, q[rows]))
    return found


def travel_directions(segment: SweepSegment, band: float) -> Array:
    """Direction of travel at each pair (n,): +1, -1, 0 before any; kept at rest.

    A joint has turned back once it left its extreme by more than `band`, and it did so from the
    first pair on that noise does not put there. A long rest, whose noise wanders far, turns nothing
    back, and of a joint that has not moved yet nothing is said.
    """
    q = segment.q[:, segment.joint]
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


def _rests(q: Array, limit: float) -> Index:
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


def _trim_ends(
    q: Array, joint: int, run: tuple[int, int], limits: SegmentLimits
) -> tuple[int, int]:
    """Leave out the ends of a run at which another joint still moves, or moves already.

    It does so below its readings' noise for a while, and the flange shows a tenth of that.
    """
    first, end = run
    others = np.delete(q[first:end], joint, axis=1)
    band = limits.edge_share * np.delete(limits.band, joint)
    still = ~np.any(np.abs(others - np.median(others, axis=0)) > band, axis=1)
    if not still.any():
        return first, first
    start, stop = first + int(np.argmax(still)), end - int(np.argmax(still[::-1]))
    margin = limits.margin_pairs
    return start + margin * (first > 0), stop - margin * (end < len(q))


def _widest(q: Array, ends: Index, limits: SegmentLimits) -> list[tuple[int, int]]:
    """Of the runs [first, ends[first]) those in which q (n,) turns far, the widest first."""

    def enough(run: tuple[int, int]) -> bool:
        long = run[1] - run[0] >= limits.min_pairs
        return long and bool(np.ptp(q[slice(*run)]) >= limits.min_span)

    before = np.concatenate([[0], ends[:-1]])
    longest = np.flatnonzero(ends > before)
    runs = [
        run for run in zip(longest.tolist(), ends[longest].tolist(), strict=True) if enough(run)
    ]
    taken: list[tuple[int, int]] = []
    for first, end in sorted(runs, key=lambda s: -float(np.ptp(q[slice(*s)]))):
        for other, last in taken:  # what is left of one beside wider ones
            if first < last and other < end:
                sides = (first, min(end, other)), (max(first, last), end)
                first, end = max(sides, key=lambda s: s[1] - s[0])
        if enough((first, end)):
            taken.append((first, end))
    return taken
