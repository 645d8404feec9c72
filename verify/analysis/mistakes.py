"""Refuse readings that are not this arm's motion, and name the usual mistake that explains them.

A joint is off where the median over pairs of |reading less measured angle| is above MAX_ERROR. One
or two joints that are off may be faults, however large; they are refused only where a mistake that
people make (a joint's sign, its zero, its unit, two joints exchanged, another base or arm) brings
every joint below MAX_ERROR. Where three or more are off, no mistake explains them, and the relative
motions of the flange disagree as well, the log is not of this motion.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

import robots
from robots.library import names
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.clock.search import MAX_SQUARED_MISFIT
from verify.analysis.measured import session_clock
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.session.session import Session
from verify.measurement.track import Track

MAX_ERROR = np.deg2rad(5.0)
CLEAR_ERROR = np.deg2rad(1.0)  # so close that no other mistake is tried
MAX_PAIRS = 60  # that are compared for each mistake
MIN_REACHED = 0.5  # of the pairs
MIN_JOINTS_OFF = 3  # fewer may be faults
MIN_MOTION_COST = 0.3 * MAX_SQUARED_MISFIT  # of relative motions: registration does not matter
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
    error = _typical_errors(arm, track, readings, clock.offset)
    off = np.flatnonzero(~(error < MAX_ERROR)).tolist()
    if not off:
        return
    many = len(off) >= MIN_JOINTS_OFF
    best: tuple[float, Mistake] | None = None
    for mistake in _mistakes(session, track, readings, among_all=many):
        tried = replace(session, arm=mistake.arm)
        offset = session_clock(tried, mistake.track, mistake.readings).offset
        left = float(_typical_errors(mistake.arm, mistake.track, mistake.readings, offset).max())
        if left < MAX_ERROR and (best is None or left < best[0]):
            best = left, mistake
        if left < CLEAR_ERROR:
            break
    if best is not None:
        raise _refusal(
            session, error, off, f"{best[1].name} fits: {_degrees(best[0])} instead", best[1]
        )
    if np.ptp(readings.q, axis=0).max() < MAX_FROZEN and many:
        raise _refusal(session, error, off, "the readings never change while the flange moves")
    if many and len(clock.curve) and clock.curve[:, 1].min() > MIN_MOTION_COST:
        raise _refusal(session, error, off, "no usual mistake explains it")


def _typical_errors(arm: robots.Arm, track: Track, readings: Readings, offset: float) -> Array:
    """Median over pairs of each joint's |reading less measured angle|, (j,), rad; inf: unknown."""
    known = np.flatnonzero(readings.available(track.t - offset))
    few = known[np.unique(np.linspace(0, len(known) - 1, min(len(known), MAX_PAIRS)).astype(int))]
    unknown = np.full(arm.dof, np.inf)
    if len(known) < 3:
        return unknown
    q = readings.at(track.t[few] - offset)
    measured, reached = robots.nearest(arm, track.base_T_flange[few], q)
    if reached.mean() < MIN_REACHED:
        return unknown
    error = (q - measured)[reached]
    typical: Array = np.median(np.abs(np.arctan2(np.sin(error), np.cos(error))), axis=0)
    return typical


def _mistakes(
    session: Session, track: Track, readings: Readings, *, among_all: bool
) -> Iterator[Mistake]:
    """The usual mistakes of one joint's readings, or of all, the base and the arm."""
    written = Mistake(session.folder / "encoders.csv", "", "", readings, track, session.arm)
    for joint in range(session.arm.dof):
        for name, remedy, column in _joint_mistakes(joint, readings.q[:, joint]):
            q = readings.q.copy()
            q[:, joint] = column
            yield replace(written, name=name, remedy=remedy, readings=Readings(readings.t, q))
    for i, k in combinations(range(session.arm.dof), 2):
        q = readings.q.copy()
        q[:, [i, k]] = q[:, [k, i]]
        yield replace(
            written,
            name=f"joints {i + 1} and {k + 1} exchanged",
            remedy=f"Exchange the columns q{i + 1}_deg and q{k + 1}_deg.",
            readings=Readings(readings.t, q),
        )
    if among_all:
        yield from _registration_mistakes(session, written)


def _joint_mistakes(joint: int, q: Array) -> Iterator[tuple[str, str, Array]]:
    """What one joint's readings (m,), rad, would be without a mistake."""
    column = f"q{joint + 1}_deg"
    yield f"joint {joint + 1} reversed", f"Multiply the column {column} by -1.", -q
    for zero in ZERO_ERRORS_DEG:
        yield (
            f"joint {joint + 1} with its zero moved by {zero:+d}°",
            f"Add {zero:+d} to the column {column}.",
            q + np.deg2rad(zero),
        )
    yield (
        f"joint {joint + 1} taken as radians",
        f"Multiply the column {column} by 180/π.",
        np.rad2deg(q),
    )


def _registration_mistakes(session: Session, written: Mistake) -> Iterator[Mistake]:
    """The base or the poses the wrong way round or in another unit, and the other arms."""
    track, rig_T_base = written.track, session.rig.rig_T_base
    rig_T_flange = rig_T_base @ track.base_T_flange
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
        registered = session.folder / "rig.toml"
        yield replace(written, file=registered, name=name, remedy=remedy, track=moved)
    if session.instrument is not None:
        inverse = np.linalg.inv(rig_T_base) @ np.linalg.inv(rig_T_flange)
        yield replace(
            written,
            file=session.left.path,
            name="the poses inverted",
            remedy="Write the body in the instrument's frame, not the instrument in the body's.",
            track=replace(track, base_T_flange=inverse),
        )
    for name in names():
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
