"""Joint axes from one-joint sweeps, compared with the arm's table: twists and lengths.

Each sweep gives one joint's axis in the rig and its turn against its encoder, without base, LED
positions or table; then twists and link lengths of neighbouring axes are compared with the table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

import robots
from verify.analysis.measured import session_clock
from verify.analysis.sweeps.segments import MAX_REST_TRAVEL, SweepSegment, find_sweeps
from verify.calibration.axes.joint import (
    AxisLine,
    JointSweepResult,
    angle_between,
    are_parallel,
    distance_between,
    fit_joint,
    line_derivative,
    line_in_base,
    tilt_between,
)
from verify.core.readings import Readings
from verify.core.records import Measurement
from verify.core.statistics import chi2_isf, norm_isf
from verify.errors import InputError
from verify.io.session.session import Session
from verify.measurement.track import collect_track

P_FALSE_ALARM = 1e-3  # over all comparisons with the table
MIN_SPAN = np.deg2rad(5.0)  # below it the circle is too short an arc to find its centre
MIN_GOOD_SPAN = np.deg2rad(15.0)  # below it an axis is known, but poorly


@dataclass(frozen=True, slots=True)
class AxisPair:
    """Two axes against the table; angle in rad, distance in m, uncertainties of the difference."""

    joints: tuple[int, int]  # counted from 1
    parallel: bool  # then the angle cannot be negative: noise alone makes it larger than 0
    angle: float
    angle_table: float
    angle_uncertainty: float
    distance: float
    distance_table: float
    distance_uncertainty: float
    agrees: bool


def compare_with_table(
    arm: robots.Arm, joints: tuple[JointSweepResult, ...]
) -> tuple[AxisPair, ...]:
    """Every sweep of a joint with the first one of the next joint."""
    first = {j.joint: j for j in reversed(joints)}
    found = [(one, first[one.joint + 1]) for one in joints if one.joint + 1 in first]
    limit = P_FALSE_ALARM / max(2 * len(found), 1)
    return tuple(_pair(arm, one, other, limit) for one, other in found)


def _in_base(
    arm: robots.Arm, one: JointSweepResult, other: JointSweepResult
) -> tuple[AxisLine, AxisLine]:
    """Both axes by the table, at the postures in which they were swept."""
    posture, later = one.q.mean(axis=0), other.q.mean(axis=0)
    upstream = slice(None, one.joint - 1)
    if np.all(np.abs(posture[upstream] - later[upstream]) < MAX_REST_TRAVEL):
        posture[upstream] = later[upstream]  # the same posture: only the readings' noise differs
    return line_in_base(arm, one.joint - 1, posture), line_in_base(arm, other.joint - 1, later)


def _pair(
    arm: robots.Arm, one: JointSweepResult, other: JointSweepResult, limit: float
) -> AxisPair:
    table = _in_base(arm, one, other)
    lines, across = (one.axis, other.axis), (one.axis.across, other.axis.across)
    both = np.concatenate([one.by_source, other.by_source])  # they share the rig's errors
    covariance = block_diag(one.axis.covariance, other.axis.covariance) + both @ both.T
    side_by_side = are_parallel(*table)

    by_distance = line_derivative(distance_between, lines, across)
    distance_u = float(np.sqrt(by_distance @ covariance @ by_distance))
    known, seen = distance_between(*table), distance_between(*lines)
    sense = -1.0 if known < 0 else 1.0
    angle, angle_table = angle_between(*lines), angle_between(*table)
    if side_by_side:
        by_tilt = line_derivative(tilt_between, lines, across)
        angle_u = float(np.sqrt(np.linalg.eigvalsh(by_tilt @ covariance @ by_tilt.T)[-1]))
        bound = np.sqrt(chi2_isf(limit, 2))  # a tilt has two components
    else:
        by_angle = line_derivative(angle_between, lines, across)
        angle_u = float(np.sqrt(by_angle @ covariance @ by_angle))
        bound = norm_isf(limit / 2)
    straight = abs(angle - angle_table) < bound * angle_u
    return AxisPair(
        joints=(one.joint, other.joint),
        parallel=side_by_side,
        angle=angle,
        angle_table=angle_table,
        angle_uncertainty=angle_u,
        distance=sense * seen,
        distance_table=sense * known,
        distance_uncertainty=distance_u,
        agrees=bool(straight and abs(seen - known) < norm_isf(limit / 2) * distance_u),
    )


@dataclass(frozen=True, slots=True)
class SweepResult:
    """What one-joint sweeps show."""

    joints: tuple[JointSweepResult, ...]
    pairs: tuple[AxisPair, ...]
    decisions: tuple[str, ...]
    warnings: tuple[str, ...]


def axes_from_sweeps(session: Session, measurements: Sequence[Measurement]) -> SweepResult:
    """Find the axis of each joint that moved alone and compare the arm with its table.

    Raises:
        InputError: no joint was swept alone through a useful span; or a joint of this arm turns
            several axes, so that a sweep of it shows none.
    """
    if session.arm.linkage is not None:
        raise InputError(
            session.folder,
            f"joints of {session.arm.name} turn later links as well (linkage)",
            "a sweep must show one axis",
            "Leave out --sweeps, or use `verify identify`.",
        )
    posed = [m for m in measurements if m.status == "measured"]
    measured = [m for m in posed if m.pose is not None and m.pose.known_dof == 6]
    readings = Readings.of_log(session.encoders.t, session.encoders.q)
    offset = _clock(session, measured, readings) if measured else 0.0
    t = np.array([m.t for m in measured]) - offset
    frame = np.array([m.frame for m in measured], dtype=np.int64)
    sweeps, notes = find_sweeps(readings, t, frame) if measured else ([], [])
    useful, small = _wide_sweeps(sweeps)
    if not useful:
        raise InputError(
            session.folder,
            f"no joint is swept alone ({' '.join([*notes, *small]) or 'nothing moves'})",
            f"one joint after the other turns by {np.rad2deg(MIN_SPAN):.0f}° or more",
            "Record such a motion: `single_joint` in a scenario shows one.",
        )
    joints = tuple(fit_joint(session, measured, readings, sweep) for sweep in useful)
    pairs = compare_with_table(session.arm, joints)
    return SweepResult(
        joints=joints,
        pairs=pairs,
        decisions=tuple(_decisions(joints, pairs)),
        warnings=(*notes, *small),
    )


def _clock(session: Session, measured: list[Measurement], readings: Readings) -> float:
    # the invariants of the motion need no base; without one the rig's own axes stand in
    rig = session.rig if session.rig.registered else replace(session.rig, rig_T_base=np.eye(4))
    empty = [np.zeros((6, 0))] * len(measured)
    return session_clock(session, collect_track(measured, rig, empty), readings).offset


def _wide_sweeps(sweeps: list[SweepSegment]) -> tuple[list[SweepSegment], list[str]]:
    """Sweeps wide enough, and what is said of the others."""
    useful, notes = [], []
    for sweep in sweeps:
        turned = f"Joint {sweep.joint + 1} turns by {np.rad2deg(sweep.span):.1f}°"
        if sweep.span < MIN_SPAN:
            notes.append(f"Left out: {turned} only; {np.rad2deg(MIN_SPAN):.0f}° are needed.")
            continue
        if sweep.span < MIN_GOOD_SPAN:
            notes.append(f"{turned}: so short an arc determines its axis poorly.")
        useful.append(sweep)
    return useful, notes


def _decisions(joints: tuple[JointSweepResult, ...], pairs: tuple[AxisPair, ...]) -> list[str]:
    words = []
    for j in joints:
        off = (j.gear - 1) / j.gear_uncertainty
        said = "" if abs(off) < norm_isf(P_FALSE_ALARM / 2) else ", which is not 1"
        rms = np.rad2deg(np.sqrt(np.mean(j.nonlinearity**2)))
        words.append(
            f"Joint {j.joint}: {len(j.frames)} pairs over {np.rad2deg(j.span):.1f}°; the flange "
            f"turns {j.gear:.5f} times what the encoder says ± {2 * j.gear_uncertainty:.5f} (k = 2)"
            f"{said}; beside a straight line {rms:.4f}° rms."
        )
    wrong = [f"{p.joints[0]} and {p.joints[1]}" for p in pairs if not p.agrees]
    if wrong:
        words.append(f"Axes that differ from the table: {'; '.join(wrong)}.")
    elif pairs:
        words.append("All axes that were swept one after the other agree with the table.")
    if any(p.joints == (1, 2) and not p.parallel for p in pairs):
        q = next(j for j in joints if j.joint == 2).q[:, 0].mean()
        words.append(
            f"The base by axes 1 and 2: its turn about axis 1 rests on joint 1's encoder, at "
            f"{np.rad2deg(q):z.2f}° while joint 2 was swept, its height on the table's d of "
            "joint 1."
        )
    return words
