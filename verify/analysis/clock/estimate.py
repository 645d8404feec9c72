"""The offset between the controller's clock and the cameras', from arrivals and the motion itself.

The search (verify.analysis.clock.search) gives offsets that could be; each is refined by the poses,
together with a constant error of every joint, so that an encoder's offset does not pass for a
clock's. The refined ones are then compared, two at a time, by

    evidence(a, b) = sign(z) z² + penalty(b) - penalty(a)

z is the sum over pairs of b's squared residual less a's, over its own noise. Residuals are whitened
differences over some tenths of a second: a joint whose reading jumps then counts where it jumps and
nowhere else. The penalty holds the pairs that an offset leaves without a reading, and the distance
from what arrival times say. Where another offset is not beaten clearly, the clock is ambiguous.

A reading of controller's time t that arrives at t_host on the cameras' clock was late by some delay
d ≥ 0, so that t_host - t = offset + d. The quickest delivery of a log is late by little:

    offset = min(t_host - t) - MEAN_DELIVERY
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import robots
from robots.transforms import invert, misplacement
from verify.analysis.clock.search import COARSE_STEP, MIN_OVERLAP, MOTION_LAG, coarse_costs, dips
from verify.analysis.comparison import Comparison, compare, gross_errors, placement_columns
from verify.analysis.least_squares import autocorrelation, whiten
from verify.core.readings import Readings
from verify.core.records import Array, Index
from verify.measurement.track import Track, subset

MEAN_DELIVERY = 0.005  # s: how late the quickest delivery is taken to be, and its uncertainty
# s, standard: of the stamps of pictures, which some cameras put on when a picture is delivered
CAMERA_STAMP = 0.03
MIN_SPREAD_SHARE = 0.1  # of the delays' spread: the quickest of a jittery line is less well known
MAX_DIPS = 60  # that are refined, the likeliest ones
MAX_PAIRS_COMPARED = 300  # of each candidate; more only cost time
# of the pairs: a log that ends early may cover no more at its true offset; where fewer have a
# reading at zero, the readings' clock is another one
LEAST_OVERLAP = 0.2
MAX_ARRIVAL_PENALTY = 100.0  # a line that is always late is believed less than a clear motion
MIN_DISTANCE = 5 * COARSE_STEP  # s: candidates nearer than this are one
MIN_EVIDENCE = 16.0  # four standard deviations: less leaves the clock ambiguous
MAX_SQUARED_DIFFERENCE = 100.0  # of a pair's residual: a joint that jumps has one vote
JUMP_WINDOW = 3 * MOTION_LAG  # s: pairs that one jump of a joint can reach have no vote
LOST_SHARE = 0.005  # of the pairs without a reading: a penalty of 1
MAX_ITERATIONS = 30
TOL_OFFSET, TOL_START = 1e-7, 1e-5  # s; of the offset, and of those that are compared before
MAX_STEP = 0.1  # s: readings are not linear over longer times
MAX_TRAVEL = 0.5  # s, from a dip: what it leads to farther off is another one's
# s, s, rad: an offset that is known worse is none; a slow arm moves as little in a longer time
MAX_UNCERTAINTY, MAX_UNCERTAINTY_SLOW, MAX_MOVED = 0.01, 0.1, np.deg2rad(0.3)
NO_PLACE = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # m²: a pose with which only its turn counts
DOUBTFUL = 5e-4  # s, standard: the motion of usual sessions shows an offset better
MIN_APART, MIN_APART_SIGMA = 2e-3, 5.0  # s, sigmas: of a given offset; nearer, first order does
PARTS, MIN_PARTS = 4, 3  # of a session, where all of it shows no offset; that agree
# of the clock's effect must be left after joint offsets are fitted; less is rounding and noise
MIN_VISIBLE_SHARE = 0.02
# the same from the readings' noise alone, at rest, is 1 with a spread of a few percent
MIN_SIGNAL_TO_NOISE = 4.0


@dataclass(frozen=True, slots=True)
class ArrivalClock:
    """What deliveries say of the offset."""

    offset: float  # s
    standard_uncertainty: float  # s, of the readings' side alone

    @property
    def reach(self) -> float:
        """Standard uncertainty with the pictures' own stamps, s: what the motion is weighed by."""
        return float(np.hypot(self.standard_uncertainty, CAMERA_STAMP))


def clock_from_arrival_times(t: Array, t_host: Array) -> ArrivalClock:
    """The offset that arrival times suggest: readings' own times t and arrivals t_host, (m,), s."""
    delay = t_host - t
    quickest = float(delay.min())
    spread = MIN_SPREAD_SHARE * (float(np.median(delay)) - quickest)
    return ArrivalClock(quickest - MEAN_DELIVERY, float(np.hypot(MEAN_DELIVERY, spread)))


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """What to add to the readings' time, and how well it is known."""

    offset: float  # s; 0 where the motion does not show it
    standard_uncertainty: float | None  # s; None: taken as exact, or not known
    source: str  # given, estimated, ambiguous, arrival, none
    curve: Array  # (m, 2): offset s, cost a pair
    rivals: tuple[float, ...] = ()  # s, other offsets that fit as well


def estimate_clock(
    track: Track, arm: robots.Arm, readings: Readings, arrival: ArrivalClock | None = None
) -> ClockEstimate:
    """Find the offset from the motion, and from arrival times where there are any.

    Its source is `ambiguous` where others fit as well (a periodic motion), `arrival` or `none`
    where the motion (at rest, or at constant speed) does not show it. A log that covers few of the
    pairs is searched for only where none is found with most of them: few pairs fit by chance. A
    base or LED body that stands elsewhere makes joints seem off, differently at each posture: where
    the offset is not well known, it is sought without that, too.
    """
    found = _search(track, arm, readings, arrival, MIN_OVERLAP)
    known = found.standard_uncertainty or np.inf
    if found.source in ("none", "estimated") and known > DOUBTFUL:
        # an LED body elsewhere changes how far its place moves, and not by what angle
        turns = replace(track, covariance_pixels=track.covariance_pixels + NO_PLACE)
        by_angle = coarse_costs(turns, arm, readings, found.offset)
        at = by_angle[np.argmin(by_angle[:, 1]), 0] if len(by_angle) else found.offset
        there = _without_misplacement(track, arm, readings, at)
        stood = _search(there, arm, readings, arrival, MIN_OVERLAP, placed=False)
        if stood.source == "estimated" and (stood.standard_uncertainty or np.inf) < known:
            found = stood
    shared = readings.available(track.t - found.offset).mean()
    if found.source not in ("none", "arrival") or (arrival and shared >= MIN_OVERLAP):
        return found
    cut = _search(track, arm, readings, arrival, LEAST_OVERLAP)
    return found if cut.source in ("none", "arrival") else cut


def _search(
    track: Track,
    arm: robots.Arm,
    readings: Readings,
    arrival: ArrivalClock | None,
    overlap: float,
    placed: bool = True,
) -> ClockEstimate:
    """The offset among those that give a share `overlap` of the pairs a reading.

    Unless base and LED body are `placed`, it is fitted beside small motions of both.
    """
    guess = None if arrival is None else arrival.offset
    curve = coarse_costs(track, arm, readings, guess, overlap)
    open_clock = _unshown_offset(track, readings, curve, arrival)
    if not len(curve):
        return open_clock
    sample = subset(track, spread(len(track), MAX_PAIRS_COMPARED))
    gross = gross_zeros(sample, arm, readings, float(curve[np.argmin(curve[:, 1]), 0]))
    if gross.any():
        readings = Readings(readings.t, readings.q - gross)
        curve = coarse_costs(track, arm, readings, guess, overlap)
    likely = sorted(dips(curve), key=lambda o: _penalty(track.t, readings, o, arrival))[:MAX_DIPS]
    fits = (_refine(sample, arm, readings, o, likely[:n], TOL_START) for n, o in enumerate(likely))
    starts = _merge([fit[0] for fit in fits if fit is not None])
    if not starts:
        return open_clock
    best, rivals = _choose([_candidate(track, arm, readings, o, arrival) for o in starts])
    fine = _refine(track, arm, readings, best, placed=placed)
    if fine is None or fine[1] > MAX_UNCERTAINTY:
        fine = _refine_by_parts(track, arm, readings, best) or fine
    rate = readings.motion(sample.t - best)[1]
    longest = MAX_MOVED / max(float((rate**2).mean(axis=0).max()) ** 0.5, 1e-9)
    most = MAX_UNCERTAINTY if arrival else MAX_UNCERTAINTY_SLOW  # arrivals say more than that
    if fine is None or fine[1] > np.clip(longest, MAX_UNCERTAINTY, most):
        return open_clock
    return ClockEstimate(*fine, "ambiguous" if rivals else "estimated", curve, rivals)


def _without_misplacement(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> Track:
    """The track with base and LED body where the readings have them at an offset of the clock."""
    known = readings.available(track.t - offset)
    if not known.any():
        return track
    read = robots.forward(arm, readings.at((track.t - offset)[known]))
    base, body = misplacement(track.base_T_flange[known], read)
    return replace(track, base_T_flange=invert(base) @ track.base_T_flange @ invert(body))


def gross_zeros(track: Track, arm: robots.Arm, readings: Readings, offset: float) -> Array:
    """What readings are off by in most pairs, (j,), rad; 0 where it is no gross error, or open."""
    whole = readings.available(track.t - offset) & (track.known_dof == 6)
    if arm.dof != 6 or not whole.any():
        return np.zeros(arm.dof)
    q = readings.at((track.t - offset)[whole])
    measured, reached = robots.nearest(arm, track.base_T_flange[whole], q)
    apart = (q - measured)[reached]
    wrapped = np.arctan2(np.sin(apart), np.cos(apart))
    return np.median(gross_errors(wrapped), axis=0) if len(wrapped) else np.zeros(arm.dof)


def _unshown_offset(
    track: Track, readings: Readings, curve: Array, arrival: ArrivalClock | None
) -> ClockEstimate:
    """The offset to take where the motion does not show one."""
    if arrival is not None:
        return ClockEstimate(arrival.offset, arrival.standard_uncertainty, "arrival", curve)
    at_zero = readings.available(track.t).mean() >= LEAST_OVERLAP
    offset = 0.0 if at_zero or not len(curve) else float(curve[np.argmin(curve[:, 1]), 0])
    return ClockEstimate(offset, None, "none", curve)


@dataclass(frozen=True, slots=True)
class _Candidate:
    offset: float  # s
    penalty: float
    t: Array  # (n,), s, of the pairs
    square: Array  # (n,), of the whitened differences at each pair; nan without a reading


def local_offset(
    part: Track, arm: robots.Arm, readings: Readings, guess: float
) -> tuple[float, float] | None:
    """The offset that a few pairs show by themselves and its standard uncertainty, s, or None."""
    curve = coarse_costs(part, arm, readings, guess)
    fit = _refine(part, arm, readings, curve[np.argmin(curve[:, 1]), 0]) if len(curve) else None
    return None if fit is None or fit[1] > MAX_UNCERTAINTY else fit


def shown_offset(
    track: Track, arm: robots.Arm, readings: Readings, given: ClockEstimate
) -> float | None:
    """The offset that the motion shows near a given one, s; None where it does not disagree."""
    sample = subset(track, spread(len(track), MAX_PAIRS_COMPARED))
    fit = None if given.source != "given" else _refine(sample, arm, readings, given.offset)
    if fit is None or abs(fit[0] - given.offset) < max(MIN_APART, MIN_APART_SIGMA * fit[1]):
        return None
    squares = motion_squares(track, arm, readings, np.array([given.offset, fit[0]]))[1]
    return fit[0] if np.diff(squares.sum(axis=1)) < 0 else None


def motion_squares(
    track: Track, arm: robots.Arm, readings: Readings, offsets: Array
) -> tuple[Array, Array]:
    """Instants of pairs (n,), s, and what their motions miss by at each offset (m, n), squared."""
    squares = np.array([_candidate(track, arm, readings, o, None).square for o in offsets.tolist()])
    known = ~np.isnan(squares).all(axis=0)
    squares = np.where(np.isnan(squares), np.inf, squares)[:, known]
    return track.t[known], np.minimum(squares, MAX_SQUARED_DIFFERENCE)


def _candidate(
    track: Track, arm: robots.Arm, readings: Readings, offset: float, arrival: ArrivalClock | None
) -> _Candidate:
    """A refined offset, with what speaks for it."""
    penalty = _penalty(track.t, readings, offset, arrival)
    # residuals are compared with those some tenths of a second later
    lag = min(max(round(MOTION_LAG / float(np.median(np.diff(track.t)))), 1), len(track) - 1)
    early = spread(len(track) - lag, MAX_PAIRS_COMPARED)
    later = early + lag
    square = np.full(len(track), np.nan)
    chosen = np.union1d(early, later)
    comparison = compare(subset(track, chosen), arm, readings, offset)
    place = np.full(len(track), -1)
    place[chosen[comparison.index]] = np.arange(len(comparison))
    both = (place[early] >= 0) & (place[later] >= 0)
    if both.any():
        square[early[both]] = _pair_squares(comparison, place[early[both]], place[later[both]])
    return _Candidate(offset, penalty, track.t, square)


def _penalty(t: Array, readings: Readings, offset: float, arrival: ArrivalClock | None) -> float:
    """What speaks against an offset beside the motion: pairs (at t) lost, late arrivals."""
    penalty = (1.0 - float(readings.available(t - offset).mean())) / LOST_SHARE
    if arrival is not None:
        distance = (offset - arrival.offset) / arrival.reach
        penalty += min(distance**2, MAX_ARRIVAL_PENALTY)
    return penalty


def _pair_squares(comparison: Comparison, early: Index, later: Index) -> Array:
    """Squared misfit of two pairs (n,) beside constant joint errors of their own, a row of it."""
    white = whiten(comparison)
    dof = comparison.jacobian.shape[2]
    rows = np.zeros((len(comparison), 6, dof + 1))
    for i, factor in enumerate(white.factors):
        rows[i, : len(factor), :dof] = factor @ comparison.jacobian[i]
        rows[i, : len(factor), dof] = factor @ comparison.xi[i]
    both = np.concatenate([rows[early], rows[later]], axis=1)
    # the last diagonal entry of R is what the other columns leave of the last one
    triangle = np.asarray(np.linalg.qr(both, mode="r"), dtype=np.float64)
    rows_left = max(2 * int(np.median([len(f) for f in white.factors])) - dof, 1)
    return np.asarray(triangle[:, dof, dof] ** 2 / rows_left)


def _choose(candidates: list[_Candidate]) -> tuple[float, tuple[float, ...]]:
    """The candidate that no other beats, and those that it does not beat clearly."""
    best = candidates[0]
    for other in candidates[1:]:
        if _evidence(best, other) < 0:
            best = other
    near = [c for c in candidates if c is not best and _evidence(best, c) < MIN_EVIDENCE]
    return best.offset, tuple(c.offset for c in near)


def _evidence(one: _Candidate, other: _Candidate) -> float:
    """How clearly one offset fits better than another, as a squared number of sigmas."""
    both = ~np.isnan(one.square) & ~np.isnan(other.square)
    motion = 0.0
    if np.count_nonzero(both) > 2:
        scale = max(float(np.median(np.minimum(one.square[both], other.square[both]))), 1.0)
        excess = np.minimum(other.square[both] / scale, MAX_SQUARED_DIFFERENCE)
        excess = excess - np.minimum(one.square[both] / scale, MAX_SQUARED_DIFFERENCE)
        spread = 1.4826 * float(np.median(np.abs(excess - np.median(excess))))
        factor = float(autocorrelation(excess[:, None]).max())
        noise = max(spread, 1.0) * np.sqrt(len(excess) * factor)
        total = float(excess.sum()) - _largest_windows(one.t[both], excess)
        z = total / noise
        motion = float(np.sign(z)) * z**2
    return motion + other.penalty - one.penalty


def _largest_windows(t: Array, excess: Array) -> float:
    """The largest sum of either sign within JUMP_WINDOW, both together: a joint that jumps."""
    sums = np.concatenate([[0.0], np.cumsum(excess)])
    within = sums[np.searchsorted(t, t + JUMP_WINDOW, side="right")] - sums[:-1]
    return max(float(within.max()), 0.0) + min(float(within.min()), 0.0)


def _merge(offsets: list[float]) -> list[float]:
    """Offsets in order, those nearer than MIN_DISTANCE taken as one."""
    apart: list[float] = []
    for offset in sorted(offsets):
        if not apart or offset - apart[-1] > MIN_DISTANCE:
            apart.append(offset)
    return apart


def spread(count: int, most: int) -> Index:
    """At most so many of `count` places, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))


def _refine(
    track: Track,
    arm: robots.Arm,
    readings: Readings,
    offset: float,
    earlier: Sequence[float] = (),
    tolerance: float = TOL_OFFSET,
    placed: bool = True,
) -> tuple[float, float] | None:
    """Newton on the offset with a constant error of every joint fitted beside it, as in `_search`.

    None where nothing shows it, where it goes far, and where it passes an offset that an `earlier`
    search started from: it would go on as that one did. A step back is at most half the one before.
    """
    starts, begin, taken, most = np.array(earlier), offset, 0.0, MAX_STEP
    for _ in range(MAX_ITERATIONS):
        comparison = compare(track, arm, readings, offset)
        if len(comparison) < 3:
            return None
        solved = _step(comparison, placed=placed)
        if solved is None:
            return None
        step, uncertainty = solved
        if step * taken < 0.0:  # readings of another motion would send it to and fro
            most = abs(taken) / 2
        taken = float(np.clip(step, -most, most))
        before, offset = offset, offset + taken
        passed = np.any((starts - before) * (starts - offset) < 0.0)
        if passed or abs(offset - begin) > MAX_TRAVEL:
            return None
        if abs(taken) < tolerance:
            break
    return offset, uncertainty


def _refine_by_parts(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> tuple[float, float] | None:
    """The offset from parts of a session, each by itself: a belt that slips spoils one of them."""
    parts = np.array_split(np.arange(len(track)), PARTS)
    fits = [_refine(subset(track, part), arm, readings, offset) for part in parts if len(part) > 2]
    known = np.array([fit for fit in fits if fit is not None and fit[1] <= MAX_UNCERTAINTY])
    if len(known) < MIN_PARTS:
        return None
    weight = known[:, 1] ** -2
    found = float(weight @ known[:, 0] / weight.sum())
    misfit = float(weight @ (known[:, 0] - found) ** 2) / (len(known) - 1)
    return found, float(np.sqrt(max(misfit, 1.0) / weight.sum()))


def _step(comparison: Comparison, *, placed: bool) -> tuple[float, float] | None:
    """Correction of the offset and its standard uncertainty, or None where nothing shows it."""
    # a later clock reads the joints where they were earlier: d xi / d offset = - J rate
    effect = -np.einsum("nij,nj->ni", comparison.jacobian, comparison.rate)[:, :, None]
    white, columns, dof = whiten(comparison), comparison.jacobian, comparison.jacobian.shape[2]
    if not placed:
        moved = placement_columns(comparison.base_T_jacobian)
        columns = np.concatenate([columns, moved], axis=2)
    rows, joints = white.rows(effect)[:, 0], white.rows(columns)
    xi = white.rows(comparison.xi[:, :, None])[:, 0]
    spanned, length, _ = np.linalg.svd(joints, full_matrices=False)
    basis = spanned[:, length > 1e-9 * length[0]]
    left = rows - basis @ (basis.T @ rows)
    size = float(np.linalg.norm(left))
    by_noise = float(np.sum(joints[:, :dof] ** 2, axis=0) @ comparison.rate_variance)
    if size**2 <= MIN_SIGNAL_TO_NOISE * by_noise or size < MIN_VISIBLE_SHARE * np.linalg.norm(rows):
        return None
    step = -float(left @ xi) / size**2
    residual = xi - basis @ (basis.T @ xi) + left * step
    degrees = max(len(xi) - basis.shape[1] - 1, 1)
    misfit = max(float(residual @ residual) / degrees, 1.0)  # what offsets alone do not explain
    factor = float(autocorrelation(white.by_pair(residual)).max())
    return step, float(np.sqrt(misfit * factor)) / size
