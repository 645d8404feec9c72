"""The usual mistakes of readings, poses and registrations, each taken back.

Joints' signs or units, a zero, two joints exchanged, a link that turns with two; poses in metres,
in another order or inverted; cameras or their times exchanged, one film for both; a base inverted,
in metres or elsewhere; another arm.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations, islice, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from robots.library import example_names, names
from robots.transforms import carry, difference, invert, misplacement
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.measured import SAME_PAN, session_clock, setup_of
from verify.analysis.results.warnings import MAX_LOST_SHARE
from verify.core.readings import Readings
from verify.core.records import Array, Measurement, StereoPair, rigid_transform
from verify.errors import InputError
from verify.io.poses import POSITION, QUATERNION
from verify.io.session.session import Session
from verify.measurement.chain import Setup, measure
from verify.measurement.correspondence.assign import assign_leds
from verify.measurement.track import Track

MAX_PAIRS = 60  # that are compared for each mistake
MAX_PAN_PAIRS = 16  # in a row, that are tried with other pan readings
MIN_TURNED = np.deg2rad(5.0)  # by which a base or body is elsewhere, or shifted as far at LEVER
MIN_SIGN_LEAP = np.deg2rad(4.0)  # of a reading to its mirrored angle, from one to the next
MAX_MIRRORED = 0.01  # m, of an LED from its mirrored place: base and joints are off, too
LEVER = 0.3  # m: a distance over it counts as an angle
MAX_LEFT_LOST = 0.25  # of lost pairs, with a mistake in the pan readings taken back
BASE_TURNS = np.deg2rad(np.arange(-28.0, 29.0, 4.0))  # from where it is read, that are tried
CLEAR_BASE_TURN = np.deg2rad(1.0)  # lengths off by 2 % look like 0.3°, and fit as well
MAX_SHIFT_PX = 60.0  # of the right picture by such a turn: more than half a step
MAX_TURN_PAIRS, MAX_TURN_STEPS = 4, 6
PAIR_COLUMNS = ("pan_left", "pan_right", "t_left", "t_right")
ZERO_ERRORS_DEG = (90, -90, 180)
REVERSE = "Multiply that column by -1."


@dataclass(frozen=True, slots=True)
class Mistake:
    """A session as it would be without a mistake."""

    file: Path  # that holds it
    name: str
    remedy: str
    readings: Readings
    track: Track
    arm: robots.Arm


def sample(mistake: Mistake, offset: float, most: int = MAX_PAIRS) -> tuple[Array, Array]:
    """Poses (n, 4, 4) of at `most` so many pairs as measured, and their readings (n, j), rad."""
    track = mistake.track
    known = np.flatnonzero(mistake.readings.available(track.t - offset))
    few = known[np.unique(np.linspace(0, len(known) - 1, min(len(known), most)).astype(int))]
    return track.base_T_flange[few], mistake.readings.at(track.t[few] - offset)


def joint_mistakes(readings: Readings) -> Iterator[tuple[str, str, Readings]]:
    """The usual mistakes of one joint, or two: name, remedy, the readings without it."""
    t, written = readings.t, readings.q
    for name, remedy, columns in chain(_column_mistakes(written), _sign_changes(t, written)):
        q = written.copy()
        for joint, column in columns.items():
            q[:, joint] = column
        yield name, remedy, Readings(t, q)


def _column_mistakes(q: Array) -> Iterator[tuple[str, str, dict[int, Array]]]:
    """Name, remedy, and what the joints' columns (m,) of readings (m, j), rad, would be without."""
    joints = range(q.shape[1])
    # a registration that is turned about the first or the last axis shows the same
    ends = {0: "the robot's base", len(joints) - 1: "the LEDs on the flange"}
    for j in joints:
        name, column = f"joint {j + 1}", f"q{j + 1}_deg"
        yield f"{name} reversed", f"Multiply the column {column} by -1.", {j: -q[:, j]}
        for zero in ZERO_ERRORS_DEG:
            what = f"{name} with its zero moved by {zero:+d}°"
            turned = f", or correct the place of {ends[j]}, if that is turned" if j in ends else ""
            remedy = f"Add {zero:+d} to the column {column}{turned}."
            yield what, remedy, {j: q[:, j] + np.deg2rad(zero)}
        in_degrees = {j: np.rad2deg(q[:, j])}
        yield f"{name} taken as radians", f"Multiply the column {column} by 180/π.", in_degrees
        for sign, add in ((1, f"Add q{j} to"), (-1, f"Subtract q{j} from")) if j else ():
            what = f"{name} coupled to joint {j}, its link turning with both,"
            line = f"linkage = {{q{j} = {sign}}} at joint {j + 1} of the arm"
            yield what, f"{add} q{j + 1}, or write {line}.", {j: q[:, j] + sign * q[:, j - 1]}
    # numbers below a turn may be radians
    small = [j for j in joints if np.abs(q[:, j]).max() < np.deg2rad(2 * np.pi)]
    for some, columns, group in _groups(small, len(joints)):
        remedy = f"Multiply the columns {columns} by 180/π."
        yield f"{some} taken as radians", remedy, {j: np.rad2deg(q[:, j]) for j in group}
    for i, k in combinations(joints, 2):
        exchange = f"Exchange the columns q{i + 1}_deg and q{k + 1}_deg."
        yield f"joints {i + 1} and {k + 1} exchanged", exchange, {i: q[:, k], k: q[:, i]}


def _groups(some: Sequence[int], dof: int) -> Iterator[tuple[str, str, tuple[int, ...]]]:
    """Two or more of some joints, and all `dof` of them: name, columns, indices."""
    groups = (group for n in range(2, dof) for group in combinations(some, n))
    for group in (*groups, tuple(range(dof))):
        name = "joints " + ", ".join(str(j + 1) for j in group)
        columns = ", ".join(f"q{j + 1}_deg" for j in group)
        yield name if len(group) < dof else "all joints", columns, group


def _sign_changes(t: Array, q: Array) -> Iterator[tuple[str, str, dict[int, Array]]]:
    """Joints whose largest leap is to their mirrored angle: without, either side mirrored back."""
    leap = np.diff(q, axis=0)
    for j in range(q.shape[1] if len(leap) else 0):
        k = int(np.argmax(np.abs(leap[:, j])))
        if np.abs(leap[k, j]) < MIN_SIGN_LEAP or np.abs(q[k, j] + q[k + 1, j]) > MIN_SIGN_LEAP / 2:
            continue
        for side, sign in (("before", -1.0), ("from there on", 1.0)):
            without = q[:, j] * np.where(np.arange(len(q)) > k, -sign, sign)
            name = f"joint {j + 1} with its sign changed at t_s = {t[k + 1]:.2f}"
            yield name, f"Multiply the column q{j + 1}_deg by -1 {side}.", {j: without}


def pose_mistakes(poses: Array, *, alone: bool) -> Iterator[tuple[str, str, Array]]:
    """The usual mistakes in poses (n, 4, 4), m: name, remedy, the poses without it.

    `alone`: positions alone were measured; a free base takes any of three mirrors for another.
    """
    mirrors = [1 - 2 * np.eye(3)[k] for k in range(3)]
    names = ["one of x_mm, y_mm, z_mm" if alone else f"the column {name}" for name in POSITION]
    for name, remedy, factor in (
        ("an export in metres", "Multiply the positions by 1000.", np.full(3, 1e3)),
        *((f"{n} reversed", REVERSE, one) for n, one in zip(names, mirrors, strict=True)),
    ):
        without = poses.copy()
        without[:, :3, 3] *= factor
        yield name, remedy, without
    if alone:
        return
    xyzw = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    named = "Put the names qw, qx, qy, qz in the order in which the numbers stand."
    for name, remedy, turn in (
        ("a quaternion whose scalar comes last", named, np.roll(xyzw, 1, axis=1)),
        *((f"the column {n} reversed", REVERSE, xyzw * (1 - 2 * np.eye(4)[k - 1]))
          for k, n in enumerate(QUATERNION)),
    ):  # fmt: skip
        without = poses.copy()
        without[:, :3, :3] = Rotation.from_quat(turn).as_matrix()
        yield name, remedy, without


def scaled_joints(written: Mistake, factor: Array, doubt: float) -> Iterator[Mistake]:
    """Joints whose readings turn `factor` (j,) times as far as they, where that is not usual.

    `doubt`: by which a factor differs from one that a fault or a usual mistake has.
    """
    usual = np.array([[1.0], [-1.0], [0.0]])  # as read, reversed; in radians, or standing
    for joint in np.flatnonzero(np.abs(factor - usual).min(axis=0) > doubt).tolist():
        scale, q = float(factor[joint]), written.readings.q.copy()
        q[:, joint] /= scale
        name = f"joint {joint + 1} scaled by about {scale:.2g}"
        remedy = f"Divide the column q{joint + 1}_deg by that scale."
        readings = Readings(written.readings.t, q)
        yield replace(written, name=name, remedy=remedy, readings=readings)


def session_mistakes(session: Session, written: Mistake) -> Iterator[Mistake]:
    """Several joints reversed; an instrument's poses inverted or in another order."""
    t, q = written.readings.t, written.readings.q
    for some, columns, group in _groups(range(q.shape[1]), q.shape[1]):
        remedy = f"Multiply the columns {columns} by -1."
        readings = Readings(t, q * (1 - 2 * np.isin(np.arange(q.shape[1]), group)))
        yield replace(written, name=f"{some} reversed", remedy=remedy, readings=readings)
    if session.instrument is None:
        return
    rig_T_body = session.instrument.poses.transforms[written.track.frame.astype(int)]
    base_T_rig = np.linalg.inv(session.rig.rig_T_base)
    do = "Write the body in the instrument's frame, not the instrument in the body's."
    for name, remedy, poses in (
        ("the poses inverted", do, np.linalg.inv(rig_T_body)),
        *pose_mistakes(rig_T_body, alone=False),
    ):
        moved = base_T_rig @ poses @ np.linalg.inv(session.instrument.flange_T_body)
        track = replace(written.track, base_T_flange=moved)
        yield replace(written, file=session.left.path, name=name, remedy=remedy, track=track)


def refuse_misread_pans(session: Session, measurements: Sequence[Measurement]) -> None:
    """Refuse pictures that usual mistakes in rig, marker and pan readings set against each other.

    They are tried where many pairs are lost; another zero of a base, where nearly all are.

    Raises:
        InputError: names the columns or keys, and what is wrong in them.
    """
    lost = np.array([m.status != "measured" for m in measurements])
    if lost.sum() <= MAX_LOST_SHARE * len(lost):
        return
    size = min(MAX_PAN_PAIRS, len(lost))
    there = np.convolve(lost, np.ones(size), "valid")
    first, fits, setup = int(np.argmax(there)), [], setup_of(session)
    read = list(islice(session.pairs(), first, first + size))  # once, as a film takes its time
    spots = {pair.frame: setup.detect(pair, None, None) for pair in read}
    shown = any(len(left.centre) for left, _ in spots.values())
    if shown and all(np.array_equal(pair.left, pair.right) for pair in read):
        found, remedy = "its pictures are those of the left camera", "Name its own in session.toml."
        raise InputError(session.right.path, found, "pictures of the right camera", remedy)
    setup = replace(setup, detect=lambda pair, *_: spots[pair.frame])
    turns = _base_turns(read, setup) if lost.mean() > 1 - MAX_LOST_SHARE else ()
    remedy = "Exchange the pictures of left and right in session.toml."
    written = np.stack([getattr(session.frames, name) for name in PAIR_COLUMNS])
    other_side = {"detect": lambda pair, *_: spots[pair.frame][::-1]}
    exchanged = session.left.path, "left and right exchanged", remedy, written, other_side
    for *named, mended, without in (*_picture_mistakes(session, written, turns), exchanged):
        pairs = (
            replace(pair, **dict(zip(PAIR_COLUMNS, mended[:, pair.frame].tolist(), strict=True)))
            for pair in read
        )
        tried = measure(pairs, replace(setup, **without))
        fits.append((sum(m.status == "measured" for m in tried), named))
    most = max(count for count, *_ in fits)
    if size - most <= MAX_LEFT_LOST * there[first] and most > fits[0][0]:
        files, names, remedies = zip(*(named for n, named in fits if n == most), strict=True)
        pans = files[0].name == "frames.csv" and not names[0].startswith("t_")
        raise InputError(
            files[0],
            f"the pictures do not agree with {'the pan readings' if pans else 'it'}; "
            f"{' or '.join(dict.fromkeys(names))} fits: "
            f"{most} of {size} pairs from frame {measurements[first].frame} on can be measured, "
            f"not {size - there[first]:.0f}",
            "pan angles in degrees, in rig.toml's sense, and places in millimetres are expected",
            " Or: ".join(dict.fromkeys(remedies)),
        )


def _picture_mistakes(
    session: Session, written: Array, turns: Collection[tuple[int, float]]
) -> Iterator[tuple[Path, str, str, Array, dict[str, Any]]]:
    """As written, then the usual mistakes that set pictures against each other: file, name, remedy.

    With them what would be without: PAIR_COLUMNS (4, n), as `written`; rig or marker, if it is in
    these. `turns`: side and angle, rad, by which bases may be off.
    """
    pan = written[:2]
    rig, marker = session.rig, session.marker
    rig_file = session.rig_file or session.folder / "rig.toml"
    file, columns = session.folder / "frames.csv", ("pan_left_deg", "pan_right_deg")
    if not (pan - [[rig.left.pan], [rig.right.pan]]).any():  # none there
        file, columns = rig_file, ("left.pan_deg", "right.pan_deg")
    yield file, "as written", "", written, {}
    times, frames_file = ("t_left_s", "t_right_s"), session.folder / "frames.csv"
    for where, two, order in ((file, columns, [1, 0, 2, 3]), (frames_file, times, [0, 1, 3, 2])):
        yield where, f"{' and '.join(two)} exchanged", "Exchange these two.", written[order], {}
    for sides, name in (([0, 1], " and ".join(columns)), *(([k], columns[k]) for k in (0, 1))):
        for what, remedy, without in (
            ("reversed", "Multiply {} by -1.", -pan),
            ("in radians", "Multiply {} by 180/π.", np.rad2deg(pan)),
            ("a row too late", "Move {} up by one row.", np.roll(pan, -1, axis=1)),
            ("a row too early", "Move {} down by one row.", np.roll(pan, 1, axis=1)),
        ):
            mended = written.copy()
            mended[sides] = without[sides]
            yield file, f"{name} {what}", remedy.format(name), mended, {}
    for side, turn in turns:
        by, camera = f"about {abs(np.rad2deg(turn)):.1f}°", ("left", "right")[side]
        name = f"{columns[side]} {by} too {'small' if turn > 0 else 'large'}"
        keys = f"that base's zero or {camera}.pan_zero_deg"
        if abs(turn) < CLEAR_BASE_TURN:
            name = f"one base {by} from where it is read, or lengths off by some per cent,"
            keys = "a base's zero, camera_matrix, pan_center_mm or position_mm of the LEDs"
        remedy = f"Correct {keys}, if entered wrong; else calibrate again: the figure is rough."
        yield file, name, remedy, written + np.eye(4)[side][:, None] * turn, {}
    marker_file = session.marker_file or session.folder / "marker.toml"
    for unit, size in (("centimetres", 10.0), ("inches", 25.4), ("metres", 1000.0)):
        left, right = (replace(c, pan_center=c.pan_center * size) for c in (rig.left, rig.right))
        leds, remedy = replace(marker, leds=marker.leds * size), f"Multiply them by {size:g}."
        placed = {"rig": replace(rig, left=left, right=right)}
        yield rig_file, f"pan_center_mm in {unit}", remedy, written, placed
        yield marker_file, f"position_mm of the LEDs in {unit}", remedy, written, {"marker": leds}


def _base_turns(read: Sequence[StereoPair], setup: Setup) -> set[tuple[int, float]]:
    """Turns, rad, of either base (0 left, 1 right) from where it is read, by which rays meet."""
    right, leds, found = setup.rig.right, setup.marker.leds, set()
    along = np.sign(right.pan_axis[1]) / right.matrix[0, 0]
    for side, turn in product((0, 1), BASE_TURNS.tolist()):
        for _ in range(MAX_TURN_STEPS):
            shifts: list[float] = []
            for pair in read[:: max(len(read) // MAX_TURN_PAIRS, 1)]:
                spots = setup.detect(pair, None, None)
                pans = pair.pan_left + turn * (1 - side), pair.pan_right + turn * side
                led = assign_leds(
                    spots, setup.rig, pans, setup.marker, motion_tolerance_px=MAX_SHIFT_PX,
                    expected=partial(setup.expected, pair.t_left),
                )  # fmt: skip
                if led.rig_T_flange is not None and len(led.right_led):
                    to_camera = right.camera_T_rig(pans[1]) @ led.rig_T_flange
                    there = right.project(carry(to_camera, leds[led.right_led]))
                    shifts.append((spots[1].centre[led.right_spot] - there)[:, 0].mean())
            if len(shifts) < 2:
                break
            turn += (1 - 2 * side) * along * float(np.median(shifts))
        if len(shifts) > 1 and abs(turn) > SAME_PAN:
            found.add((side, round(turn, 4)))
    return found


def registration_mistakes(session: Session, written: Mistake) -> Iterator[Mistake]:
    """The base the wrong way round or in another unit, and the other arms."""
    track, rig_T_base = written.track, session.rig.rig_T_base
    rig_T_flange = rig_T_base @ track.base_T_flange
    scaled = np.linalg.inv(rig_T_base) * [1.0, 1.0, 1.0, 1e3]
    scaled[3, 3] = 1.0
    file = session.rig_file or session.folder / "session.toml"
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


def misplacements(session: Session, written: Mistake, clock: ClockEstimate) -> Iterator[Mistake]:
    """The base, or the body on the flange, where the poses have it and far from where it is said.

    Whichever fits better; not a base that is said to be as doubtful as that.
    """
    found: list[tuple[float, Mistake | None, Track]] = []
    for of_base in (True, False):
        offset, track, least, moved = clock.offset, written.track, np.inf, np.eye(4)
        for _ in range(2):  # the clock, too, is found anew
            poses, q = sample(written, offset)
            if not len(q):
                return
            read, at = robots.forward(written.arm, q), written.track.base_T_flange
            base, body = misplacement(poses, read, of_base=of_base, of_body=not of_base)
            left = difference(invert(base) @ poses @ invert(body), read)
            left[:, :3] /= LEVER
            least, moved = float(np.median(np.linalg.norm(left, axis=1))), base @ body
            track = replace(written.track, base_T_flange=invert(base) @ at @ invert(body))
            offset = session_clock(session, track, written.readings).offset
        found.append((least, _misplaced(session, written, moved, of_base=of_base), track))
    _, mistake, track = min(found, key=lambda one: one[0])
    if mistake is not None:
        yield replace(mistake, track=track)


def misplaced_base(
    session: Session, written: Mistake, read: Array, measured: Array
) -> tuple[Mistake | None, Array]:
    """The base where places (n, 3), m, as measured have it; where it puts them as read (n, 3)."""
    middle, told = measured.mean(axis=0), read - read.mean(axis=0)
    turn = Rotation.align_vectors(measured - middle, told)[0].as_matrix()
    moved = rigid_transform(turn, middle - turn @ read.mean(axis=0))
    return _misplaced(session, written, moved, of_base=True), carry(moved, read)


def _misplaced(
    session: Session, written: Mistake, moved: Array, *, of_base: bool
) -> Mistake | None:
    """The base, or the body, that stands `moved` (4, 4) from where it is said, if that is far."""
    known, posed = session.rig.covariance, session.instrument is not None
    stated = () if known is None else zip(known.parameters, known.standard_uncertainty, strict=True)
    doubt = np.deg2rad(max((u for name, u in stated if name.startswith("robot_base.r")), default=0))
    turn = float(Rotation.from_matrix(moved[:3, :3]).magnitude())
    shift = float(np.linalg.norm(moved[:3, 3]))
    if turn + shift / LEVER <= max(MIN_TURNED, 3 * doubt * of_base):
        return None
    what = "the robot's base" if of_base else "the body on the flange"
    holder = session.rig_file if of_base or posed else session.marker_file
    remedy = "Nothing can be judged by that registration: register again."
    if not (of_base or posed) and (axis := _mirrored_axis(session.marker.leds, moved)):
        remedy = f"LEDs of reversed {axis} lie there, too: check its signs, or register again."
    return replace(
        written,
        file=holder or session.folder / "session.toml",
        name=f"{what} turned by {degrees(turn)} and shifted by {shift * 1e3:.0f} mm",
        remedy=remedy,
    )


def _mirrored_axis(leds: Array, moved: Array) -> str | None:
    """The axis whose sign puts three LEDs (n, 3), m, where they are, too: mirrored, they fit."""
    for axis, mirror in zip("xyz", 1 - 2 * np.eye(3), strict=True):
        apart = np.linalg.norm(carry(moved, leds) - leds * mirror, axis=1)
        if np.count_nonzero(apart < MAX_MIRRORED) >= 3:
            return axis
    return None


def degrees(angle: float) -> str:
    """Word an angle, rad; inf: no angle at which the arm reaches the poses."""
    figure = float(f"{np.rad2deg(angle):.2g}")  # 130, not 1.3e+02
    return f"{figure:g}°" if np.isfinite(angle) else "more than the arm can reach"


def refusal(session: Session, mistake: Mistake, found: str) -> InputError:
    """Word that readings are not the arm's motion: what was found, and what to do."""
    return InputError(
        mistake.file,
        f"the readings are not this arm's motion: {found}",
        f"readings of {session.arm.name} in the robot file's sense, zero and order",
        mistake.remedy or "Check that log, robot and registration belong to this recording.",
    )
