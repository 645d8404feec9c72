"""Keeping a target apart from everything else of its colour.

The others are tracked as well: what another object explains is never the target. Where two
explanations are about as good, nobody is updated; the target counts as out of sight until it is
clear again.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from verify.grab.target import Options, Status
from verify.grab.target_association import Assignment, Candidate, Known, Way, associate
from verify.grab.track3d import Track, begin

REMEMBERED = 30.0  # s for which another object is kept in mind out of sight
PASSING = 0.5  # s, likewise one that was hardly seen
LEARNING = 1.0  # s over which the size of a whole target is averaged
WHOLE = (0.8, 1.25)  # of the expected area: the size is learned from such views only
SEEN_WHOLE = 0.88, 1.15  # of it: with less in view, or more, the centre is not the target's
CERTAIN = 0.9, 1.1  # of it: no doubt about the centre
MERGED = 1.45  # of the expected area: two objects seen as one
ALONE_WITHIN = 1.1  # of its area: whatever hangs together with it beyond its expected extent
GROWS = 0.5  # s after which another object that looks too large has been met half hidden before
AGREES = 25.0  # squared Mahalanobis distance between two sights of an unconfirmed target
SMOOTHLY = 9.0  # likewise, of what goes on with the velocity it had

NOTHING = "its colour is not seen"
BESIDE = "only another of its colour is seen"


@dataclass(frozen=True, slots=True)
class Verdict:
    """What one instant's candidates say of the target."""

    status: Status
    reason: str
    chosen: int | None  # index of the candidate that is the target


class Identity:
    """Remembers the target and the others.

    Args:
        options: for how long, how sure.
        density: new objects a unit of space (m³ or px²).
        speed: m/s or px/s, standard deviation of velocities.
    """

    def __init__(self, options: Options, density: float, speed: float) -> None:
        self._options, self._density, self._speed = options, density, speed
        self.target: Known | None = None
        self._found = False
        self._others: list[Known] = []
        self._tentative: list[Known] = []  # others, seen too seldom to count
        self._again: Known | None = None  # a lost target, seen but not confirmed

    @property
    def tracked(self) -> bool:
        """The target was seen last time: a window around its prediction will do."""
        return self._found

    @property
    def settled(self) -> bool:
        """Nothing else of its colour has come up that is not known well yet."""
        return not self._tentative

    def predicted(self, t: float) -> Track | None:
        """Where the target should be; None before it was ever found."""
        return None if self.target is None else self.target.track.at(t)

    def others(self, t: float) -> list[Track]:
        """Where the others should be."""
        return [other.track.at(t) for other in self._others]

    def nearest(self, t: float, candidate: Candidate) -> Track | None:
        """The track, predicted, that a candidate continues; None where there is none."""
        known = [k for k in (self.target, self._again, *self._others, *self._tentative) if k]
        tracks = [k.track.at(t) for k in known]
        spread = candidate.covariance + candidate.systematic
        distances = [track.distance(candidate.position, spread)[0] for track in tracks]
        if not distances or min(distances) > SMOOTHLY:
            return None
        return tracks[distances.index(min(distances))]

    def choose(self, t: float, candidate: Candidate) -> None:
        """Begin with a target that a person selected."""
        self.target = self._new(t, candidate)
        self._found = True

    def step(self, t: float, candidates: list[Candidate]) -> Verdict:
        """Take in what was seen at an instant."""
        self._others = [o for o in self._others if t - o.seen < REMEMBERED]
        self._tentative = [o for o in self._tentative if t - o.seen < PASSING]
        if self.target is None:
            self._meet_others(t, candidates, associate(self._others, candidates, t, self._density))
            return self._search(t, candidates)
        who = associate([self.target, *self._others], candidates, t, self._density)
        rest = Assignment(who.choice[1:], who.margin[1:], who.way[1:])
        own = who.choice[0]
        strange = [c for i, c in enumerate(candidates) if i != own]
        if not (who.sure(0) and _whole(candidates[own], self.target)):
            strange = [c for c in strange if not self._may_be_a_piece(c, t)]
        self._meet_others(t, candidates, rest, strange)
        if who.sure(0):
            return self._seen(t, candidates[own], who.way[0])
        self._again = None
        self._found = False
        if own >= 0:
            return Verdict("occluded", "it cannot be told from another of its colour", None)
        another = any(choice >= 0 for choice in rest.choice)
        return Verdict("lost", BESIDE if another else NOTHING, None)

    def _seen(self, t: float, candidate: Candidate, way: Way | None) -> Verdict:
        assert self.target is not None
        assert way is not None  # it was assigned
        hidden_for = t - self.target.seen
        if candidate.reach > MERGED * self.target.area:
            self._found = False
            return Verdict("occluded", "it is seen as one with another of its colour", None)
        if way.abrupt or (not self._found and hidden_for > self._options.coast):
            return self._confirm(t, candidate)
        self._again = None
        self.target = self._updated(self.target, t, candidate, way.track)
        self._found = True
        if candidate.largest > SEEN_WHOLE[1] * self.target.area:
            return Verdict("occluded", "something of its colour is beside it", candidate.index)
        if candidate.area < SEEN_WHOLE[0] * self.target.area:
            return Verdict("occluded", "a part of it is hidden", candidate.index)
        return Verdict("tracked", "", candidate.index)

    def _confirm(self, t: float, candidate: Candidate) -> Verdict:
        """See a lost target a few times at places that agree before it is believed."""
        again = self._again
        if again is not None:
            there = again.track.at(t)
            spread = candidate.covariance + candidate.systematic
            near = there.distance(candidate.position, spread)[0] < AGREES
            again = self._updated(again, t, candidate, there) if near else None
        assert self.target is not None
        new = replace(self._new(t, candidate), area=self.target.area, extent=self.target.extent)
        self._again = again if again is not None else new
        if self._again.count < self._options.confirm or not _whole(candidate, new):
            self._found = False
            return Verdict("lost", "seen where it was not expected; to be confirmed", None)
        self.target = self._again
        self._again, self._found = None, True
        return Verdict("tracked", "", candidate.index)

    def _search(self, t: float, candidates: list[Candidate]) -> Verdict:
        """Before the first find: one object of the colour, seen a few times, and no other."""
        if not candidates:
            return Verdict("searching", NOTHING, None)
        now = [other for other in self._others if other.seen == t]
        count = max(len(self._others), len(candidates))
        if count > 1:
            return Verdict("searching", f"{count} objects have this colour: select one", None)
        if not now:
            return Verdict("searching", "seen; to be confirmed", None)
        self.target, self._found, self._others = now[0], True, []
        return Verdict("tracked", "", candidates[0].index)

    def _meet_others(
        self,
        t: float,
        candidates: list[Candidate],
        who: Assignment,
        strange: list[Candidate] | None = None,
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
        self, t: float, known: list[Known], candidates: list[Candidate], who: Assignment
    ) -> list[Known]:
        renewed = list(known)
        for k, (choice, way) in enumerate(zip(who.choice, who.way, strict=True)):
            if way is None or not who.sure(k):
                continue
            one, seen = known[k], candidates[choice]
            if one.count < self._options.confirm or t - one.seen > GROWS:
                one = replace(one, area=seen.area, extent=seen.extent)
            if seen.reach < MERGED * one.area:
                renewed[k] = self._updated(one, t, seen, way.track)
        return renewed

    def _may_be_a_piece(self, candidate: Candidate, t: float) -> bool:
        """A target that is half hidden shows pieces, which are no others."""
        assert self.target is not None
        track = self.target.track
        away = [
            np.linalg.norm(candidate.position - p) for p in (track.position, track.at(t).position)
        ]
        return float(min(away)) < math.sqrt(self.target.area)

    def _updated(self, known: Known, t: float, candidate: Candidate, track: Track) -> Known:
        since = t - known.seen
        area, extent = known.area, known.extent
        alone = candidate.reach < ALONE_WITHIN * candidate.area
        if alone and WHOLE[0] < candidate.area / area < WHOLE[1]:
            share = 1 - math.exp(-since / LEARNING)
            area += share * (candidate.area - area)
            extent = extent + share * (candidate.extent - extent)
        track = track.updated(candidate.position, candidate.covariance).learned(since)
        return Known(track, area, extent, t, known.count + 1)

    def _new(self, t: float, candidate: Candidate) -> Known:
        track = begin(t, candidate.position, candidate.covariance, self._speed)
        return Known(track, candidate.area, candidate.extent, t, 1)


def lacking(ratio: float) -> float:
    """By how much of its extent a patch's centre may miss the target's, one standard deviation.

    Args:
        ratio: the patch's area over the target's. What lacks, or is too much, is all at one side.
    """
    return max(CERTAIN[0] - ratio, ratio - CERTAIN[1], 0.0)


def _whole(candidate: Candidate, target: Known) -> bool:
    least, most = SEEN_WHOLE[0] * target.area, SEEN_WHOLE[1] * target.area
    return candidate.area >= least and candidate.largest <= most
