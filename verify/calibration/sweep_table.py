"""Swept axes against the arm's table: twists, link lengths, and the base by the first two."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

import robots
from robots.transforms import difference, invert
from verify.calibration.sweep_joint import SweptJoint
from verify.calibration.sweep_lines import (
    Line,
    angle_between,
    derivative,
    distance_between,
    frame_of,
    line_in_base,
    parallel,
    tilt_between,
)
from verify.calibration.sweep_segments import STILL
from verify.distributions import chi2_isf, norm_isf
from verify.records import Array

FALSE_ALARM = 1e-3  # over all comparisons with the table


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


@dataclass(frozen=True, slots=True)
class BaseFromAxes:
    """The robot's base by its own first two axes."""

    rig_T_base: Array  # (4, 4)
    covariance: Array  # (6, 6), m and rad, perturbation on the left, rig axes
    difference: Array | None  # (6,), m and rad, less the registered base; None: none registered


def compare_axes(arm: robots.Arm, joints: tuple[SweptJoint, ...]) -> tuple[AxisPair, ...]:
    """Every sweep of a joint with the first one of the next joint."""
    found = []
    for one in joints:
        other = next((j for j in joints if j.joint == one.joint + 1), None)
        if other is not None:
            found.append((one, other))
    limit = FALSE_ALARM / max(2 * len(found), 1)
    return tuple(_pair(arm, one, other, limit) for one, other in found)


def _in_base(arm: robots.Arm, one: SweptJoint, other: SweptJoint) -> tuple[Line, Line]:
    """Both axes by the table, at the postures in which they were swept."""
    posture, later = one.q.mean(axis=0), other.q.mean(axis=0)
    upstream = slice(None, one.joint - 1)
    if np.all(np.abs(posture[upstream] - later[upstream]) < STILL):
        posture[upstream] = later[upstream]  # the same posture: only the readings' noise differs
    return line_in_base(arm, one.joint - 1, posture), line_in_base(arm, other.joint - 1, later)


def _pair(arm: robots.Arm, one: SweptJoint, other: SweptJoint, limit: float) -> AxisPair:
    table = _in_base(arm, one, other)
    lines, across = (one.line, other.line), (one.axis.across, other.axis.across)
    covariance = _joint_covariance(one, other)
    side_by_side = parallel(*table)

    def distance(a: Line, b: Line) -> Array:
        return np.array(distance_between(a, b))

    by_distance = derivative(distance, lines, across)
    distance_u = float(np.sqrt(by_distance @ covariance @ by_distance))
    known, seen = distance_between(*table), distance_between(*lines)
    sense = -1.0 if known < 0 else 1.0
    angle, angle_table = angle_between(*lines), angle_between(*table)
    if side_by_side:
        by_tilt = derivative(tilt_between, lines, across)
        angle_u = float(np.sqrt(np.linalg.eigvalsh(by_tilt @ covariance @ by_tilt.T)[-1]))
        bound = np.sqrt(chi2_isf(limit, 2))  # a tilt has two components
    else:
        by_angle = derivative(lambda a, b: np.array(angle_between(a, b)), lines, across)
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


def _joint_covariance(one: SweptJoint, other: SweptJoint) -> Array:
    """Of two axes' eight parameters: they share the rig's errors."""
    random = np.asarray(block_diag(one.axis.covariance, other.axis.covariance), dtype=np.float64)
    both = np.concatenate([one.by_source, other.by_source])
    total: Array = random + both @ both.T
    return total


def base_from_axes(
    arm: robots.Arm, joints: tuple[SweptJoint, ...], registered: Array | None
) -> BaseFromAxes | None:
    """The base by joints 1 and 2: its z is axis 1, its turn about that rests on joint 1's zero.

    Args:
        arm: its table holds where the two axes lie in the base.
        joints: what was swept; None is returned where 1 and 2 are not both among them.
        registered: rig_T_base to compare with, (4, 4); None: none.
    """
    first, second = (next((j for j in joints if j.joint == n), None) for n in (1, 2))
    if first is None or second is None:
        return None
    table = _in_base(arm, first, second)
    if parallel(*table):
        return None
    frame_T_base = invert(frame_of(*table))
    lines, across = (first.line, second.line), (first.axis.across, second.axis.across)
    base: Array = frame_of(*lines) @ frame_T_base

    def moved(one: Line, other: Line) -> Array:
        return difference(frame_of(one, other) @ frame_T_base, base)

    by_lines = derivative(moved, lines, across)
    return BaseFromAxes(
        rig_T_base=base,
        covariance=by_lines @ _joint_covariance(first, second) @ by_lines.T,
        difference=None if registered is None else difference(base, registered),
    )
