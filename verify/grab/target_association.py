"""Which candidate is which known object: the likeliest assignment, and how sure it is.

A candidate costs an object its negative log likelihood, twice: how far it lies from the object's
predicted place, and how much its size differs. An object may be out of sight, a candidate may be
new; both have their price. What counts is the margin to the next best explanation: a target is
taken for seen only where nothing else explains the candidate nearly as well.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from verify.grab.track3d import Track
from verify.records import Array

HIDDEN = -2 * math.log(0.1)  # price of an object out of sight: one picture in ten
SIZE_SPREAD = 0.2  # standard deviation of ln(area) from one view of an object to another
ANYWHERE = 10.0  # s after which a thing out of sight may well have been put somewhere else
MARGIN = 2 * math.log(1000)  # the next best explanation is a thousand times less likely
FORBIDDEN = 1e9


@dataclass(frozen=True, slots=True)
class Known:
    """An object of the target's colour: the target, or another."""

    track: Track  # as of the last sight
    area: float  # m² or px², as it looks when it is whole
    extent: Array  # (2,), m or px, width and height, likewise
    seen: float  # s, when it was seen last
    count: int  # how often


@dataclass(frozen=True, slots=True)
class Candidate:
    """What may be an object: a place and a size, with what they are known to."""

    position: Array  # (d,), m or px
    covariance: Array  # (d, d), of what varies from one instant to the next
    systematic: Array  # (d, d), of what does not
    area: float  # m² or px², the smaller of two pictures'
    largest: float  # m² or px², the larger
    reach: float  # m² or px², with what hangs together with it
    extent: Array  # (2,), m or px, width and height
    index: int  # the caller's


@dataclass(frozen=True, slots=True)
class Way:
    """How an object may have come to be where a candidate is."""

    track: Track  # predicted to the candidate's instant
    abrupt: bool  # only a push explains it
    cost: float  # minus twice the log likelihood of place and size


@dataclass(frozen=True, slots=True)
class Assignment:
    """Who is who."""

    choice: tuple[int, ...]  # for each object, its candidate's place in the list; -1: out of sight
    margin: tuple[float, ...]  # to the next best explanation of that candidate; inf without any
    way: tuple[Way | None, ...]  # for each object, what it did if that candidate is it

    def sure(self, known: int) -> bool:
        """Whether an object is seen for certain."""
        return self.choice[known] >= 0 and self.margin[known] >= MARGIN


def associate(
    known: list[Known], candidates: list[Candidate], t: float, density: float
) -> Assignment:
    """Assign candidates to objects.

    Args:
        known: objects.
        candidates: what was seen at one instant.
        t: s, that instant.
        density: how many new objects to expect a unit of space (m³ or px²).

    Source: the global nearest neighbour, Blackman and Popoli, Design and Analysis of Modern
    Tracking Systems, 1999, sec. 6.4.
    """
    if not known or not candidates:
        return Assignment((-1,) * len(known), (math.inf,) * len(known), (None,) * len(known))
    new = -2 * math.log(density)
    ways = [[explain(k, c, t, density) for c in candidates] for k in known]
    cost = np.array([[way.cost - new for way in row] for row in ways])
    choice, best = _solve(cost)
    margins = [math.inf if c < 0 else _next_best(cost, k, c) - best for k, c in enumerate(choice)]
    taken = [None if c < 0 else ways[k][c] for k, c in enumerate(choice)]
    return Assignment(tuple(choice), tuple(margins), tuple(taken))


def explain(known: Known, candidate: Candidate, t: float, density: float) -> Way:
    """Find the likeliest way in which a candidate may be an object.

    Besides what its track says, one that was out of sight for long may have been put anywhere.
    """
    grown = math.log(candidate.area / known.area) / SIZE_SPREAD
    spread = candidate.covariance + candidate.systematic
    ways = []
    for explanation in known.track.explanations(t):
        squared, volume = explanation.track.distance(candidate.position, spread)
        cost = squared + volume - 2 * math.log(explanation.prior)
        ways.append(Way(explanation.track, explanation.abrupt, cost + grown**2))
    if t > known.seen:
        gone = -math.expm1(-(t - known.seen) / ANYWHERE)
        cost = -2 * math.log(density) - 2 * math.log(gone)
        ways.append(Way(ways[-1].track, True, cost + grown**2))
    return min(ways, key=lambda way: way.cost)


def _solve(cost: Array) -> tuple[list[int], float]:
    objects, candidates = cost.shape
    hidden = np.full((objects, objects), FORBIDDEN)
    np.fill_diagonal(hidden, HIDDEN)
    table = np.hstack([cost, hidden])
    rows, columns = linear_sum_assignment(table)
    choice = [int(c) if c < candidates else -1 for c in columns]
    return choice, float(table[rows, columns].sum())


def _next_best(cost: Array, k: int, c: int) -> float:
    """The cheapest explanation that gives object k another candidate, or c another object."""
    objects, candidates = cost.shape
    totals = [_forced(cost, k, other) for other in range(candidates) if other != c]
    totals += [_forced(cost, other, c) for other in range(objects) if other != k]
    return min(totals, default=math.inf)


def _forced(cost: Array, k: int, c: int) -> float:
    """The cheapest explanation in which object k is candidate c."""
    rest = np.delete(np.delete(cost, k, axis=0), c, axis=1)
    if not rest.shape[0]:
        return float(cost[k, c])
    return float(cost[k, c]) + _solve(rest)[1]
