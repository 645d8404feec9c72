"""Axes from one-joint sweeps: what the arm is, seen without its DH table, and how well they agree.

Each sweep shows one joint by itself: where its axis lies in the rig, and how far it turned against
what its encoder says. No base, no LED place and no table enters; then the table is compared.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.calibration.sweep_joint import SweptJoint, fit_joint
from verify.calibration.sweep_segments import Sweep, find_sweeps
from verify.calibration.sweep_table import (
    FALSE_ALARM,
    AxisPair,
    BaseFromAxes,
    base_from_axes,
    compare_axes,
)
from verify.clock import estimate_clock
from verify.distributions import norm_isf
from verify.errors import InputError
from verify.readings import Readings
from verify.records import Measurement
from verify.session import Session
from verify.track import collect

SMALLEST_SPAN = np.deg2rad(5.0)  # below it the circle is too short an arc to find its centre
SHORT_SPAN = np.deg2rad(15.0)  # below it an axis is known, but poorly


@dataclass(frozen=True, slots=True)
class SweepResult:
    """What one-joint sweeps show."""

    joints: tuple[SweptJoint, ...]
    pairs: tuple[AxisPair, ...]
    base: BaseFromAxes | None  # where joints 1 and 2 were swept
    clock_offset: float  # s, added to the readings' time
    decisions: tuple[str, ...]
    warnings: tuple[str, ...]


def axes_from_sweeps(session: Session, measurements: Sequence[Measurement]) -> SweepResult:
    """Find each swept joint's axis and compare the arm with its table.

    Args:
        session: joint after joint moves, the others still.
        measurements: what `measure` gave for its pairs.

    Raises:
        InputError: no joint was swept alone through a useful span.
    """
    measured = [m for m in measurements if m.status == "measured" and m.pose is not None]
    measured = [m for m in measured if m.pose is not None and m.pose.known_dof == 6]
    readings = Readings(session.encoders.t, session.encoders.q)
    offset = _clock(session, measured, readings)
    t = np.array([m.t for m in measured]) - offset
    frame = np.array([m.frame for m in measured], dtype=np.int64)
    sweeps, notes = find_sweeps(readings, t, frame) if measured else ([], [])
    useful, small = _spans(sweeps)
    if not useful:
        raise InputError(
            session.folder,
            f"no joint is swept alone ({' '.join([*notes, *small]) or 'nothing moves'})",
            f"one joint after the other turns by {np.rad2deg(SMALLEST_SPAN):.0f}° or more",
            "Record such a motion: `single_joint` in a scenario shows one.",
        )
    joints = tuple(fit_joint(session, measured, readings, sweep) for sweep in useful)
    pairs = compare_axes(session.arm, joints)
    registered = session.rig.rig_T_base if session.rig.registered else None
    base = base_from_axes(session.arm, joints, registered)
    return SweepResult(
        joints=joints,
        pairs=pairs,
        base=base,
        clock_offset=offset,
        decisions=tuple(_decisions(joints, pairs, base)),
        warnings=(*notes, *small),
    )


def _clock(session: Session, measured: list[Measurement], readings: Readings) -> float:
    if session.clock is not None:
        return session.clock.encoder_offset
    # the invariants of the motion need no base; without one the rig's own axes stand in
    rig = session.rig if session.rig.registered else replace(session.rig, rig_T_base=np.eye(4))
    empty = [np.zeros((6, 0))] * len(measured)
    return float(estimate_clock(collect(measured, rig, empty), session.arm, readings).offset)


def _spans(sweeps: list[Sweep]) -> tuple[list[Sweep], list[str]]:
    """Sweeps wide enough, and what is said of the others."""
    useful, notes = [], []
    for sweep in sweeps:
        turned = f"Joint {sweep.joint + 1} turns by {np.rad2deg(sweep.span):.1f}°"
        if sweep.span < SMALLEST_SPAN:
            notes.append(f"Left out: {turned} only; {np.rad2deg(SMALLEST_SPAN):.0f}° are needed.")
            continue
        if sweep.span < SHORT_SPAN:
            notes.append(f"{turned}: its axis is known poorly from so short an arc.")
        useful.append(sweep)
    return useful, notes


def _decisions(
    joints: tuple[SweptJoint, ...], pairs: tuple[AxisPair, ...], base: BaseFromAxes | None
) -> list[str]:
    words = []
    for j in joints:
        off = (j.gear - 1) / j.gear_uncertainty
        said = "" if abs(off) < norm_isf(FALSE_ALARM / 2) else ", which is not 1"
        rms = np.rad2deg(np.sqrt(np.mean(j.nonlinearity**2)))
        words.append(
            f"Joint {j.joint}: {len(j.frames)} pairs over {np.rad2deg(j.span):.1f}°; the flange "
            f"turns {j.gear:.5f} times what the encoder says (u = {j.gear_uncertainty:.5f}){said}; "
            f"beside a straight line {rms:.4f}° rms."
        )
    wrong = [f"{p.joints[0]} and {p.joints[1]}" for p in pairs if not p.agrees]
    if wrong:
        words.append(f"Axes that lie otherwise than the table has them: {'; '.join(wrong)}.")
    elif pairs:
        words.append("All axes that were swept one after the other lie as the table has them.")
    if base is not None:
        q = next(j for j in joints if j.joint == 2).q[:, 0].mean()
        words.append(
            f"The base by axes 1 and 2: its turn about axis 1 rests on joint 1's encoder, at "
            f"{np.rad2deg(q):.2f}° while joint 2 was swept, its height on the table's d of joint 1."
        )
    return words
