"""Which candidate is which known object: the likeliest assignment, and how sure it is.

A candidate costs an object its negative log likelihood, twice: how far it lies from the object's
predicted place, and how much its size differs. An object may be out of sight, a candidate may be
new; both have their price. What counts is the margin to the next best explanation: a target is
taken for seen only where nothing else explains the candidate nearly as well.

Keeping a target apart from everything else of its colour.

The others are tracked as well: what another object explains is never the target. Where two
explanations are about as good, nobody is updated; the target counts as out of sight until it is
clear again.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from verify.core.records import Array
from verify.grasping.tracking.kalman import KalmanTrack, begin_track
from verify.grasping.tracking.target import TrackingOptions, TrackingStatus

HIDDEN_COST = -2 * math.log(0.1)  # price of an object out of sight: one picture in ten
SIGMA_LOG_AREA = 0.2  # standard deviation of ln(area) from one view of an object to another
RELOCATION_TIME = 10.0  # s after which a thing out of sight may well have been put somewhere else
MIN_COST_MARGIN = 2 * math.log(1000)  # the next best explanation is a thousand times less likely
FORBIDDEN_COST = 1e9


@dataclass(frozen=True, slots=True)
class ObjectTrack:
    """An object of the target's colour: the target, or another."""

    track: KalmanTrack  # as of the last sight
    area: float  # m² or px², as it looks when it is whole
    extent: Array  # (2,), m or px, width and height, likewise
    seen: float  # s, when it was seen last
    count: int  # how often


@dataclass(frozen=True, slots=True)
class ObjectCandidate:
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
class TrackHypothesis:
    """How an object may have come to be where a candidate is."""

    track: KalmanTrack  # predicted to the candidate's instant
    abrupt: bool  # only a push explains it
    cost: float  # minus twice the log likelihood of place and size


@dataclass(frozen=True, slots=True)
class ObjectAssignment:
    """Who is who."""

    choice: tuple[int, ...]  # for each object, its candidate's place in the list; -1: out of sight
    margin: tuple[float, ...]  # to the next best explanation of that candidate; inf without any
    way: tuple[TrackHypothesis | None, ...]  # for each object, what it did if that candidate is it

    def sure(self, known: int) -> bool:
        """Whether an object is seen for certain."""
        return self.choice[known] >= 0 and self.margin[known] >= MIN_COST_MARGIN


def associate(
    known: list[ObjectTrack], candidates: list[ObjectCandidate], t: float, density: float
) -> ObjectAssignment:
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
        return ObjectAssignment((-1,) * len(known), (math.inf,) * len(known), (None,) * len(known))
    new = -2 * math.log(density)
    ways = [[best_hypothesis(k, c, t, density) for c in candidates] for k in known]
    cost = np.array([[way.cost - new for way in row] for row in ways])
    choice, best = _solve(cost)
    margins = [
        math.inf if c < 0 else _next_best_cost(cost, k, c) - best for k, c in enumerate(choice)
    ]
    taken = [None if c < 0 else ways[k][c] for k, c in enumerate(choice)]
    return ObjectAssignment(tuple(choice), tuple(margins), tuple(taken))


def best_hypothesis(
    known: ObjectTrack, candidate: ObjectCandidate, t: float, density: float
) -> TrackHypothesis:
    """Find the likeliest way in which a candidate may be an object.

    Besides what its track says, one that was out of sight for long may have been put anywhere.
    """
    grown = math.log(candidate.area / known.area) / SIGMA_LOG_AREA
    spread = candidate.covariance + candidate.systematic
    ways = []
    for explanation in known.track.explanations(t):
        squared, volume = explanation.track.distance(candidate.position, spread)
        cost = squared + volume - 2 * math.log(explanation.prior)
        ways.append(TrackHypothesis(explanation.track, explanation.abrupt, cost + grown**2))
    if t > known.seen:
        gone = -math.expm1(-(t - known.seen) / RELOCATION_TIME)
        cost = -2 * math.log(density) - 2 * math.log(gone)
        ways.append(TrackHypothesis(ways[-1].track, True, cost + grown**2))
    return min(ways, key=lambda way: way.cost)


def _solve(cost: Array) -> tuple[list[int], float]:
    objects, candidates = cost.shape
    hidden = np.full((objects, objects), FORBIDDEN_COST)
    np.fill_diagonal(hidden, HIDDEN_COST)
    table = np.hstack([cost, hidden])
    rows, columns = linear_sum_assignment(table)
    choice = [int(c) if c < candidates else -1 for c in columns]
    return choice, float(table[rows, columns].sum())


def _next_best_cost(cost: Array, k: int, c: int) -> float:
    """The cheapest explanation that gives object k another candidate, or c another object."""
    objects, candidates = cost.shape
    totals = [_forced_cost(cost, k, other) for other in range(candidates) if other != c]
    totals += [_forced_cost(cost, other, c) for other in range(objects) if other != k]
    return min(totals, default=math.inf)


def _forced_cost(cost: Array, k: int, c: int) -> float:
    """The cheapest explanation in which object k is candidate c."""
    rest = np.delete(np.delete(cost, k, axis=0), c, axis=1)
    if not rest.shape[0]:
        return float(cost[k, c])
    return float(cost[k, c]) + _solve(rest)[1]


MEMORY_TIME = 30.0  # s for which another object is kept in mind out of sight
SHORT_MEMORY_TIME = 0.5  # s, likewise one that was hardly seen
SIZE_AVERAGING_TIME = 1.0  # s over which the size of a whole target is averaged
LEARNING_AREA_RANGE = (0.8, 1.25)  # of the expected area: the size is learned from such views only
COMPLETE_AREA_RANGE = (
    0.88,
    1.15,
)  # of it: with less in view, or more, the centre is not the target's
CERTAIN_AREA_RANGE = 0.9, 1.1  # of it: no doubt about the centre
MIN_MERGED_AREA_RATIO = 1.45  # of the expected area: two objects seen as one
MAX_SINGLE_AREA_RATIO = (
    1.1  # of its area: whatever hangs together with it beyond its expected extent
)
GROWTH_TIME = (
    0.5  # s after which another object that looks too large has been met half hidden before
)
MAX_SQUARED_DISTANCE = (
    25.0  # squared Mahalanobis distance between two sights of an unconfirmed target
)
MAX_SMOOTH_SQUARED_DISTANCE = 9.0  # likewise, of what goes on with the velocity it had

NOT_SEEN = "its colour is not seen"
ONLY_OTHERS_SEEN = "only another of its colour is seen"


@dataclass(frozen=True, slots=True)
class TargetDecision:
    """What one instant's candidates say of the target."""

    status: TrackingStatus
    reason: str
    chosen: int | None  # index of the candidate that is the target


class TargetIdentity:
    """Remembers the target and the others.

    Args:
        options: for how long, how sure.
        density: new objects a unit of space (m³ or px²).
        speed: m/s or px/s, standard deviation of velocities.
    """

    def __init__(self, options: TrackingOptions, density: float, speed: float) -> None:
        self._options, self._density, self._speed = options, density, speed
        self.target: ObjectTrack | None = None
        self._found = False
        self._others: list[ObjectTrack] = []
        self._tentative: list[ObjectTrack] = []  # others, seen too seldom to count
        self._again: ObjectTrack | None = None  # a lost target, seen but not confirmed

    @property
    def tracked(self) -> bool:
        """The target was seen last time: a window around its prediction will do."""
        return self._found

    @property
    def settled(self) -> bool:
        """Nothing else of its colour has come up that is not known well yet."""
        return not self._tentative

    def predicted(self, t: float) -> KalmanTrack | None:
        """Where the target should be; None before it was ever found."""
        return None if self.target is None else self.target.track.at(t)

    def others(self, t: float) -> list[KalmanTrack]:
        """Where the others should be."""
        return [other.track.at(t) for other in self._others]

    def nearest(self, t: float, candidate: ObjectCandidate) -> KalmanTrack | None:
        """The track, predicted, that a candidate continues; None where there is none."""
        known = [k for k in (self.target, self._again, *self._others, *self._tentative) if k]
        tracks = [k.track.at(t) for k in known]
        spread = candidate.covariance + candidate.systematic
        distances = [track.distance(candidate.position, spread)[0] for track in tracks]
        if not distances or min(distances) > MAX_SMOOTH_SQUARED_DISTANCE:
            return None
        return tracks[distances.index(min(distances))]

    def choose(self, t: float, candidate: ObjectCandidate) -> None:
        """Begin with a target that a person selected."""
        self.target = self._new(t, candidate)
        self._found = True

    def step(self, t: float, candidates: list[ObjectCandidate]) -> TargetDecision:
        """Take in what was seen at an instant."""
        self._others = [o for o in self._others if t - o.seen < MEMORY_TIME]
        self._tentative = [o for o in self._tentative if t - o.seen < SHORT_MEMORY_TIME]
        if self.target is None:
            self._meet_others(t, candidates, associate(self._others, candidates, t, self._density))
            return self._search(t, candidates)
        who = associate([self.target, *self._others], candidates, t, self._density)
        rest = ObjectAssignment(who.choice[1:], who.margin[1:], who.way[1:])
        own = who.choice[0]
        strange = [c for i, c in enumerate(candidates) if i != own]
        if not (who.sure(0) and _is_whole(candidates[own], self.target)):
            strange = [c for c in strange if not self._may_be_a_piece(c, t)]
        self._meet_others(t, candidates, rest, strange)
        if who.sure(0):
            return self._seen(t, candidates[own], who.way[0])
        self._again = None
        self._found = False
        if own >= 0:
            return TargetDecision("occluded", "it cannot be told from another of its colour", None)
        another = any(choice >= 0 for choice in rest.choice)
        return TargetDecision("lost", ONLY_OTHERS_SEEN if another else NOT_SEEN, None)

    def _seen(
        self, t: float, candidate: ObjectCandidate, way: TrackHypothesis | None
    ) -> TargetDecision:
        assert self.target is not None
        assert way is not None  # it was assigned
        hidden_for = t - self.target.seen
        if candidate.reach > MIN_MERGED_AREA_RATIO * self.target.area:
            self._found = False
            return TargetDecision("occluded", "it is seen as one with another of its colour", None)
        if way.abrupt or (not self._found and hidden_for > self._options.coast):
            return self._confirm(t, candidate)
        self._again = None
        self.target = self._updated(self.target, t, candidate, way.track)
        self._found = True
        if candidate.largest > COMPLETE_AREA_RANGE[1] * self.target.area:
            return TargetDecision(
                "occluded", "something of its colour is beside it", candidate.index
            )
        if candidate.area < COMPLETE_AREA_RANGE[0] * self.target.area:
            return TargetDecision("occluded", "a part of it is hidden", candidate.index)
        return TargetDecision("tracked", "", candidate.index)

    def _confirm(self, t: float, candidate: ObjectCandidate) -> TargetDecision:
        """See a lost target a few times at places that agree before it is believed."""
        again = self._again
        if again is not None:
            there = again.track.at(t)
            spread = candidate.covariance + candidate.systematic
            near = there.distance(candidate.position, spread)[0] < MAX_SQUARED_DISTANCE
            again = self._updated(again, t, candidate, there) if near else None
        assert self.target is not None
        new = replace(self._new(t, candidate), area=self.target.area, extent=self.target.extent)
        self._again = again if again is not None else new
        if self._again.count < self._options.confirm or not _is_whole(candidate, new):
            self._found = False
            return TargetDecision("lost", "seen where it was not expected; to be confirmed", None)
        self.target = self._again
        self._again, self._found = None, True
        return TargetDecision("tracked", "", candidate.index)

    def _search(self, t: float, candidates: list[ObjectCandidate]) -> TargetDecision:
        """Before the first find: one object of the colour, seen a few times, and no other."""
        if not candidates:
            return TargetDecision("searching", NOT_SEEN, None)
        now = [other for other in self._others if other.seen == t]
        count = max(len(self._others), len(candidates))
        if count > 1:
            return TargetDecision(
                "searching", f"{count} objects have this colour: select one", None
            )
        if not now:
            return TargetDecision("searching", "seen; to be confirmed", None)
        self.target, self._found, self._others = now[0], True, []
        return TargetDecision("tracked", "", candidates[0].index)

    def _meet_others(
        self,
        t: float,
        candidates: list[ObjectCandidate],
        who: ObjectAssignment,
        strange: list[ObjectCandidate] | None = None,
    ) -> None:
        """Update the others, and those not seen often enough yet to be called so."""
        taken = {candidates[c].index for c in who.choice if c >= 0}
        self._others = self._renewed(t, self._others, candidates, who)
        left = [c for c in (candidates if strange is None else strange) if c.index not in taken]
        new = associate(self._tentative, left, t, self._density)
        tentative = self._renewed(t, self._tentative, left, new)
        tentative += [self._new(t, c) for i, c in enumerate(left) if i not in new.choice]
        self._others += [o for o in tentative if o.count >= self._options.confirm]
        self._tentative = [o for o in tentative if o.count < self._options.confirm]

    def _renewed(
        self,
        t: float,
        known: list[ObjectTrack],
        candidates: list[ObjectCandidate],
        who: ObjectAssignment,
    ) -> list[ObjectTrack]:
        renewed = list(known)
        for k, (choice, way) in enumerate(zip(who.choice, who.way, strict=True)):
            if way is None or not who.sure(k):
                continue
            one, seen = known[k], candidates[choice]
            if one.count < self._options.confirm or t - one.seen > GROWTH_TIME:
                one = replace(one, area=seen.area, extent=seen.extent)
            if seen.reach < MIN_MERGED_AREA_RATIO * one.area:
                renewed[k] = self._updated(one, t, seen, way.track)
        return renewed

    def _may_be_a_piece(self, candidate: ObjectCandidate, t: float) -> bool:
        """A target that is half hidden shows pieces, which are no others."""
        assert self.target is not None
        track = self.target.track
        away = [
            np.linalg.norm(candidate.position - p) for p in (track.position, track.at(t).position)
        ]
        return float(min(away)) < math.sqrt(self.target.area)

    def _updated(
        self, known: ObjectTrack, t: float, candidate: ObjectCandidate, track: KalmanTrack
    ) -> ObjectTrack:
        since = t - known.seen
        area, extent = known.area, known.extent
        alone = candidate.reach < MAX_SINGLE_AREA_RATIO * candidate.area
        if alone and LEARNING_AREA_RANGE[0] < candidate.area / area < LEARNING_AREA_RANGE[1]:
            share = 1 - math.exp(-since / SIZE_AVERAGING_TIME)
            area += share * (candidate.area - area)
            extent = extent + share * (candidate.extent - extent)
        track = track.updated(candidate.position, candidate.covariance).learned(since)
        return ObjectTrack(track, area, extent, t, known.count + 1)

    def _new(self, t: float, candidate: ObjectCandidate) -> ObjectTrack:
        track = begin_track(t, candidate.position, candidate.covariance, self._speed)
        return ObjectTrack(track, candidate.area, candidate.extent, t, 1)


def centre_uncertainty_ratio(ratio: float) -> float:
    """By how much of its extent a patch's centre may miss the target's, one standard deviation.

    Args:
        ratio: the patch's area over the target's. What lacks, or is too much, is all at one side.
    """
    return max(CERTAIN_AREA_RANGE[0] - ratio, ratio - CERTAIN_AREA_RANGE[1], 0.0)


def _is_whole(candidate: ObjectCandidate, target: ObjectTrack) -> bool:
    least, most = COMPLETE_AREA_RANGE[0] * target.area, COMPLETE_AREA_RANGE[1] * target.area
    return candidate.area >= least and candidate.largest <= most
