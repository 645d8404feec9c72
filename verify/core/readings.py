"""A robot's joint readings as functions of time: value, speed, direction, uncertainty."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from verify.core.kernels import entries as kernel
from verify.core.records import Array, Flags
from verify.core.statistics import MAD_TO_SIGMA

# Between readings further apart than this the motion is not known: single visits, logged in bursts.
MAX_GAP = 0.6  # s; readings at 2 Hz still pass
RATE_SPAN = 0.05  # s: shorter differences of readings are noise, longer ones blur the motion
DIFFERENCE_VARIANCES = (6.0, 20.0, 70.0)  # of white noise's second to fourth ones, over its own
ROUGH_ROWS = 16  # of a stretch that is looked at by itself
ROUGH_RATIO = 4.0  # of its noise to the log's; chance makes it twice
MIN_DIFFERENCES = 8  # fewer show no spread
HOLD_TIME = 0.5  # s: at the edge of a burst at rest the arm is taken as standing still for so long
MIN_STAMPS = 12  # readings of moving joints; fewer do not show whether joints are late together
MIN_TOGETHER = 0.75  # of them: less is little beside the noise; half are by chance
MIN_VALUES = 8  # of a joint: fewer may be as far apart by chance
TOL_STEP = 1e-7  # rad: less is rounding
MAX_STEP_ERROR = 0.05  # of a step
STAMPS_SIGMA = 3.5  # from chance
CHI2_MEDIAN = 0.4549  # of one degree of freedom
MIN_TRAVEL = np.deg2rad(0.02)  # the last digit or two of a common read-out
MIN_TRIED = 8  # gaps of one length; fewer do not show what is missed in them
MISSED_SHARE = 0.99  # quantile of what is


@dataclass(frozen=True)
class Readings:
    """Joint readings on the controller's clock, interpolated.

    Cubic between four readings (Catmull-Rom): a straight line would cut the corner by an eighth
    of acceleration times interval squared, 0.1° for a brisk joint read at 10 Hz.
    """

    t: Array  # (m,), s, increasing
    q: Array  # (m, joints), rad
    longest: float = MAX_GAP  # s, between readings that are interpolated

    @classmethod
    def of_log(cls, t: Array, q: Array) -> "Readings":
        """A whole log, interpolated where the curve does not miss its motion.

        Where intervals are longer than usual, rows are taken out of the log itself, more and more
        of them, until the curve is farther from them than noise and last digit explain.
        """
        log, apart, good = cls(t, q), np.diff(t), 0
        usual = float(np.median(apart)) if len(apart) else MAX_GAP
        counts = np.unique(np.geomspace(2, max(MAX_GAP / usual, 2), 16).astype(int)).tolist()
        for count in counts if np.any(apart > 1.5 * usual) and 2 * usual < MAX_GAP else ():
            missed = log._missed(count, 1.5 * count * usual)
            if len(missed) < MIN_TRIED * (count - 1):
                break
            off = np.quantile(missed, MISSED_SHARE, axis=0)
            if np.any(off > np.maximum(log.resolved, 2 * log.step)):
                good = max(good, 1)
                break
            good = count
        return replace(log, longest=min((good + 0.5) * usual, MAX_GAP)) if good else log

    def _missed(self, count: int, widest: float) -> Array:
        """How far the curve is from the rows it leaves out, `count` - 1 after every two, rad."""
        kept = np.arange(len(self.t)) % (count + 1) < 2
        t = self.t[kept]
        inside = np.diff(t, append=np.inf)[np.searchsorted(t, self.t[~kept]) - 1] <= widest
        left_out = np.flatnonzero(~kept)[inside]
        curve = kernel.interpolate(t, self.q[kept], np.inf, self.t[left_out])
        return np.asarray(np.abs(curve - self.q[left_out]))

    def available(self, t: Array) -> Flags:
        """Whether there are values at the instants t (n,): between readings, or held at rest.

        In a gap there are within HOLD_TIME of a burst whose readings show the arm at rest (or of a
        single reading: a visit). Where the arm moves and the readings stop, there is none.
        """
        # readings stand at both sides, no gap between them
        available: Flags = self._without_gap[self.t.searchsorted(t)] | (t == self.t[0])
        if np.count_nonzero(available) == len(available):
            return available
        gaps = np.flatnonzero(~available & (t >= self.t[0]) & (t <= self.t[-1]))
        if len(gaps):
            after = np.searchsorted(self.t, t[gaps])
            since, until = t[gaps] - self.t[after - 1], self.t[after] - t[gaps]
            nearest = np.where(since < until, after - 1, after)
            available[gaps] = (np.minimum(since, until) <= HOLD_TIME) & self._at_rest[nearest]
        return available

    def instants(self, step: float) -> Array:
        """Instants so many s apart wherever there are readings, (g,) s."""
        bursts = np.split(self.t, np.flatnonzero(np.diff(self.t) > self.longest) + 1)
        return np.concatenate([np.arange(b[0], b[-1] + step, step) for b in bursts])

    @cached_property
    def _without_gap(self) -> Flags:
        """Whether readings are known before each one, and after the last, (m + 1,).

        Not in a gap that a log's arm moves in, nor, if it does there, in the interval beside one:
        the speed at that end is not known.
        """
        apart = np.diff(self.t, prepend=-np.inf, append=np.inf)
        gap: Flags = apart > self.longest
        if self.longest < MAX_GAP:
            moves = np.any(np.abs(np.diff(self.q, axis=0)) > self.resolved, axis=1)
            inner = gap[1:-1] & (moves | (apart[1:-1] > MAX_GAP))
            beside = np.convolve(inner, [1, 0, 1], "same") > 0
            gap[1:-1] = inner | (beside & moves)
        return ~gap

    @cached_property
    def resolved(self) -> Array:
        """Travel that noise and last digit do not explain, (joints,), rad."""
        return np.asarray(np.maximum(5 * self.noise, MIN_TRAVEL))

    @cached_property
    def _at_rest(self) -> Flags:
        """Whether the arm stood still at a reading beside a gap, as its burst shows, (m,)."""
        gaps = np.flatnonzero(np.diff(self.t) > self.longest)
        rests: Flags = np.zeros(len(self.t), dtype=np.bool_)
        for first, last in zip([0, *(gaps + 1)], [*gaps, len(self.t) - 1], strict=True):
            burst = slice(first, last + 1)
            for edge in (first, last):
                near = np.abs(self.t[burst] - self.t[edge]) <= HOLD_TIME
                rests[edge] = np.all(np.abs(self.q[burst][near] - self.q[edge]) <= self.resolved)
        return rests

    def at(self, t: Array) -> Array:
        """Readings at the instants t (n,), rad, (n, joints); held outside a burst of readings."""
        if len(self.t) < 2:
            return np.repeat(self.q, len(t), axis=0)
        return kernel.interpolate(*self._contiguous, self.longest, t)

    def motion(self, t: Array) -> tuple[Array, Array]:
        """Readings and joint speeds at the instants t (n,), rad and rad/s, (n, joints).

        Readings as by `at`. Speeds are those over twice RATE_SPAN; 0 in a gap.
        """
        if len(self.t) < 2:
            return self.at(t), np.zeros((len(t), self.q.shape[1]))
        known = self._without_gap
        return kernel.sample_motion(*self._contiguous, self.longest, known, RATE_SPAN, t)

    @cached_property
    def _contiguous(self) -> tuple[Array, Array]:
        """Times and readings as the kernels take them without a copy at every call."""
        return np.ascontiguousarray(self.t), np.ascontiguousarray(self.q)

    @cached_property
    def noise(self) -> Array:
        """Standard deviation of one reading, (joints,), rad, from the readings' own differences.

        The smallest of the estimates from second to fourth differences: motion that a low order
        mistakes for noise, a higher one removes. Those across a gap are motion and do not count.
        """
        smallest: Array = np.full(self.q.shape[1], np.inf)
        whole, steps = np.diff(self.t) <= MAX_GAP, np.diff(self.q, axis=0)
        for variance in DIFFERENCE_VARIANCES:
            whole, steps = whole[1:] & whole[:-1], np.diff(steps, axis=0)
            if np.count_nonzero(whole) > MIN_DIFFERENCES:
                size = np.median(np.abs(steps[whole]), axis=0)
                smallest = np.minimum(smallest, MAD_TO_SIGMA * size / np.sqrt(variance))
        return np.where(np.isfinite(smallest), smallest, 0.0)

    def noise_at(self, t: Array) -> Array:
        """Standard deviation of a reading about the instants t (n,), rad, (n, joints).

        That of the log, or what readings scatter by in a rough stretch, where that is far more.
        """
        return self._noise_there[self.t[:-1].searchsorted(t)]

    @cached_property
    def _noise_there(self) -> Array:
        """The same of each reading, (m, joints), rad."""
        return np.asarray(np.maximum(self.noise, self.roughness))

    @cached_property
    def roughness(self) -> Array:
        """What readings scatter by in rough stretches, (m, joints), rad; 0 elsewhere.

        Noise is as large by third as by fourth differences; motion that is read slowly is not.
        """
        rough = np.zeros(self.q.shape)
        if len(self.t) < 8 * ROUGH_ROWS:  # too few to tell; live, there are no more
            return rough
        places = sliding_window_view(np.arange(len(self.t)), ROUGH_ROWS)[:: ROUGH_ROWS // 2]
        sizes = []
        for order, variance in zip((3, 4), DIFFERENCE_VARIANCES[1:], strict=True):
            whole = sliding_window_view(np.diff(self.t)[:, None] <= MAX_GAP, order, axis=0)
            steps = np.abs(np.diff(self.q, order, axis=0)) * whole.all(axis=2)
            near = np.clip(places - order // 2, 0, len(steps) - 1)
            sizes.append(MAD_TO_SIGMA * np.median(steps[near], axis=1) / np.sqrt(variance))
        usual = np.maximum(ROUGH_RATIO * np.maximum(self.noise, self.step), MIN_TRAVEL)
        found = (sizes[1] > usual) & (sizes[0] < 2 * sizes[1])
        size = np.sqrt(np.sum(sizes[1] ** 2 * found, axis=0) / np.maximum(found.sum(axis=0), 1))
        if found.any() and self.time_noise:  # that is what all joints share, by speed
            return rough
        for k in np.flatnonzero(found.any(axis=1)):
            rows = slice(max(places[k, 0] - ROUGH_ROWS // 4, 0), places[k, -1] + ROUGH_ROWS // 4)
            rough[rows] = np.maximum(rough[rows], size * found[k])
        return rough

    @cached_property
    def step(self) -> float:
        """Coarsest step in which a joint's readings change, rad; 0 where noise is wider than it.

        All values of a joint are whole steps apart. Such readings hide their noise.
        """
        coarsest = 0.0
        for q, noise in zip(self.q.T, self.noise, strict=True):
            values = np.unique(q)
            values = values[np.diff(values, prepend=-np.inf) > TOL_STEP]
            if len(values) >= MIN_VALUES:
                step = float(np.diff(values).min())
                count = (values - values[0]) / step
                if step > 2 * noise and np.abs(count - np.round(count)).max() < MAX_STEP_ERROR:
                    coarsest = max(coarsest, step)
        return coarsest

    @cached_property
    def time_noise(self) -> float:
        """Standard deviation of one time stamp, s; 0 where the readings do not show it.

        Between four neighbours each reading is off the cubic through them. A wrong stamp moves all
        joints by their speeds, which nothing else does: the products of two joints' deviations tell
        it from the readings' own noise.
        """
        middle = np.arange(2, len(self.t) - 2)
        near = middle[:, None] + [-2, -1, 1, 2]
        x = self.t[near] - self.t[middle][:, None]
        middle, near, x = (a[np.ptp(x, axis=1) <= MAX_GAP] for a in (middle, near, x))
        if len(middle) < MIN_STAMPS:
            return 0.0
        others = x[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]]
        weight = np.prod(-others / (x[:, :, None] - others), axis=2)  # Lagrange's, at 0
        off = self.q[middle] - np.einsum("nk,nkj->nj", weight, self.q[near])
        speed = (self.q[near[:, 3]] - self.q[near[:, 0]]) / np.ptp(x, axis=1)[:, None]
        shown = _products_of_two(off * speed)
        expected = _products_of_two(speed**2)
        fast = expected > np.mean(expected)
        square = shown[fast] / (expected[fast] * (1 + np.sum(weight[fast] ** 2, axis=1)))
        chance = STAMPS_SIGMA / (2 * np.sqrt(max(len(square), 1)))
        if len(square) < MIN_STAMPS or np.mean(square > 0) < max(0.5 + chance, MIN_TOGETHER):
            return 0.0
        return float(np.sqrt(max(np.median(square), 0.0) / CHI2_MEDIAN))

    def interpolation_uncertainty(self, t: Array) -> Array:
        """Standard uncertainty of the interpolation at the instants t (n,), rad, (n, joints).

        The difference that two estimates of the speeds at the ends of the curve make there.
        """
        if len(self.t) < 2:
            return np.zeros((len(t), self.q.shape[1]))
        return kernel.interpolation_error(*self._contiguous, self.longest, t)

    def direction(self, t: Array) -> Array:
        """Last direction of travel at the instants t (n,): +1, -1, or 0 before any; (n, joints).

        A joint has turned back once it is further from its extreme than the readings' noise can
        explain; at rest the last direction is kept.
        """
        return self._directions[self.t[1:].searchsorted(t, side="right")]

    @cached_property
    def _directions(self) -> Array:
        """Last direction of travel after each reading, (m, joints)."""
        # at rest, the highest of thousands of readings and the lowest are both noise
        turned = 2 * self.resolved
        return kernel.travel_directions(self._contiguous[1], turned).astype(np.float64)


def _products_of_two(values: Array) -> Array:
    """Sum of the products of any two of a row's values (n, j), (n,)."""
    products: Array = (values.sum(axis=1) ** 2 - np.sum(values**2, axis=1)) / 2
    return products
