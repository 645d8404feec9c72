"""Refuse readings that are not this arm's motion, and name the usual mistake that explains them.

A joint is off where |reading less measured angle| is above MAX_ERROR in a tenth of the pairs. What
faults of encoders may do is taken from the errors, joint by joint:

    error = offset + step (t > t0) + gain · angle        |offset| <= MAX_OFFSET, |gain| <= MAX_GAIN

A given clock by which joints are off, where another offset fits, is named first. A mistake that
people make (a joint's sign, zero, unit, two joints exchanged, another base or arm) is named where
it leaves far less. Without one, the log is refused where one joint stays off as no encoder is; or
two do, and the screw motions from pair to pair disagree as well, which no registration disturbs.
Mistakes are ranked by

    median over pairs of |translation| / LEVER + |rotation|      flange as read to as measured

or, where base and body are not known, by the screw motions; the best are carried to the joints.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import robots
from robots.transforms import carry, difference, invert
from verify.analysis.clock.estimate import ClockEstimate, estimate_clock, gross_zeros, shown_offset
from verify.analysis.clock.search import are_visits, coarse_costs
from verify.analysis.diagnosis.faults import MAX_OFFSET
from verify.analysis.measured import session_clock
from verify.analysis.mistakes import (
    LEVER,
    MAX_PAIRS,
    Mistake,
    degrees,
    joint_mistakes,
    misplaced_base,
    misplacements,
    refusal,
    registration_mistakes,
    sample,
    scaled_joints,
    session_mistakes,
)
from verify.analysis.plausibility import refuse_late
from verify.analysis.relative_motion import MAX_TURN, MIN_TURN, screw_motion
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.session.poses import Instrument
from verify.io.session.session import Session
from verify.measurement.track import Track

MAX_ERROR = np.deg2rad(5.0)
CLEAR_ERROR = np.deg2rad(1.0)  # so close that no other mistake is tried
MIN_REACHED = 0.5  # of the pairs
MIN_CONDITION = 0.5  # of the typical one, as singular values go: a wrist stretched out tells little
HIGH = 0.9  # quantile over pairs: a joint is near 0 in most poses, and there its sign is nothing
MAX_STRAY = np.deg2rad(2.0)  # that faults and the clock leave, of joints and of screw motions
MAX_GAIN = 0.1  # likewise; more is a wrong unit or ratio
MIN_TRAVEL = np.deg2rad(5.0)  # of a joint whose gain is sought
FAULT_STEP = np.deg2rad(5.0)  # from one offset that is tried to the next
MAX_LEFT_SHARE = 0.25  # of what a fault leaves: a mistake has to explain the motion better
MAX_CARRIED = 4  # mistakes, to the joints
MIN_PLACES = 6  # by which positions alone are judged
MAX_FROZEN = np.deg2rad(0.01)  # by which readings of a standing log differ
MIN_STANDING = 4  # pairs at which readings stand
MAX_STANDING_PAIRS = 1000  # among which they are sought: a hold is short


def refuse_other_motion(
    session: Session, track: Track, readings: Readings, clock: ClockEstimate
) -> None:
    """Refuse readings that are not this arm's motion.

    Raises:
        InputError: names the mistake that explains the readings, or says that none does.
    """
    arm = session.arm
    written = Mistake(session.folder / "encoders.csv", "", "", readings, track, arm)
    if session.instrument is not None and session.instrument.positions_alone:
        _refuse_other_places(session, session.instrument, written, clock.offset)
    if arm.dof != 6 or len(track) < 3 or np.median(track.known_dof) < 6:
        return
    if _is_frozen(written, clock.offset):
        raise refusal(session, written, "the readings never change while the flange moves")
    _refuse_standing(session, written, clock, part=True)
    gross = gross_zeros(track, arm, readings, clock.offset)
    plain = replace(written, readings=Readings(readings.t, readings.q - gross))
    zeros = bool(gross.any()) and _large_error(plain, clock.offset) < CLEAR_ERROR
    refuse_late(session, plain if zeros else written, clock.offset)
    typical = _large_error(written, clock.offset)
    if typical < MAX_ERROR:
        return
    if zeros and np.count_nonzero(gross) == 1 and np.abs(gross).max() < MAX_OFFSET:
        return  # one encoder's zero
    shown = shown_offset(track, arm, readings, clock)
    if shown is not None and _large_error(written, shown) < MAX_LEFT_SHARE * typical:
        return  # a clock that is somewhat off is a cause like others
    _refuse_given_clock(session, written, typical)
    off, faulty, left, factor, steps, screws = _left_by_faults(session, written, clock)
    scaled = list(scaled_joints(written, factor, MAX_GAIN))
    mistakes = [
        (mistake, _likely_offset(session, mistake, clock.offset))
        for mistake in (*scaled, *_mistakes(session, written, among_all=off > 1))
    ]
    named, remains = _best_by_joints(session, mistakes, left, len(scaled), steps)
    if named is None and max(off, faulty - 1) > 1:  # after the rest: a free base fits as well
        placed = [(mistake, clock.offset) for mistake in misplacements(session, written, clock)]
        named, remains = _best_by_joints(session, placed, left if off > 1 else typical)
    if named is not None:
        found = f"{named.name} fits: {degrees(remains)} instead of {degrees(typical)}"
        raise refusal(session, named, found)
    _refuse_standing(session, written, clock, part=False)
    if off > 1 and screws > MAX_STRAY:
        misfits = [screw_misfit(*mistake) for mistake in mistakes]
        best = int(np.argmin(misfits))
        if misfits[best] < min(MAX_STRAY, MAX_LEFT_SHARE * screws):
            named, misfit = mistakes[best][0], degrees(misfits[best])
            found = f"{named.name} fits the flange's turns to {misfit} instead of"
            raise refusal(session, named, f"{found} {degrees(screws)}")
    elif left < MAX_OFFSET:
        return
    found = f"joints are off by {degrees(typical)}, and no usual mistake or fault explains it"
    raise refusal(session, written, found)


def _refuse_given_clock(session: Session, written: Mistake, typical: float) -> None:
    """Refuse a given clock offset far from the one by which the motion fits.

    `typical`, rad: what joints are off by with the given one.

    Raises:
        InputError: names the offset that fits.
    """
    given = session.clock
    if given is None:
        return
    shown = estimate_clock(written.track, written.arm, written.readings)
    remains = _large_error(written, shown.offset)
    if shown.source == "estimated" and remains < MAX_LEFT_SHARE * typical:
        raise InputError(
            session.folder / "session.toml",
            f"[clock] encoder_offset_s = {given.encoder_offset:g} puts joints off by "
            f"{degrees(typical)}; {shown.offset:.3f} s fits the motion, to {degrees(remains)}",
            "what is added to the readings' t_s to get the pictures' clock",
            f"Write encoder_offset_s = {shown.offset:.3f}, or leave [clock] out.",
        )


def _refuse_other_places(
    session: Session, instrument: Instrument, written: Mistake, offset: float
) -> None:
    """Refuse positions alone that a usual mistake or another base explains, and no fault does.

    Raises:
        InputError: names the mistake, or how far the base is from where it is said to be.
    """
    from scipy.optimize import minimize_scalar  # slow to load, and few sessions come here

    t = instrument.poses.t - offset
    known = written.readings.available(t)
    if known.sum() < MIN_PLACES:
        return
    q, point = written.readings.at(t[known]), instrument.flange_T_body[:3, 3]
    places = carry(invert(session.rig.rig_T_base), instrument.poses.position[known])

    def read(at: Array) -> Array:
        flange = robots.forward(session.arm, at)
        return np.asarray(flange[:, :3, :3] @ point + flange[:, :3, 3])

    def fault(joint: Array) -> float:
        def apart(size: float) -> float:
            return _far(read(q - size * joint) - places)

        limits = (-MAX_OFFSET, MAX_OFFSET)
        return float(minimize_scalar(apart, bounds=limits, method="bounded").fun)

    typical = _far(read(q) - places)
    if typical < MAX_ERROR:
        return
    left = min(typical, *map(fault, np.eye(q.shape[1])))
    tried = [
        (_far(read(without.q) - places), name, replace(written, name=name, remedy=remedy))
        for name, remedy, without in joint_mistakes(Readings(t[known], q))
    ]
    least, name, mistake = min(tried, key=lambda one: one[0])
    if least >= MAX_LEFT_SHARE * left:  # a free base takes a first joint's mistake in
        base, moved = misplaced_base(session, written, read(q), places)
        if base is None or (least := _far(moved - places)) >= MAX_LEFT_SHARE * left:
            return
        name, mistake = base.name, base
    found = f"{name} fits: {least * LEVER * 1e3:.3g} mm instead of {typical * LEVER * 1e3:.3g}"
    raise refusal(session, mistake, found)


def _far(apart: Array) -> float:
    """What the length of (n, 3), m, exceeds in a tenth of the rows, as an angle at LEVER."""
    return float(np.quantile(np.linalg.norm(apart, axis=1), HIGH)) / LEVER


def _best_by_joints(
    session: Session, mistakes: list[tuple[Mistake, float]], left: float, carried: int = 0,
    steps: float = 0.0,
) -> tuple[Mistake | None, float]:  # fmt: skip
    """The mistake that brings every joint far closer than faults do, if one does; its error, rad.

    With each mistake stands the clock's offset, s; `left`, rad: what faults leave; `steps`, rad:
    such as no encoder makes, and one mistake may. One beside which faults leave as little is named
    where none does by itself. The first few, `carried`, are judged whatever their rank: a fault
    beside them hides it.
    """
    scores = [pose_misfit(*mistake) for mistake in mistakes]
    best = min(MAX_ERROR, MAX_LEFT_SHARE * max(left, steps))
    beside = min(MAX_STRAY, MAX_LEFT_SHARE * left)
    named: Mistake | None = None
    faulty: Mistake | None = None
    for place in dict.fromkeys([*range(carried), *np.argsort(scores)[:MAX_CARRIED].tolist()]):
        mistake = mistakes[place][0]
        tried = replace(session, arm=mistake.arm)
        offset = session_clock(tried, mistake.track, mistake.readings).offset
        remains = _large_error(mistake, offset)
        if remains < best:
            best, named = remains, mistake
        if remains < CLEAR_ERROR:
            break
        rest, _, middle, _ = _left_of_joints(*_joint_errors(mistake, offset))
        if rest.max() < beside:
            others = np.flatnonzero(np.abs(middle) > MAX_STRAY) + 1
            words = f", beside a fault of joint {', '.join(map(str, others))}," * bool(len(others))
            beside, faulty = float(rest.max()), replace(mistake, name=mistake.name + words)
    return (named, best) if named is not None else (faulty, beside)


def _joint_errors(mistake: Mistake, offset: float, most: int = MAX_PAIRS) -> tuple[Array, Array]:
    """Reading less measured angle at some pairs, and that angle, (n, j) each, rad.

    No rows where they are unknown, or where the arm is near a singularity.
    """
    poses, q = sample(mistake, offset, most)
    none = np.zeros((0, mistake.arm.dof))
    if len(q) < 3:
        return none, none
    measured, reached = robots.nearest(mistake.arm, poses, q)
    if reached.mean() < MIN_REACHED:
        return none, none
    columns = robots.jacobian(mistake.arm, measured[reached]) / np.repeat([[LEVER], [1.0]], 3, 0)
    condition = np.linalg.svd(columns, compute_uv=False)[:, -1]
    clear = np.flatnonzero(reached)[condition >= MIN_CONDITION * np.median(condition)]
    error = q[clear] - measured[clear]
    return np.arctan2(np.sin(error), np.cos(error)), measured[clear]


def _large_error(mistake: Mistake, offset: float) -> float:
    """What the worst joint's |error| exceeds in a tenth of the pairs, rad; inf: unknown."""
    error = np.abs(_joint_errors(mistake, offset)[0])
    return float(np.quantile(error, HIGH, axis=0).max()) if len(error) else np.inf


def pose_misfit(mistake: Mistake, offset: float) -> float:
    """How far the flange as read is from the flange as measured, rad, typically."""
    poses, q = sample(mistake, offset)
    if len(q) < 3:
        return np.inf
    apart = difference(poses, robots.forward(mistake.arm, q))
    size = np.linalg.norm(apart.reshape(-1, 2, 3), axis=2) / [LEVER, 1.0]
    return float(np.median(size.sum(axis=1)))


def screw_misfit(mistake: Mistake, offset: float) -> float:
    """How far the flange's screw motions, as read, are from those measured, rad, typically."""
    poses, q = sample(mistake, offset)
    read, apart = robots.forward(mistake.arm, q), []
    for shift in {max(len(q) // 2, 1), max(len(q) // 3, 1)}:
        told, found = (screw_motion(at[:-shift], at[shift:]) for at in (read, poses))
        clear = (found[:, 0] > MIN_TURN) & (found[:, 0] < MAX_TURN)
        apart.append(np.abs(told - found)[clear] / [1.0, LEVER])
    size = np.concatenate(apart).sum(axis=1)
    return float(np.median(size)) if len(size) else 0.0


def _is_frozen(written: Mistake, offset: float) -> bool:
    """Whether the readings stand while the flange turns."""
    poses, _ = sample(written, offset)
    if np.ptp(written.readings.q, axis=0).max() > MAX_FROZEN or not len(poses):
        return False
    turned = np.linalg.norm(difference(poses, poses[0])[:, 3:], axis=1)
    return bool(turned.max() > CLEAR_ERROR)


def _refuse_standing(
    session: Session, written: Mistake, clock: ClockEstimate, *, part: bool
) -> None:
    """Refuse readings of joints that stand while they turn, in `part` of the session or in all.

    What stands is the longest run of one value: there the measured angle goes on without a leap,
    and the joint is off by that and by little elsewhere. A base that is off is so everywhere.

    Raises:
        InputError: names the joints, and from when to when their readings stand.
    """
    unknown = clock.source == "none" and len(clock.curve)  # standing readings hide the clock
    offset = clock.curve[np.argmin(clock.curve[:, 1]), 0] if unknown else clock.offset
    error, angle = _joint_errors(written, float(offset), MAX_STANDING_PAIRS)
    t, found, least = written.readings.t, [], MIN_STANDING * np.median(np.diff(written.track.t))
    for joint, q in enumerate(written.readings.q.T if len(error) else ()):
        runs = np.append(np.flatnonzero(np.diff(q, prepend=np.nan)), len(q))
        first, after = runs[np.argmax(np.diff(runs)) + np.arange(2)].tolist()
        stands = np.abs(np.sin((error[:, joint] + angle[:, joint] - q[first]) / 2)) < MAX_FROZEN / 2
        there, rest = angle[stands, joint], error[~stands, joint]
        if t[after - 1] - t[first] < least or len(there) < MIN_STANDING or bool(len(rest)) != part:
            continue  # values that noise repeats now and then are no run
        turn = float(np.ptp(there))
        off = np.quantile(np.abs(rest - np.median(rest)), HIGH) if part else 0.0
        leap = np.abs(np.diff(there)).max() if part else 0.0
        if turn > (MAX_STRAY if part else MAX_ERROR) and off < turn / 3 and leap < 0.6 * turn:
            found.append((joint + 1, turn, t[first], t[after - 1]))
    if not found:
        return
    _, turn, since, until = max(found, key=lambda one: one[1])
    together = [joint for joint, _, *ends in found if ends == [since, until]]
    one = len(together) == 1
    names = f"joint{'s' * (not one)} {', '.join(map(str, together))}"
    when = f"stand still from t_s = {since:.2f} to {until:.2f}" if part else "never change"
    what = f"those of {names} {when} while {'it turns' if one else 'they turn'} by {degrees(turn)}"
    check = f"the encoder of {names}" if one else "how the log was written"
    rows = "; delete these rows to measure the rest" * part
    columns = ", ".join(f"q{joint}_deg" for joint in together)
    remedy = f"Check {check} and the column{'s' * (not one)} {columns}{rows}."
    raise refusal(session, replace(written, remedy=remedy), what)


def _faults(written: Mistake) -> Iterator[Mistake]:
    """The readings without a constant error of one joint, all that a fault may have."""
    count = round(MAX_OFFSET / FAULT_STEP)
    for joint in range(written.arm.dof):
        for step in (*range(-count, 0), *range(1, count + 1)):
            q = written.readings.q.copy()
            q[:, joint] -= step * FAULT_STEP
            yield replace(written, readings=Readings(written.readings.t, q))


def _left_by_faults(
    session: Session, written: Mistake, clock: ClockEstimate
) -> tuple[int, int, float, Array, float, float]:
    """The least that faults leave: the clock may be lost, the arm in another branch than read.

    Joints that stay off, in number; those with a fault beyond MAX_ERROR; the worst, rad; by which
    factor the readings of each joint turn farther than it, (j,), nan where unknown; the largest
    step, rad, if several joints have one or no belt slips so far; what is left of the screw
    motions, rad.
    """
    offsets = dict.fromkeys([clock.offset, _likely_offset(session, written, clock.offset)])
    tried = []
    for offset in offsets:
        likely = min(_faults(written), key=lambda fault: pose_misfit(fault, offset))
        for log in (written, likely):
            error, angle = _joint_errors(log, offset)
            error += written.readings.q[0] - log.readings.q[0]  # as written, in its branch
            left, factor, middle, step = _left_of_joints(error, angle)
            off, faulty = int((left > MAX_STRAY).sum()), int((np.abs(middle) > MAX_ERROR).sum())
            unusual = np.count_nonzero(step > MAX_ERROR) > 1 or step.max() > MAX_OFFSET
            steps = float(step.max()) * unusual
            tried.append((off, faulty, float(left.max()), factor, steps, screw_misfit(log, offset)))
    return *min(tried, key=lambda one: one[:3])[:5], min(one[5] for one in tried)


def _left_of_joints(error: Array, angle: Array) -> Array:
    """`_left_of_joint` of each column of (n, j), (4, j); inf, nan, 0 and 0 where n is 0."""
    if not len(error):
        return np.array([[np.inf], [np.nan], [0.0], [0.0]]).repeat(error.shape[1], axis=1)
    return np.array(list(map(_left_of_joint, error.T, angle.T))).T


def _left_of_joint(error: Array, angle: Array) -> tuple[float, float, float, float]:
    """What offset, step and gain leave of a joint's error (n,), rad; readings' factor; mean; step.

    `angle` (n,), rad, as measured. The step is tried between any two pairs.
    """
    middle = float(np.angle(np.exp(1j * error).mean()))
    error = np.angle(np.exp(1j * (error - middle)))
    turned = angle - angle.mean()
    sought = np.ptp(angle) > MIN_TRAVEL
    late = np.arange(len(error)) >= np.arange(len(error))[:, None]
    least, factor, step = np.inf, np.nan, 0.0
    for after in late:
        design = np.column_stack([np.ones(len(error)), after, turned * sought])
        gain = float(np.linalg.lstsq(design, error)[0][2])
        rest = error - np.clip(gain, -MAX_GAIN, MAX_GAIN) * turned
        parts = [np.median(rest[part]) if part.any() else 0.0 for part in (after, ~after)]
        if (left := float(np.quantile(np.abs(rest - np.where(after, *parts)), HIGH))) < least:
            step = 0.0 if after.all() else abs(parts[0] - parts[1])
            least, factor = left, 1.0 + gain if sought else np.nan
    return max(least, abs(middle) if abs(middle) > MAX_OFFSET else 0.0), factor, middle, step


def _likely_offset(session: Session, mistake: Mistake, offset: float) -> float:
    """The clock's offset with a mistake, as the search gives it, s."""
    t = mistake.readings.t
    if session.clock is not None or are_visits(mistake.track.t) or are_visits(t):
        return offset
    curve = coarse_costs(mistake.track, mistake.arm, mistake.readings, offset)
    return float(curve[np.argmin(curve[:, 1]), 0]) if len(curve) else offset


def _mistakes(session: Session, written: Mistake, *, among_all: bool) -> Iterator[Mistake]:
    """The usual mistakes of one joint's readings, or of all, the poses, the base and the arm."""
    for name, remedy, readings in joint_mistakes(written.readings):
        yield replace(written, name=name, remedy=remedy, readings=readings)
    if among_all:
        yield from session_mistakes(session, written)
        yield from registration_mistakes(session, written)
