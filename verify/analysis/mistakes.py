"""Refuse readings that are not this arm's motion, and name the usual mistake that explains them.

A joint is off where the median over pairs of |reading less measured angle| is above MAX_ERROR. One
or two joints that are off may be faults, however large; they are refused only where a mistake that
people make (a joint's sign, its zero, its unit, two joints exchanged, another base or arm) brings
every joint below MAX_ERROR, and no constant error of a joint explains them as well. Where three or
more are off, no mistake explains them, and the turns of the flange from pair to pair disagree as
well, the log is not of this motion. Mistakes are ranked by

    median over pairs of |translation| / LEVER + |rotation|      flange as read to as measured

or, where base and body are not known, by the turns alone; only the best are carried through to the
joints.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, islice
from pathlib import Path

import numpy as np

import robots
from robots.library import example_names, names
from robots.transforms import difference
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.clock.search import are_visits, coarse_costs
from verify.analysis.instrument import measure_poses, stated_noise
from verify.analysis.kernels import motion_sizes
from verify.analysis.measured import session_clock, setup_of
from verify.analysis.plausibility import usual_mistakes
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.session.session import Session
from verify.measurement.chain import measure
from verify.measurement.track import Track, collect_track

MAX_ERROR = np.deg2rad(5.0)
CLEAR_ERROR = np.deg2rad(1.0)  # so close that no other mistake is tried
MAX_PAIRS = 60  # that are compared for each mistake
MIN_REACHED = 0.5  # of the pairs
MIN_JOINTS_OFF = 3  # fewer may be faults
MAX_TURN_MISFIT = 0.3  # of the turns from pair to pair, which no registration disturbs
MAX_OFFSET = np.deg2rad(45.0)  # of an encoder that is at fault
FAULT_STEP = np.deg2rad(5.0)  # from one offset that is tried to the next
MAX_LEFT_SHARE = 0.25  # of what a fault leaves: a mistake has to explain the motion better
LEVER = 0.3  # m: a distance over it counts as an angle
MAX_CARRIED = 4  # mistakes, to the joints
MAX_EXCHANGED_PAIRS = 40  # that are measured with the cameras exchanged
CAMERAS_EXCHANGED = (
    "left and right exchanged",
    "Exchange the pictures of left and right in session.toml.",
)
MAX_FROZEN = np.deg2rad(0.01)  # by which readings of a standing log differ
ZERO_ERRORS_DEG = (90, -90, 180)


@dataclass(frozen=True, slots=True)
class Mistake:
    """A session as it would be without a mistake."""

    file: Path  # that holds it
    name: str
    remedy: str
    readings: Readings
    track: Track
    arm: robots.Arm


def refuse_other_motion(
    session: Session, track: Track, readings: Readings, clock: ClockEstimate
) -> None:
    """Refuse readings that are not this arm's motion.

    Raises:
        InputError: names the mistake that explains the readings, or the joints that are off.
    """
    arm = session.arm
    if arm.dof != 6 or len(track) < 3 or np.median(track.known_dof) < 6:
        return
    written = Mistake(session.folder / "encoders.csv", "", "", readings, track, arm)
    error = _joint_errors(written, clock.offset)
    typical = _typical(error)
    off = np.flatnonzero(~(typical < MAX_ERROR)).tolist()
    if _is_frozen(written, clock.offset):
        raise _refusal(session, typical, off, "the readings never change while the flange moves")
    if not off:
        return
    many = len(off) >= MIN_JOINTS_OFF
    faults = list(_faults(written)) if many else []
    left = _left_by_faults(error, faults, clock.offset)
    mistakes = list(_mistakes(session, written, among_all=many))
    offsets = [_likely_offset(session, mistake, clock.offset) for mistake in mistakes]
    _refuse_by_joints(session, mistakes, offsets, (typical, off, left))
    if not many or left < MAX_ERROR or turn_misfit(written, clock.offset) < MAX_TURN_MISFIT:
        return
    by_fault = min(turn_misfit(fault, clock.offset) for fault in faults)
    turns = [turn_misfit(m, offset) for m, offset in zip(mistakes, offsets, strict=True)]
    best = int(np.argmin(turns))
    if turns[best] < MAX_LEFT_SHARE * by_fault:
        reason = f"{mistakes[best].name} fits the flange's turns to {100 * turns[best]:.2g} %"
        raise _refusal(session, typical, off, reason, mistakes[best])
    if by_fault > MAX_TURN_MISFIT:
        raise _refusal(session, typical, off, "no usual mistake explains it")


def _refuse_by_joints(
    session: Session,
    mistakes: list[Mistake],
    offsets: list[float],
    found: tuple[Array, list[int], float],
) -> None:
    """Refuse where a mistake brings every joint closer than a fault does.

    `offsets`, s: the clock's with each mistake; `found`: each joint's typical error, rad, the
    joints that are off, what faults leave, rad.
    """
    typical, off, left = found
    scores = [pose_misfit(m, offset) for m, offset in zip(mistakes, offsets, strict=True)]
    best = min(MAX_ERROR, MAX_LEFT_SHARE * left)
    named: Mistake | None = None
    for place in np.argsort(scores)[:MAX_CARRIED].tolist():
        mistake = mistakes[place]
        tried = replace(session, arm=mistake.arm)
        offset = session_clock(tried, mistake.track, mistake.readings).offset
        remains = float(_typical(_joint_errors(mistake, offset)).max())
        if remains < best:
            best, named = remains, mistake
        if remains < CLEAR_ERROR:
            break
    if named is not None:
        raise _refusal(session, typical, off, f"{named.name} fits: {_degrees(best)} instead", named)


def _sample(mistake: Mistake, offset: float) -> tuple[Array, Array]:
    """Poses (n, 4, 4) of some pairs as measured, and their readings (n, j), rad."""
    track = mistake.track
    known = np.flatnonzero(mistake.readings.available(track.t - offset))
    few = known[np.unique(np.linspace(0, len(known) - 1, min(len(known), MAX_PAIRS)).astype(int))]
    return track.base_T_flange[few], mistake.readings.at(track.t[few] - offset)


def _joint_errors(mistake: Mistake, offset: float) -> Array:
    """Reading less measured angle at some pairs, (n, j), rad; no rows where they are unknown."""
    poses, q = _sample(mistake, offset)
    none = np.zeros((0, mistake.arm.dof))
    if len(q) < 3:
        return none
    measured, reached = robots.nearest(mistake.arm, poses, q)
    if reached.mean() < MIN_REACHED:
        return none
    error = (q - measured)[reached]
    wrapped: Array = np.arctan2(np.sin(error), np.cos(error))
    return wrapped


def _typical(error: Array) -> Array:
    """Median of each joint's |error|, (j,), rad; inf where it is unknown."""
    if not len(error):
        return np.full(error.shape[1], np.inf)
    typical: Array = np.median(np.abs(error), axis=0)
    return typical


def pose_misfit(mistake: Mistake, offset: float) -> float:
    """How far the flange as read is from the flange as measured, rad, typically."""
    poses, q = _sample(mistake, offset)
    if len(q) < 3:
        return np.inf
    apart = difference(poses, robots.forward(mistake.arm, q))
    size = np.linalg.norm(apart.reshape(-1, 2, 3), axis=2) / [LEVER, 1.0]
    return float(np.median(size.sum(axis=1)))


def turn_misfit(mistake: Mistake, offset: float) -> float:
    """How far the flange's turns from pair to pair, as read, are off; a share of the turns."""
    poses, q = _sample(mistake, offset)
    if len(q) < 3:
        return np.inf
    sizes = np.empty((2, len(q) - 1, 2))
    for size, at in zip(sizes, (poses, robots.forward(mistake.arm, q)), strict=True):
        motion_sizes(np.ascontiguousarray(at[:-1]), np.ascontiguousarray(at[1:]), size)
    angle = sizes[:, :, 0]
    typical = float(np.median(angle[0]))
    return float(np.median(np.abs(angle[0] - angle[1]))) / typical if typical > 0 else 0.0


def _is_frozen(written: Mistake, offset: float) -> bool:
    """Whether the readings stand while the flange turns."""
    poses, _ = _sample(written, offset)
    if np.ptp(written.readings.q, axis=0).max() > MAX_FROZEN or not len(poses):
        return False
    turned = np.linalg.norm(difference(poses, poses[0])[:, 3:], axis=1)
    return bool(turned.max() > CLEAR_ERROR)


def _faults(written: Mistake) -> Iterator[Mistake]:
    """The readings without a constant error of one joint, all that a fault may have."""
    count = round(MAX_OFFSET / FAULT_STEP)
    for joint in range(written.arm.dof):
        for step in (*range(-count, 0), *range(1, count + 1)):
            q = written.readings.q.copy()
            q[:, joint] -= step * FAULT_STEP
            yield replace(written, readings=Readings(written.readings.t, q))


def _left_by_faults(error: Array, faults: list[Mistake], offset: float) -> float:
    """What constant errors of the joints, or of one where many are off, leave of the error, rad."""
    if faults:  # the arm may stand in another branch than readings that are far off say
        likely = min(faults, key=lambda fault: pose_misfit(fault, offset))
        error = _joint_errors(likely, offset)
        if not len(error):
            return np.inf
        worst = int(np.argmax(np.abs(np.median(error, axis=0))))
        error[:, worst] -= np.median(error[:, worst])
        return float(_typical(error).max())
    middle = np.median(error, axis=0)
    if np.abs(middle).max() > MAX_OFFSET:
        return np.inf
    return float(_typical(error - middle).max())


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
        yield from _pose_mistakes(session, written)
        yield from _registration_mistakes(session, written)


def joint_mistakes(readings: Readings) -> Iterator[tuple[str, str, Readings]]:
    """The usual mistakes of one joint, or two: name, remedy, the readings without it."""
    for name, remedy, columns in _column_mistakes(readings.q):
        q = readings.q.copy()
        for joint, column in columns.items():
            q[:, joint] = column
        yield name, remedy, Readings(readings.t, q)


def _column_mistakes(q: Array) -> Iterator[tuple[str, str, dict[int, Array]]]:
    """Name, remedy, and what the joints' columns (m,) of readings (m, j), rad, would be without."""
    joints = range(q.shape[1])
    for j in joints:
        name, column = f"joint {j + 1}", f"q{j + 1}_deg"
        yield f"{name} reversed", f"Multiply the column {column} by -1.", {j: -q[:, j]}
        for zero in ZERO_ERRORS_DEG:
            what = f"{name} with its zero moved by {zero:+d}°"
            yield what, f"Add {zero:+d} to the column {column}.", {j: q[:, j] + np.deg2rad(zero)}
        in_degrees = {j: np.rad2deg(q[:, j])}
        yield f"{name} taken as radians", f"Multiply the column {column} by 180/π.", in_degrees
        for sign, add in ((1, f"Add q{j} to"), (-1, f"Subtract q{j} from")) if j else ():
            what = f"{name} coupled to joint {j}, its link turning with both,"
            line = f"linkage = {{q{j} = {sign}}} at joint {j + 1} of the arm"
            yield what, f"{add} q{j + 1}, or write {line}.", {j: q[:, j] + sign * q[:, j - 1]}
    for i, k in combinations(joints, 2):
        exchange = f"Exchange the columns q{i + 1}_deg and q{k + 1}_deg."
        yield f"joints {i + 1} and {k + 1} exchanged", exchange, {i: q[:, k], k: q[:, i]}


def _pose_mistakes(session: Session, written: Mistake) -> Iterator[Mistake]:
    """An instrument's poses inverted or in another order; the cameras exchanged."""
    if session.instrument is None:
        exchanged = exchanged_track(session)
        if len(exchanged) >= 3:
            file, (name, remedy) = session.left.path, CAMERAS_EXCHANGED
            yield replace(written, file=file, name=name, remedy=remedy, track=exchanged)
        return
    base = session.rig.rig_T_base
    body = session.instrument.flange_T_body
    rig_T_body = base @ written.track.base_T_flange @ body
    inverse = np.linalg.inv(base) @ np.linalg.inv(rig_T_body) @ np.linalg.inv(body)
    yield replace(
        written,
        file=session.left.path,
        name="the poses inverted",
        remedy="Write the body in the instrument's frame, not the instrument in the body's.",
        track=replace(written.track, base_T_flange=inverse),
    )
    for poses, found, _, remedy in usual_mistakes(session.instrument.poses):
        other = replace(session.instrument, poses=poses)
        track = measure_poses(session, other, written.readings, stated_noise(other)).track
        yield replace(written, file=session.left.path, name=found, remedy=remedy, track=track)


def exchanged_track(session: Session) -> Track:
    """The first pairs as they would be measured with left and right exchanged."""
    exchanged = replace(session, left=session.right, right=session.left)
    pairs = islice(exchanged.pairs(), MAX_EXCHANGED_PAIRS)
    measured = [m for m in measure(pairs, setup_of(session)) if m.status == "measured"]
    return collect_track(measured, session.rig, [np.zeros((6, 0))] * len(measured))


def refuse_exchanged_cameras(session: Session) -> None:
    """Refuse pictures that no pair was measured in, if it can be with left and right exchanged.

    Raises:
        InputError: left and right are exchanged.
    """
    count, tried = len(exchanged_track(session)), min(len(session), MAX_EXCHANGED_PAIRS)
    if count >= max(MIN_REACHED * tried, 3):
        found = f"no pair could be measured; {CAMERAS_EXCHANGED[0]} fits: {count} of {tried}"
        expected = "the left camera's pictures, of the rig's left camera"
        raise InputError(session.left.path, found, expected, CAMERAS_EXCHANGED[1])


def _registration_mistakes(session: Session, written: Mistake) -> Iterator[Mistake]:
    """The base the wrong way round or in another unit, and the other arms."""
    track, rig_T_base = written.track, session.rig.rig_T_base
    rig_T_flange = rig_T_base @ track.base_T_flange
    file = session.folder / ("rig.toml" if session.instrument is None else "session.toml")
    for name, remedy, base_T_rig in (
        (
            "the robot's base inverted",
            "Write the base in the rig's frame into [robot_base], not the rig in the base's.",
            rig_T_base,
        ),
        (
            "the robot's base in metres",
            "Multiply [robot_base] position_mm by 1000.",
            _inverse_of_scaled(rig_T_base, 1e3),
        ),
    ):
        moved = replace(track, base_T_flange=base_T_rig @ rig_T_flange)
        yield replace(written, file=file, name=name, remedy=remedy, track=moved)
    for name in (*names(), *example_names()):
        arm = robots.load(name)
        if name != session.arm.name and arm.dof == session.arm.dof:
            remedy = f'Name robot = "{name}" in session.toml, if it is that one.'
            file = session.folder / "session.toml"
            yield replace(written, file=file, name=f"the robot {name}", remedy=remedy, arm=arm)


def _inverse_of_scaled(rig_T_base: Array, factor: float) -> Array:
    """The inverse of a base whose position is multiplied by a factor."""
    scaled = rig_T_base.copy()
    scaled[:3, 3] *= factor
    return np.asarray(np.linalg.inv(scaled), dtype=np.float64)


def _refusal(
    session: Session, error: Array, off: list[int], reason: str, mistake: Mistake | None = None
) -> InputError:
    joints = ", ".join(str(j + 1) for j in off)
    where = f"joint{'s' if len(off) > 1 else ''} {joints}"
    return InputError(
        session.folder / "encoders.csv" if mistake is None else mistake.file,
        f"the readings are not this arm's motion: {where} off by {_degrees(float(error.max()))}, "
        f"typically; {reason}",
        f"readings of {session.arm.name} in the robot file's sense, zero and order",
        "Check that log, robot and registration belong to this recording."
        if mistake is None
        else mistake.remedy,
    )


def _degrees(angle: float) -> str:
    return f"{np.rad2deg(angle):.2g}°" if np.isfinite(angle) else "more than the arm can reach"
