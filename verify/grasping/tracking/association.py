"""Assign the objects in view to known tracks, and keep the target apart from others of its colour.

Model: candidate c is object k at minus twice the log likelihood

    cost(k, c) = d' S^-1 d + ln det(2 pi S) - 2 ln p + (ln(A_c / A_k) / SIGMA_LOG_AREA)^2

d is the distance of c from the predicted position of k, S their common covariance, p the prior
probability of the motion hypothesis, A the areas. The assignment of least total cost is taken; an
object out of sight costs HIDDEN_COST, a new object -2 ln(density). The margin to the next best
assignment of the same candidate says how sure it is. Where two explanations are about as good,
nothing is updated, and the target counts as out of sight until it is clear again.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from verify.core.records import Array
from verify.grasping.tracking.kalman import KalmanTrack, MotionHypothesis, begin_track, distances
from verify.grasping.tracking.pairing import StereoObject
from verify.grasping.tracking.target import TrackingOptions, TrackingStatus

HIDDEN_COST = -2 * math.log(0.1)  # price of an object out of sight: one picture in ten
SIGMA_LOG_AREA = 0.2  # standard deviation of ln(area) from one view of an object to another
RELOCATION_TIME = 10.0  # s after which an object out of sight may well have been put elsewhere
MIN_COST_MARGIN = 2 * math.log(1000)  # the next best explanation is 1000 times less likely
FORBIDDEN_COST = 1e9
MEMORY_TIME = 30.0  # s for which another object is kept out of sight
SHORT_MEMORY_TIME = 0.5  # s for which a tentative one is kept out of sight
SIZE_AVERAGING_TIME = 1.0  # s over which the size of a whole target is averaged
LEARNING_AREA_RANGE = (0.8, 1.25)  # of the expected area: the size is learned from such views only
COMPLETE_AREA_RANGE = (0.88, 1.15)  # of it: with less or more the centre is not the target's
MIN_MERGED_AREA_RATIO = 1.45  # of the expected area: two objects in one patch
MAX_SINGLE_AREA_RATIO = 1.1  # of its area, with what is connected beyond its expected extent
GROWTH_TIME = 0.5  # s; another object that looks too large after that was half hidden before
MAX_SQUARED_DISTANCE = 25.0  # Mahalanobis, between measurements of an unconfirmed target
MAX_SMOOTH_SQUARED_DISTANCE = 9.0  # Mahalanobis, of what keeps the velocity it had

NOT_SEEN = "its colour is not seen"
ONLY_OTHERS_SEEN = "only another of its colour is seen"


@dataclass(frozen=True, slots=True)
class ObjectTrack:
    """An object of the target's colour: the target, or another."""

    track: KalmanTrack  # at its last measurement
    area: float  # m², when it is whole
    extent: Array  # (2,), m, width and height, when it is whole
    t: float  # s, of its last measurement
    count: int  # measurements


@dataclass(frozen=True, slots=True)
class ObjectAssignment:
    """Which candidate each object is."""

    choice: tuple[int, ...]  # for each object, the index of its candidate; -1: out of sight
    margin: tuple[float, ...]  # to the next best explanation of that candidate; inf without any
    way: tuple[MotionHypothesis | None, ...]  # for each object, its motion to that candidate

    def sure(self, known: int) -> bool:
        """Whether an object is in view for certain."""
        return self.choice[known] >= 0 and self.margin[known] >= MIN_COST_MARGIN


def associate(
    known: list[ObjectTrack], candidates: list[StereoObject], t: float, density: float
) -> ObjectAssignment:
    """Assign candidates in view at one instant t, s, to known objects.

    `density`: new objects to expect, a m³.

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
    known: ObjectTrack, candidate: StereoObject, t: float, density: float
) -> MotionHypothesis:
    """Find the likeliest way in which a candidate may be an object.

    Besides what its track says, one that was out of sight for long may have been put anywhere.
    """
    grown = math.log(candidate.area / known.area) / SIGMA_LOG_AREA
    motions = known.track.explanations(t)
    squared, volume = distances(
        [motion.track for motion in motions], candidate.place.point, candidate.spread
    )
    ways = [
        replace(motion, cost=cost + motion.cost + grown**2)
        for motion, cost in zip(motions, (squared + volume).tolist(), strict=True)
    ]
    if t > known.t:
        gone = -math.expm1(-(t - known.t) / RELOCATION_TIME)
        cost = -2 * math.log(density) - 2 * math.log(gone)
        ways.append(replace(ways[-1], cost=cost + grown**2))
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
    return float(cost[k, c]) + _solve(rest)[1]


@dataclass(frozen=True, slots=True)
class TargetDecision:
    """Whether the target is among one instant's candidates."""

    status: TrackingStatus
    reason: str
    chosen: StereoObject | None  # the candidate that is the target


class TargetIdentity:
    """Remembers the target and the others."""

    def __init__(self, options: TrackingOptions, density: float) -> None:
        self._options, self._density = options, density
        self.target: ObjectTrack | None = None  # before the first find
        self.tracked = False  # at the last pair: a window around its prediction will do
        self._others: list[ObjectTrack] = []  # confirmed: what one explains is not the target
        self._tentative: list[ObjectTrack] = []  # others in view too seldom to count
        self._again: ObjectTrack | None = None  # a lost target, in view but not confirmed

    @property
    def settled(self) -> bool:
        """Nothing else of its colour has come up that is not known well yet."""
        return not self._tentative

    def nearest(self, t: float, candidate: StereoObject) -> KalmanTrack | None:
        """The track, predicted, that a candidate continues; None where there is none."""
        known = [k for k in (self.target, self._again, *self._others, *self._tentative) if k]
        tracks = [k.track.at(t) for k in known]
        if not tracks:
            return None
        away = distances(tracks, candidate.place.point, candidate.spread)[0]
        return tracks[int(away.argmin())] if away.min() <= MAX_SMOOTH_SQUARED_DISTANCE else None

    def choose(self, t: float, candidate: StereoObject) -> None:
        """Begin with a target that a person selected."""
        self.target, self.tracked = self._new(t, candidate), True

    def step(self, t: float, candidates: list[StereoObject]) -> TargetDecision:
        """Take what is in view at an instant."""
        self._others = [o for o in self._others if t - o.t < MEMORY_TIME]
        self._tentative = [o for o in self._tentative if t - o.t < SHORT_MEMORY_TIME]
        if self.target is None:
            who = associate(self._others, candidates, t, self._density)
            self._meet_others(t, candidates, who, candidates)
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
        self.tracked = False
        if own >= 0:
            return TargetDecision(
                "occluded", "it cannot be distinguished from another of its colour", None
            )
        another = any(choice >= 0 for choice in rest.choice)
        return TargetDecision("lost", ONLY_OTHERS_SEEN if another else NOT_SEEN, None)

    def _seen(
        self, t: float, candidate: StereoObject, way: MotionHypothesis | None
    ) -> TargetDecision:
        assert self.target is not None
        assert way is not None  # it was assigned
        hidden_for = t - self.target.t
        if candidate.reach > MIN_MERGED_AREA_RATIO * self.target.area:
            self.tracked = False
            return TargetDecision("occluded", "it is seen as one with another of its colour", None)
        if way.abrupt or (not self.tracked and hidden_for > self._options.coast):
            return self._confirm(t, candidate)
        self._again = None
        self.target = self._updated(self.target, t, candidate, way.track)
        self.tracked = True
        if candidate.areas.max() > COMPLETE_AREA_RANGE[1] * self.target.area:
            return TargetDecision("occluded", "something of its colour is beside it", candidate)
        if candidate.area < COMPLETE_AREA_RANGE[0] * self.target.area:
            return TargetDecision("occluded", "a part of it is hidden", candidate)
        return TargetDecision("tracked", "", candidate)

    def _confirm(self, t: float, candidate: StereoObject) -> TargetDecision:
        """Take a lost target for found after a few measurements that agree."""
        again = self._again
        if again is not None:
            there = again.track.at(t)
            away = distances([there], candidate.place.point, candidate.spread)[0]
            near = away[0] < MAX_SQUARED_DISTANCE
            again = self._updated(again, t, candidate, there) if near else None
        assert self.target is not None
        new = replace(self._new(t, candidate), area=self.target.area, extent=self.target.extent)
        self._again = again if again is not None else new
        if self._again.count < self._options.confirm or not _is_whole(candidate, new):
            self.tracked = False
            return TargetDecision("lost", "seen where it was not expected; to be confirmed", None)
        self.target = self._again
        self._again, self.tracked = None, True
        return TargetDecision("tracked", "", candidate)

    def _search(self, t: float, candidates: list[StereoObject]) -> TargetDecision:
        """Find the target at first: one object of the colour, in view a few times, and no other."""
        if not candidates:
            return TargetDecision("searching", NOT_SEEN, None)
        now = [other for other in self._others if other.t == t]
        count = max(len(self._others), len(candidates))
        if count > 1:
            reason = f"{count} objects have this colour: select one"
            return TargetDecision("searching", reason, None)
        if not now:
            return TargetDecision("searching", "seen; to be confirmed", None)
        self.target, self.tracked, self._others = now[0], True, []
        return TargetDecision("tracked", "", candidates[0])

    def _meet_others(
        self,
        t: float,
        candidates: list[StereoObject],
        who: ObjectAssignment,
        strange: list[StereoObject],
    ) -> None:
        """Update the others, and the tentative ones by those candidates that are strange."""
        taken = [candidates[c] for c in who.choice if c >= 0]
        self._others = self._renewed(t, self._others, candidates, who)
        left = [c for c in strange if c not in taken]
        new = associate(self._tentative, left, t, self._density)
        tentative = self._renewed(t, self._tentative, left, new)
        tentative += [self._new(t, c) for i, c in enumerate(left) if i not in new.choice]
        self._others += [o for o in tentative if o.count >= self._options.confirm]
        self._tentative = [o for o in tentative if o.count < self._options.confirm]

    def _renewed(
        self,
        t: float,
        known: list[ObjectTrack],
        candidates: list[StereoObject],
        who: ObjectAssignment,
    ) -> list[ObjectTrack]:
        renewed = list(known)
        for k, (choice, way) in enumerate(zip(who.choice, who.way, strict=True)):
            if way is None or not who.sure(k):
                continue
            one, candidate = known[k], candidates[choice]
            if one.count < self._options.confirm or t - one.t > GROWTH_TIME:
                one = replace(one, area=candidate.area, extent=candidate.size)
            if candidate.reach < MIN_MERGED_AREA_RATIO * one.area:
                renewed[k] = self._updated(one, t, candidate, way.track)
        return renewed

    def _may_be_a_piece(self, candidate: StereoObject, t: float) -> bool:
        """A target that is half hidden shows pieces, which are no others."""
        assert self.target is not None
        track = self.target.track
        places = np.array([track.position, track.at(t).position])
        away = np.linalg.norm(candidate.place.point - places, axis=1)
        return float(away.min()) < math.sqrt(self.target.area)

    def _updated(
        self, known: ObjectTrack, t: float, candidate: StereoObject, track: KalmanTrack
    ) -> ObjectTrack:
        since = t - known.t
        area, extent = known.area, known.extent
        alone = candidate.reach < MAX_SINGLE_AREA_RATIO * candidate.area
        if alone and LEARNING_AREA_RANGE[0] < candidate.area / area < LEARNING_AREA_RANGE[1]:
            share = 1 - math.exp(-since / SIZE_AVERAGING_TIME)
            area += share * (candidate.area - area)
            extent = extent + share * (candidate.size - extent)
        track = track.updated(candidate.place.point, candidate.place.covariance).learned(since)
        return ObjectTrack(track, area, extent, t, known.count + 1)

    def _new(self, t: float, candidate: StereoObject) -> ObjectTrack:
        track = begin_track(
            t, candidate.place.point, candidate.place.covariance, self._options.speed
        )
        return ObjectTrack(track, candidate.area, candidate.size, t, 1)


def _is_whole(candidate: StereoObject, target: ObjectTrack) -> bool:
    least, most = COMPLETE_AREA_RANGE[0] * target.area, COMPLETE_AREA_RANGE[1] * target.area
    return candidate.area >= least and candidate.areas.max() <= most
