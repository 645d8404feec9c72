"""Refuse readings that are not this arm's motion, and name the usual mistake that explains them.

A joint is off where |reading less measured angle| is above MAX_ERROR in a tenth of the pairs. What
faults of encoders may do is taken from the errors, joint by joint:

    error = offset + step (t > t0) + gain · angle        |offset| <= MAX_OFFSET, |gain| <= MAX_GAIN

A mistake that people make (a joint's sign, zero, unit, two joints exchanged, another base or arm)
is named where it leaves far less. Without one, the log is refused where one joint stays off as no
encoder is; or two do, and the screw motions from pair to pair disagree as well, which no
registration disturbs. Mistakes are ranked by

    median over pairs of |translation| / LEVER + |rotation|      flange as read to as measured

or, where base and body are not known, by the screw motions; the best are carried to the joints.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, islice
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from robots.library import example_names, names
from robots.transforms import difference
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.clock.search import are_visits, coarse_costs
from verify.analysis.measured import session_clock, setup_of
from verify.analysis.plausibility import usual_mistakes
from verify.analysis.relative_motion import MAX_TURN, MIN_TURN, screw_motion
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
MIN_CONDITION = 0.5  # of the typical one, as singular values go: a wrist stretched out tells little
HIGH = 0.9  # quantile over pairs: a joint is near 0 in most poses, and there its sign is nothing
MAX_STRAY = np.deg2rad(2.0)  # that faults and the clock leave, of joints and of screw motions
MAX_OFFSET = np.deg2rad(45.0)  # of an encoder that is at fault
MAX_GAIN = 0.1  # likewise; more is a wrong unit or ratio
MIN_TRAVEL = np.deg2rad(5.0)  # of a joint whose gain is sought
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
        InputError: names the mistake that explains the readings, or says that none does.
    """
    arm = session.arm
    if arm.dof != 6 or len(track) < 3 or np.median(track.known_dof) < 6:
        return
    written = Mistake(session.folder / "encoders.csv", "", "", readings, track, arm)
    if _is_frozen(written, clock.offset):
        raise _refusal(session, written, "the readings never change while the flange moves")
    typical = _large_error(written, clock.offset)
    if typical < MAX_ERROR:
        return
    off, faulty, left, factor, screws = _left_by_faults(session, written, clock)
    mistakes = [
        (mistake, _likely_offset(session, mistake, clock.offset))
        for mistake in _mistakes(session, written, factor, among_all=off > 1)
    ]
    named, remains = _best_by_joints(session, mistakes, left)
    if named is None and max(off, faulty - 1) > 1:  # after the rest: a free base fits as well
        placed = [(mistake, clock.offset) for mistake in _misplacements(session, written, clock)]
        named, remains = _best_by_joints(session, placed, left if off > 1 else typical)
    if named is not None:
        found = f"{named.name} fits: {_degrees(remains)} instead of {_degrees(typical)}"
        raise _refusal(session, named, found)
    if off > 1 and screws > MAX_STRAY:
        misfits = [screw_misfit(*mistake) for mistake in mistakes]
        best = int(np.argmin(misfits))
        if misfits[best] < min(MAX_STRAY, MAX_LEFT_SHARE * screws):
            named, misfit = mistakes[best][0], _degrees(misfits[best])
            found = f"{named.name} fits the flange's turns to {misfit} instead of"
            raise _refusal(session, named, f"{found} {_degrees(screws)}")
    elif left < MAX_OFFSET:
        return
    found = f"joints are off by {_degrees(typical)}, and no usual mistake or fault explains it"
    raise _refusal(session, written, found)


def _best_by_joints(
    session: Session, mistakes: list[tuple[Mistake, float]], left: float
) -> tuple[Mistake | None, float]:
    """The mistake that brings every joint far closer than faults do, if one does; its error, rad.

    With each mistake stands the clock's offset, s; `left`, rad: what faults leave.
    """
    scores = [pose_misfit(*mistake) for mistake in mistakes]
    best = min(MAX_ERROR, MAX_LEFT_SHARE * left)
    named: Mistake | None = None
    for place in np.argsort(scores)[:MAX_CARRIED].tolist():
        mistake = mistakes[place][0]
        tried = replace(session, arm=mistake.arm)
        offset = session_clock(tried, mistake.track, mistake.readings).offset
        remains = _large_error(mistake, offset)
        if remains < best:
            best, named = remains, mistake
        if remains < CLEAR_ERROR:
            break
    return named, best


def _sample(mistake: Mistake, offset: float) -> tuple[Array, Array]:
    """Poses (n, 4, 4) of some pairs as measured, and their readings (n, j), rad."""
    track = mistake.track
    known = np.flatnonzero(mistake.readings.available(track.t - offset))
    few = known[np.unique(np.linspace(0, len(known) - 1, min(len(known), MAX_PAIRS)).astype(int))]
    return track.base_T_flange[few], mistake.readings.at(track.t[few] - offset)


def _joint_errors(mistake: Mistake, offset: float) -> tuple[Array, Array]:
    """Reading less measured angle at some pairs, and that angle, (n, j) each, rad.

    No rows where they are unknown, or where the arm is near a singularity.
    """
    poses, q = _sample(mistake, offset)
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
    poses, q = _sample(mistake, offset)
    if len(q) < 3:
        return np.inf
    apart = difference(poses, robots.forward(mistake.arm, q))
    size = np.linalg.norm(apart.reshape(-1, 2, 3), axis=2) / [LEVER, 1.0]
    return float(np.median(size.sum(axis=1)))


def screw_misfit(mistake: Mistake, offset: float) -> float:
    """How far the flange's screw motions, as read, are from those measured, rad, typically."""
    poses, q = _sample(mistake, offset)
    read, apart = robots.forward(mistake.arm, q), []
    for shift in {max(len(q) // 2, 1), max(len(q) // 3, 1)}:
        told, found = (screw_motion(at[:-shift], at[shift:]) for at in (read, poses))
        clear = (found[:, 0] > MIN_TURN) & (found[:, 0] < MAX_TURN)
        apart.append(np.abs(told - found)[clear] / [1.0, LEVER])
    size = np.concatenate(apart).sum(axis=1)
    return float(np.median(size)) if len(size) else 0.0


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


def _left_by_faults(
    session: Session, written: Mistake, clock: ClockEstimate
) -> tuple[int, int, float, Array, float]:
    """The least that faults leave: the clock may be lost, the arm in another branch than read.

    Joints that stay off, in number; those with a fault beyond MAX_ERROR; the worst, rad; by which
    factor the readings of each joint turn farther than it, (j,), nan where unknown; what is left of
    the screw motions, rad.
    """
    offsets = dict.fromkeys([clock.offset, _likely_offset(session, written, clock.offset)])
    tried = []
    for offset in offsets:
        likely = min(_faults(written), key=lambda fault: pose_misfit(fault, offset))
        for log in (written, likely):
            error, angle = _joint_errors(log, offset)
            if len(error):
                error += written.readings.q[0] - log.readings.q[0]  # as written, in its branch
                fits = [_left_of_joint(e, a) for e, a in zip(error.T, angle.T, strict=True)]
                left, factor, middle = np.array(fits).T
            else:
                left, factor, middle = np.full((3, written.arm.dof), [[np.inf], [np.nan], [0.0]])
            off, faulty = int((left > MAX_STRAY).sum()), int((np.abs(middle) > MAX_ERROR).sum())
            tried.append((off, faulty, float(left.max()), factor, screw_misfit(log, offset)))
    return *min(tried, key=lambda one: one[:3])[:4], min(one[4] for one in tried)


def _left_of_joint(error: Array, angle: Array) -> tuple[float, float, float]:
    """What offset, step and gain leave of a joint's error (n,), rad; readings' factor; mean error.

    `angle` (n,), rad, as measured. The step is tried between any two pairs.
    """
    middle = float(np.angle(np.exp(1j * error).mean()))
    error = np.angle(np.exp(1j * (error - middle)))
    turned = angle - angle.mean()
    sought = np.ptp(angle) > MIN_TRAVEL
    late = np.arange(len(error)) >= np.arange(len(error))[:, None]
    least, factor = np.inf, np.nan
    for after in late:
        design = np.column_stack([np.ones(len(error)), after, turned * sought])
        gain = float(np.linalg.lstsq(design, error)[0][2])
        rest = error - np.clip(gain, -MAX_GAIN, MAX_GAIN) * turned
        for part in (after, ~after):
            rest[part] -= np.median(rest[part]) if part.any() else 0.0
        if (left := float(np.quantile(np.abs(rest), HIGH))) < least:
            least, factor = left, 1.0 + gain if sought else np.nan
    return max(least, abs(middle) if abs(middle) > MAX_OFFSET else 0.0), factor, middle


def _likely_offset(session: Session, mistake: Mistake, offset: float) -> float:
    """The clock's offset with a mistake, as the search gives it, s."""
    t = mistake.readings.t
    if session.clock is not None or are_visits(mistake.track.t) or are_visits(t):
        return offset
    curve = coarse_costs(mistake.track, mistake.arm, mistake.readings, offset)
    return float(curve[np.argmin(curve[:, 1]), 0]) if len(curve) else offset


def _mistakes(
    session: Session, written: Mistake, factor: Array, *, among_all: bool
) -> Iterator[Mistake]:
    """The usual mistakes of one joint's readings, or of all, the poses, the base and the arm.

    `factor` (j,), by which a joint's readings turn farther than the joint.
    """
    for name, remedy, readings in joint_mistakes(written.readings):
        yield replace(written, name=name, remedy=remedy, readings=readings)
    named = np.array([[1.0], [-1.0], [0.0]])  # as read, reversed; in radians, or standing
    for joint in np.flatnonzero(np.abs(factor - named).min(axis=0) > MAX_GAIN).tolist():
        scale, q = float(factor[joint]), written.readings.q.copy()
        q[:, joint] /= scale
        name = f"joint {joint + 1} scaled by {scale:.3g}"
        remedy = f"Divide the column q{joint + 1}_deg by {scale:.3g}."
        readings = Readings(written.readings.t, q)
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
    rig_T_body = session.instrument.poses.transforms[written.track.frame.astype(int)]
    base_T_rig = np.linalg.inv(session.rig.rig_T_base)
    do = "Write the body in the instrument's frame, not the instrument in the body's."
    for name, remedy, poses in (
        ("the poses inverted", do, np.linalg.inv(rig_T_body)),
        *usual_mistakes(rig_T_body, alone=False),
    ):
        moved = base_T_rig @ poses @ np.linalg.inv(session.instrument.flange_T_body)
        track = replace(written.track, base_T_flange=moved)
        yield replace(written, file=session.left.path, name=name, remedy=remedy, track=track)


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
    scaled = np.linalg.inv(rig_T_base) * [1.0, 1.0, 1.0, 1e3]
    scaled[3, 3] = 1.0
    file = session.folder / ("rig.toml" if session.instrument is None else "session.toml")
    stated = "Write the base in the rig's frame into [robot_base], not the rig in the base's."
    for name, remedy, base_T_rig in (
        ("the robot's base inverted", stated, rig_T_base),
        ("the robot's base in metres", "Multiply [robot_base] position_mm by 1000.", scaled),
    ):
        moved = replace(track, base_T_flange=base_T_rig @ rig_T_flange)
        yield replace(written, file=file, name=name, remedy=remedy, track=moved)
    for name in (*names(), *example_names()):
        arm = robots.load(name)
        if name != session.arm.name and arm.dof == session.arm.dof:
            remedy = f'Name robot = "{name}" in session.toml, if it is that one.'
            file = session.folder / "session.toml"
            yield replace(written, file=file, name=f"the robot {name}", remedy=remedy, arm=arm)


def _misplacements(session: Session, written: Mistake, clock: ClockEstimate) -> Iterator[Mistake]:
    """The base, or the body on the flange, where the poses have it and far from where it is said.

    Not a base that is said to be as doubtful as that.
    """
    known, posed = session.rig.covariance, session.instrument is not None
    stated = () if known is None else zip(known.parameters, known.standard_uncertainty, strict=True)
    doubt = np.deg2rad(max((u for name, u in stated if name.startswith("robot_base.r")), default=0))
    for what, holder, limit in (
        ("the robot's base", "rig.toml", max(MAX_ERROR, 3 * doubt)),
        ("the body on the flange", "marker.toml", MAX_ERROR),
    ):
        offset, track, moved = clock.offset, written.track, np.eye(4)
        for _ in range(2):  # the clock, too, is found anew
            poses, q = _sample(written, offset)
            if not len(q):
                return
            flange_T_base = np.linalg.inv(robots.forward(written.arm, q))
            at, of_base = written.track.base_T_flange, holder == "rig.toml"
            moved = _middle(poses @ flange_T_base if of_base else flange_T_base @ poses)
            back = np.linalg.inv(moved)
            track = replace(written.track, base_T_flange=back @ at if of_base else at @ back)
            offset = session_clock(session, track, written.readings).offset
        turn = float(Rotation.from_matrix(moved[:3, :3]).magnitude())
        shift = float(np.linalg.norm(moved[:3, 3]))
        if turn + shift / LEVER > limit:
            yield replace(
                written,
                file=session.folder / ("session.toml" if posed else holder),
                name=f"{what} turned by {_degrees(turn)} and shifted by {shift * 1e3:.0f} mm",
                remedy="Nothing can be judged by that registration: register again.",
                track=track,
            )


def _middle(poses: Array) -> Array:
    """The rigid motion (4, 4) amid poses (n, 4, 4)."""
    found = np.median(poses, axis=0)
    found[:3, :3] = Rotation.from_matrix(poses[:, :3, :3]).mean().as_matrix()
    return np.asarray(found)


def _refusal(session: Session, mistake: Mistake, found: str) -> InputError:
    return InputError(
        mistake.file,
        f"the readings are not this arm's motion: {found}",
        f"readings of {session.arm.name} in the robot file's sense, zero and order",
        mistake.remedy or "Check that log, robot and registration belong to this recording.",
    )


def _degrees(angle: float) -> str:
    return f"{np.rad2deg(angle):.2g}°" if np.isfinite(angle) else "more than the arm can reach"
