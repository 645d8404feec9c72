"""Refuse readings and poses in other units, another sense or order than their file states.

Radians for degrees, metres for millimetres, a column reversed: what is wrong as written and agrees
once it is converted is refused, with the remedy. So are columns that are late against the others,
though they stand in one row: beside the errors of all joints, resolved by angle and direction of
travel, each joint's own latency d_k is fitted; a common one is the clock's offset:

    xi = J e(q, s) - sum over k of J_k q'_k d_k + noise

Newton's steps move the readings themselves: a tenth of a second is no small step. Joints are named
where that leaves a small share of the misfit, and most joints agree.

A clock that is set while a log is written has one offset before and another one after. Each part of
the session shows its own; the instant is sought at which one of them takes over from another.

Times written by a nominal rate, of pictures or of readings, run at another rate than any clock:

    t_read = t - o + r (t - t_m)        o, r: of a grid in a few seconds, then by Newton's steps
"""

from dataclasses import replace
from itertools import permutations

import numpy as np

import robots
from robots.transforms import difference
from verify.analysis.clock.estimate import (
    MAX_PAIRS_COMPARED,
    MAX_STEP,
    ClockEstimate,
    local_offset,
    motion_squares,
    spread,
)
from verify.analysis.clock.search import MOTION_LAG, are_visits, coarse_costs
from verify.analysis.comparison import Comparison, compare, pseudo_inverse
from verify.analysis.instrument import measure_poses, stated_noise
from verify.analysis.joint_errors import error_terms
from verify.analysis.least_squares import RegressionFit, Whitener, pair_misfits, solve, whiten
from verify.analysis.measured import session_clock
from verify.analysis.mistakes import Mistake, pose_mistakes, refusal
from verify.core.readings import Readings
from verify.core.records import Array, Index
from verify.errors import InputError
from verify.io.session.poses import Instrument
from verify.io.session.session import Session
from verify.measurement.track import Track, subset

# Two poses count as the same arm in the same place within this; a gross fault stays below it,
# angles in the wrong unit or coordinates in the wrong unit or order do not.
MAX_POINT_DIFFERENCE = 0.1  # m: of a position alone the readings' own turn moves the point, too
MIN_AGREEING = 0.9  # of the poses: where a flange points down, half may agree by chance
WHOLE_PAIRS = 0.05  # of the time between pairs, by which a step is off a whole number of them
MIN_LATE = 0.005  # s; less may be an elastic gear, and moves little
MIN_RATIO = 5.0  # of it, and of a latency, to their standard uncertainties
MAX_LEFT_SHARE = 0.25  # of the misfit, with the joints' latencies
MIN_MISFIT = 4.0  # of the session without: below that nothing is wrong that matters
MIN_JOINTS = 3  # whose latencies are known
MAX_STEPS = 8
TOL_LATE = 1e-5  # s
PART_TIME = 0.8  # s: of parts that show each its own clock
MIN_PART, MIN_PARTS, MAX_PARTS = 12, 3, 12  # pairs of a part; parts
PART_SHARES = np.arange(2, 8) / 8  # of a track, in which a first change is sought
MIN_STRETCH = 3  # pairs in a row
MIN_STRETCH_GAIN, MAX_STRETCH_LEFT = 50.0, 0.1  # of a pair's misfit; of the stretch's
MIN_BESIDE = 8  # pairs, a clock's change
FAIR_SQUARE = 2.0  # of a motion's misfit
MIN_RATE = 5e-4  # more than crystals do
MIN_RUN = 0.05  # s over a session: less is judged as drift
RATES = np.linspace(-0.15, 0.15, 61)  # that are tried
RATE_TIME = 4.0  # s of pairs, by which they are
TOL_RATE = 0.5  # of a rate, by which halves of a session may differ from it; a step has none there


def refuse_misread(
    session: Session, instrument: Instrument, track: Track, readings: Readings, clock: ClockEstimate
) -> None:
    """Refuse positions alone that agree with the readings in another unit or sense.

    The track is of the poses as written, and the clock as these show it.

    Raises:
        InputError: positions in metres, or a column reversed.
    """
    if track.known_dof.min() == 6 or _places_agree(session.arm, track, readings, clock.offset):
        return
    poses = instrument.poses
    for name, remedy, without in pose_mistakes(poses.transforms, alone=True):
        other = replace(instrument, poses=replace(poses, position=without[:, :3, 3]))
        tried = measure_poses(session, other, readings, stated_noise(other)).track
        offset = session_clock(session, tried, readings).offset
        if _places_agree(session.arm, tried, readings, offset):
            found = f"the poses do not agree with the readings; {name} fits"
            raise InputError(session.left.path, found, "millimetres, as the columns say", remedy)


def _places_agree(arm: robots.Arm, track: Track, readings: Readings, offset: float) -> bool:
    """Whether the flange lies close to where the readings put it."""
    known = readings.available(track.t - offset)
    if not known.any():
        return False
    poses = robots.forward(arm, readings.at((track.t - offset)[known]))
    distance = np.linalg.norm(poses[:, :3, 3] - track.base_T_flange[known, :3, 3], axis=1)
    return bool(np.mean(distance < MAX_POINT_DIFFERENCE) >= MIN_AGREEING)


def refuse_late(session: Session, written: Mistake, offset: float) -> None:
    """Refuse readings of which some joints' are late against the others', or some against the rest.

    Of one joint swept after the other these may be the same. Single visits show neither, and where
    one clock for all explains the session nothing is wrong.

    Raises:
        InputError: names the joints and their latencies, how fast the clock runs, or how and when
            it was set.
    """
    log = written.track, written.arm, written.readings, offset
    if are_visits(written.track.t) or are_visits(written.readings.t):
        return
    sample = subset(written.track, spread(len(written.track), MAX_PAIRS_COMPARED))
    if _fit_latencies(sample, *log[1:])[1] < MIN_MISFIT:
        return
    if (rate := clock_rate(*log)) is not None:
        others = "frames.csv" if session.instrument is None else session.left.path.name
        pace = f"{abs(rate) * 100:.3g} % {'fast' if rate > 0 else 'slow'}"
        runs = f"t_s runs {pace} against {others}"
        remedy = f"Multiply t_s by {1 / (1 + rate):.5f}, or correct the times in {others}: one of "
        remedy += "them seems to be written by a nominal rate."
        raise InputError(written.file, runs, "times of one clock", remedy)
    late, changes = late_joints(*log), clock_changes(*log)
    found, remedies = [], []
    if late:
        named = [
            f"joint {j} ({abs(d):.3f} s {'late' if d > 0 else 'early'})" for j, d in late.items()
        ]
        moves = ", ".join(f"q{j}_deg by {-d:+.3f} s" for j, d in late.items())
        found.append(f"those of {' and '.join(named)} are out of step with the others")
        remedies.append(f"Move {moves} against t_s, or record all joints at one instant.")
    if changes:
        size = changes[0][2]
        steps = [f"by {d:+.3f} s between t_s = {a:.2f} and {b:.2f}" for a, b, d in changes]
        found.append(f"their clock was set {', and '.join(steps)}")
        adds = ", and ".join(f"{-change[2]:+.3f} s" for change in changes)
        remedies.append(f"Add {adds} to t_s from there on, or judge each part by itself.")
        count = abs(size) / float(np.median(np.diff(written.track.t)))
        if round(count) and abs(count - round(count)) < WHOLE_PAIRS and session.instrument is None:
            what = "lost" if size > 0 else "repeated"
            remedies.append(
                f"If both cameras {what} {round(count)} of their pictures there, which shows the "
                "same, correct frames.csv from there on."
            )
    if found:
        written = replace(written, remedy=" Or: ".join(remedies))
        raise refusal(session, written, ", or ".join(found))


def clock_rate(track: Track, arm: robots.Arm, readings: Readings, offset: float) -> float | None:
    """By which share the readings' clock runs faster than the pairs', where no clock does.

    None where the motion does not show it clearly, in both halves alike.
    """
    n, pace = len(track), float(np.median(np.diff(track.t)))
    count = min(max(MIN_PART, round(RATE_TIME / pace)), n)
    steps = difference(track.base_T_flange[1:], track.base_T_flange[:-1])
    travel = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))
    firsts = spread(n - count + 1, MAX_PARTS)
    first = int(firsts[np.argmax(travel[firsts + count - 1] - travel[firsts])])
    near = np.arange(first, first + count)  # where the arm moves most
    middle = float(track.t[near].mean())

    def refined(chosen: Index, line: Array | None) -> Array | None:
        few = subset(track, chosen[spread(len(chosen), MAX_PAIRS_COMPARED)])
        return None if line is None else _refine_rate(few, arm, readings, line, middle)

    line = refined(near, _coarse_rate(subset(track, near), arm, readings, offset, middle))
    while len(near) < n:  # twice as long: the rate is known well enough for that
        near = np.arange(max(near[0] - len(near) // 2, 0), min(near[-1] + len(near) // 2 + 2, n))
        line = refined(near, line)
    if line is None or abs(line[1]) < max(MIN_RATE, MIN_RUN / float(np.ptp(track.t))):
        return None
    halves = [refined(half, line) for half in np.array_split(near, 2)]
    if any(half is None or abs(half[1] / line[1] - 1) > TOL_RATE for half in halves):
        return None
    sample = subset(track, spread(n, MAX_PAIRS_COMPARED))
    fine = _refine_rate(sample, arm, readings, line, middle, resolved=True)
    line = line if fine is None else fine
    alone = local_offset(sample, arm, readings, offset)
    tried = [offset] if alone is None else [offset, alone[0]]
    plain = min(_fit_latencies(sample, arm, readings, one)[1] for one in tried)
    left = _fit_latencies(sample, arm, readings, line[0] - line[1] * (sample.t - middle))[1]
    return float(line[1]) if left < MAX_LEFT_SHARE * plain else None


def _coarse_rate(
    track: Track, arm: robots.Arm, readings: Readings, guess: float, middle: float
) -> Array:
    """Offset at the instant `middle`, s, and rate of the readings' clock, from RATES."""
    tried = []
    for rate in RATES.tolist():
        run = replace(track, t=track.t + rate * (track.t - middle))
        curve = coarse_costs(run, arm, readings, guess)
        best = curve[np.argmin(curve[:, 1])] if len(curve) else (0.0, np.inf)
        tried.append((best[1], best[0], rate))
    return np.array(min(tried)[1:])


def _refine_rate(
    track: Track,
    arm: robots.Arm,
    readings: Readings,
    line: Array,
    middle: float,
    *,
    resolved: bool = False,
) -> Array | None:
    """Newton on offset and rate, beside joint errors, constant or resolved; None: it goes far."""
    for _ in range(MAX_STEPS):
        comparison = compare(track, arm, readings, line[0] - line[1] * (track.t - middle))
        if len(comparison) < MIN_BESIDE:
            return None
        jacobian, white = comparison.jacobian, whiten(comparison)
        late = -jacobian @ comparison.rate[:, :, None]
        since = (comparison.t - middle)[:, None, None]
        errors = _error_columns(comparison, white) if resolved else [white.rows(jacobian)]
        rows = white.rows(np.concatenate([late, -late * since], axis=2))
        xi = white.rows(comparison.xi[:, :, None])[:, 0]
        step = solve(np.concatenate([rows, *errors], axis=1), xi).value[:2]
        line = line - step * min(1.0, MAX_STEP / max(abs(step[0]), 1e-12))
        if abs(step[0]) + abs(step[1]) < TOL_LATE:
            return line
    return None


def late_joints(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> dict[int, float]:
    """Joints, from 1, whose readings are late, and by how much, s; negative: early.

    Empty where no joint's are, or where the session does not say whose.
    """
    sample = subset(track, spread(len(track), MAX_PAIRS_COMPARED))
    late, plain = np.zeros(arm.dof), np.inf
    for step in range(MAX_STEPS):
        moved = [readings.at(readings.t + d)[:, k] for k, d in enumerate(late.tolist())]
        log = Readings(readings.t, np.stack(moved, axis=1)) if step else readings
        fit, without = _fit_latencies(sample, arm, log, offset)
        plain = without if step == 0 else plain
        left = fit.chi2 / max(fit.degrees_of_freedom, 1)
        if left > 2 * MAX_LEFT_SHARE * plain:
            return {}
        own = slice(0, arm.dof)
        change = np.where(fit.estimable[own], np.clip(fit.value[own], -MAX_STEP, MAX_STEP), 0.0)
        late = late + change
        if np.abs(change).max() < TOL_LATE:
            break
    doubt = MIN_RATIO * np.sqrt(left * np.diag(fit.covariance)[own])
    known = fit.estimable[own] & (doubt < MIN_LATE)
    if left > MAX_LEFT_SHARE * plain or known.sum() < MIN_JOINTS:
        return {}
    apart = late - np.median(late[known])
    found = np.flatnonzero(known & (np.abs(apart) > MIN_LATE))
    return {k + 1: float(apart[k]) for k in found.tolist()} if 2 * len(found) < known.sum() else {}


def clock_changes(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> list[tuple[float, float, float]]:
    """Each `clock_change` in turn; the first is sought in first parts where it is taken back."""
    for share in (1.0, *PART_SHARES):
        part = subset(track, np.arange(int(share * len(track))))
        if (change := clock_change(part, arm, readings, offset)) is not None:
            rest = subset(track, np.flatnonzero(track.t - offset > change[1]))
            return [change, *clock_changes(rest, arm, readings, offset)]
    return _late_stretch(track, arm, readings, offset)


def _late_stretch(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> list[tuple[float, float, float]]:
    """A few pairs in a row whose pictures are whole pairs late or early, as changes of the clock.

    They are too few to show an offset of their own. One change where they end the session.
    """
    since, until, _, _ = _likeliest_stretch(track, arm, readings, offset)
    others = np.delete(np.arange(len(track)), slice(max(since - 1, 0), until + 2))
    if len(others) < len(track) // 2:
        return []
    # with the clock of the others, which the stretch had pulled along
    fit = local_offset(subset(track, others), arm, readings, offset)
    offset = offset if fit is None else fit[0]
    since, until, shift, shows = _likeliest_stretch(track, arm, readings, offset)
    if not shows:
        return []
    times = track.t - offset
    changes = [(float(times[max(since - 1, 0)]), float(times[since]), -shift)]
    if until + 1 < len(track):
        changes.append((float(times[until]), float(times[until + 1]), shift))
    return changes


def _likeliest_stretch(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> tuple[int, int, float, bool]:
    """First and last pair of the stretch that whole pairs more or less explain best.

    Behind them the time, s, by which its pictures are late, and whether they clearly are.
    """
    n, period, log = len(track), float(np.median(np.diff(track.t))), (track, arm, readings)
    now = compare(*log, offset)
    usual = np.median(pseudo_inverse(now.jacobian) @ now.xi[:, :, None], axis=0)[:, 0]
    (own, by_joint), found = pair_misfits(now, n, usual), []
    for count in (-2, -1, 1, 2):
        late, _ = pair_misfits(compare(*log, offset + count * period), n, usual)
        gained = np.append(0.0, np.cumsum(np.nan_to_num(own - late) - MIN_STRETCH_GAIN))
        until = int(np.argmax(gained - np.minimum.accumulate(gained))) - 1
        since = int(np.argmin(gained[: until + 2]))
        inside = slice(since, until + 1)
        edges = [i for i in (since - 2, since - 1, until + 1, until + 2) if 0 <= i < n]
        few = MIN_STRETCH <= until - since + 1 <= n // 2
        # no error of one joint, which grows and shrinks: pictures are late from pair to pair
        left, as_read = np.nansum(late[inside]), np.nansum(own[inside])
        fits = left < MAX_STRETCH_LEFT * as_read
        fits &= left < MAX_LEFT_SHARE * np.nansum(by_joint[:, inside], axis=1).min()
        sharp = np.nansum(own[edges]) < MAX_STRETCH_LEFT * np.nansum(late[edges])
        gain = float(gained[until + 1] - gained[since])
        found.append((gain, since, until, count * period, bool(few and fits and sharp)))
    return max(found)[1:]


def clock_change(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> tuple[float, float, float] | None:
    """Between which of their stamps, s, the readings' clock was set, and by how much, s.

    None where no two parts have an offset each; `offset` is where they are sought.
    """
    n = len(track)
    if n < 2 * MIN_PART:
        return None
    size = max(MIN_PART, n // MAX_PARTS, int(PART_TIME / float(np.median(np.diff(track.t)))))
    firsts = spread(max(n - size, 0) + 1, MAX_PARTS).tolist()
    parts = [subset(track, np.arange(k, min(k + size, n))) for k in firsts]
    fits = [(part, local_offset(part, arm, readings, offset)) for part in parts]
    found = [(part.t[0], part.t[-1], *fit) for part, fit in fits if fit is not None]
    begin, end, own, doubt = np.array(found).reshape(-1, 4).T
    t, squares = motion_squares(track, arm, readings, own) if found else (own, own[None])
    at = np.arange(MIN_BESIDE, len(t) - MIN_BESIDE)
    if len(found) < MIN_PARTS or not len(at):
        return None
    sums, tried = np.pad(np.cumsum(squares, axis=1), ((0, 0), (1, 0))), []
    for i, j in permutations(range(len(own)), 2):
        # motions across the change follow neither clock, and count as if they fitted fairly
        across = 1.2 * MOTION_LAG + max(own[j] - own[i], 0.0)
        last = np.maximum(np.searchsorted(t, t[at] - across), MIN_BESIDE)
        cost = sums[i, last] + FAIR_SQUARE * (at - last) + sums[j, -1] - sums[j, at]
        k = int(np.argmin(cost))  # of changes that fit, the least
        tried.append((cost[k] * (1 + abs(own[j] - own[i])), i, j, last[k], at[k]))
    _, i, j, before, after = min(tried)
    left = sums[[i, j], before], (sums[:, -1] - sums[:, after])[[j, i]]
    poor = max(fits / others for fits, others in left) > MAX_LEFT_SHARE
    if poor or abs(own[i] - own[j]) < MIN_LATE:
        return None
    told = squares[j] - squares[i]  # little where the arm rests
    since = t[:before].max(where=told[:before] > 2 * FAIR_SQUARE, initial=t[0]) + 0.8 * MOTION_LAG
    until = t[after:].min(where=told[after:] < -2 * FAIR_SQUARE, initial=t[-1])
    whole = (end <= since) | (begin >= until)  # parts; a drift would be a line through theirs
    if whole.sum() < MIN_PARTS:
        return None
    line = np.polyval(np.polyfit(begin[whole], own[whole], 1, w=1 / doubt[whole]), begin)
    step = np.where(begin < until, own[i], own[j])
    by_step, by_line = (np.sum(((own - one) / doubt)[whole] ** 2) for one in (step, line))
    if by_step > MAX_LEFT_SHARE * by_line:
        return None
    return float(since - own[i]), float(until - own[j]), float(own[i] - own[j])


def _fit_latencies(
    track: Track, arm: robots.Arm, readings: Readings, offset: float | Array
) -> tuple[RegressionFit, float]:
    """Fit the joints' latencies, first, and errors; the misfit with one latency for all."""
    comparison = compare(track, arm, readings, offset)
    jacobian, white = comparison.jacobian, whiten(comparison)
    latencies = white.rows(-jacobian * comparison.rate[:, None])
    errors = _error_columns(comparison, white)
    xi = white.rows(comparison.xi[:, :, None])[:, 0]
    common = solve(np.concatenate([latencies.sum(axis=1)[:, None], *errors], axis=1), xi)
    fit = solve(np.concatenate([latencies, *errors], axis=1), xi)
    return fit, common.chi2 / max(common.degrees_of_freedom, 1)


def _error_columns(comparison: Comparison, white: Whitener) -> list[Array]:
    """Whitened columns (r, p) of each joint's errors, by angle and direction of travel."""
    return [
        white.rows(comparison.jacobian[:, :, [j]] * terms[:, None])
        for j, terms in enumerate(error_terms(comparison)[1] if len(comparison) else ())
    ]
