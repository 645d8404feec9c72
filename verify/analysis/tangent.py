"""Linearise a session about the errors that are there: of joints, base and LED body, cameras.

An error that is far from zero has an effect of second order, which would pass for another cause. So
the session is laid out about an estimate of it, and what that does is given back, linear: estimates
and uncertainties are those of a linear model, at the right place.

Stated errors of the cameras, and turns of one of them, move poses by up to centimetres. Every pose
is fitted again to its spots without them, and Newton's steps find them beside the joints' offsets,
until a' is a; so spots that seemed to contradict each other count again:

    xi - (d(a) - c(a) a) = c(a) a' + J e + what is fitted and stated + noise

    symbol  meaning                                                   unit
    d(a)    pose fitted with the cameras off by a, less as measured   m, rad
    c(a)    derivative there                                          m and rad a unit of a
    a'      the errors                                                px, rad, m
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from robots import Arm
from robots.transforms import invert, misplacement, rotation_exp, rotation_log
from verify.analysis.comparison import (
    Comparison,
    JointComparison,
    gross_errors,
    placement_columns,
    relinearise,
    solve_joints,
    twist_difference,
)
from verify.analysis.diagnosis.faults import Turn, camera_turns
from verify.analysis.joint_errors import resolve_errors
from verify.analysis.least_squares import solve
from verify.analysis.model import JointErrorModel, ModelBuilder, SessionComparison, clock_effect
from verify.core.records import Array, Measurement, rigid_transform
from verify.core.statistics import chi2_bound
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import (
    covariance_root,
    pixel_sensitivities,
    sensitivities,
    spot_columns,
)

MIN_DISPLACED = np.deg2rad(0.5)  # an error of a joint: base or body may stand elsewhere instead
DISPLACED = ((True, False), (False, True), (True, True))  # base, LED body
MIN_LOOSE = np.deg2rad(0.25)  # of a body's turn, stated: it may take up what joints leave
WIDE_SHIFT, WIDE_TURN = 0.1, np.deg2rad(10.0)  # m, rad: of what a motion does not tell apart
STEPS_DISPLACED = 3  # of Newton, to where they stand
MIN_GAIN_DISPLACED = 1.0  # of chi-squared, about the place where they would stand
MAX_MISFIT_DISPLACED = 2.0  # there: of a joint's step, more is left
MIN_FAR = np.deg2rad(0.25)  # of an error from the typical one: 1° off it may accuse a neighbour
MIN_FAR_SIGMA = 5.0  # that a Jacobian does not move with the poses' noise
MAX_STEPS_CAMERAS = 6
MAX_MISFIT = 2.0  # chi-squared a degree of freedom, of offsets beside the cameras' errors
MIN_MOVED = 2e-3  # m, standard uncertainty: of less, second order is some micrometres
P_NOT_STATED = 1e-4  # of errors that are as stated, and larger
TOL_MOVED = 1e-5  # m: far below any turn of a camera that a session shows


def tangent_of(compared: SessionComparison, built: ModelBuilder) -> Comparison:
    """Linearise a session about the errors that are there.

    Where base or LED body explain them better than the joints do, about the place where they would
    stand; where a given clock is wrong, about the offset that the motion shows.
    """
    arm, (start, late) = compared.session.arm, compared.at_shown_clock or (compared.comparison, 0.0)
    joints = solve_joints(start, arm) if late else compared.joints
    middle = _about_joint_errors(start, joints, arm, built)
    far = np.nanmax(np.abs(joints.error), initial=0.0) > MIN_DISPLACED
    body = compared.session.marker.body_standard_uncertainty
    loose = body is not None and body[3:].max() > MIN_LOOSE
    if far and (loose or _fit_offsets(built(middle), (False, False))[1] > MAX_MISFIT_DISPLACED):
        least = min(_fit_offsets(built(middle), own)[0] for own in DISPLACED)
        for own in DISPLACED:
            moved = misplacement(start.base_T_measured, start.base_T_encoder, *own)
            twists = np.stack([np.append(m[:3, 3], rotation_log(m[:3, :3])) for m in moved])
            for _ in range(STEPS_DISPLACED):
                there = without_misplacement(start, twists)
                near = _about_joint_errors(there, solve_joints(there, arm), arm, built)
                taken = placement_columns(near.base_T_jacobian) @ twists.ravel()
                near = replace(near, xi=near.xi - taken)
                cost, misfit, twists = _fit_offsets(built(near), own)
                if cost < least - MIN_GAIN_DISPLACED and misfit < MAX_MISFIT_DISPLACED:
                    middle, least = near, cost
    return replace(middle, xi=middle.xi + late * clock_effect(middle)[:, :, 0])


def _about_joint_errors(
    start: Comparison, joints: JointComparison, arm: Arm, built: ModelBuilder
) -> Comparison:
    error, known = np.nan_to_num(joints.error), ~np.isnan(joints.error)
    typical = error.sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    if not known.any(axis=0).all():  # joints that no pair determines: from a first fit
        first = np.nan_to_num(resolve_errors(built(start)).mean)
        typical = np.where(known.any(axis=0), typical, first)
    # a step, readings that stand or a rough stretch leave some pairs far from what is typical
    rough = start.local_noise > 2 * start.reading_noise
    doubt = np.sqrt(np.diagonal(joints.covariance, axis1=1, axis2=2))
    far = known & (rough | (np.abs(error - typical) > np.maximum(MIN_FAR, MIN_FAR_SIGMA * doubt)))
    expected, gross = np.where(far, error, typical), gross_errors(joints.error)
    return relinearise(start, arm, expected, gross)


def _fit_offsets(model: JointErrorModel, free: tuple[bool, bool]) -> tuple[float, float, Array]:
    """Fit joints' constant errors, base and body if `free`: cost, a degree's misfit, twists (2, 6).

    The cost is chi-squared and, for each unknown of a motion, twice what it gains by chance. None
    goes far where a motion does not tell them apart.
    """
    moved = model.white.rows(placement_columns(model.comparison.base_T_jacobian))
    scale = np.outer(free, np.repeat([WIDE_SHIFT, WIDE_TURN], 3)).ravel()
    held = np.concatenate([model.prior, WIDE_TURN * model.joints, scale * moved], axis=1)
    fit = solve(model.fitted, model.xi, held)
    # what moves the measured flange is less of an error, encoder less measured
    twists = -(scale * fit.held[-12:]).reshape(2, 6)
    return fit.chi2 + 12 * sum(free), fit.chi2 / max(fit.degrees_of_freedom, 1), twists


def without_misplacement(comparison: Comparison, twists: Array) -> Comparison:
    """The comparison with base and LED body moved back by twists (2, 6), m and rad.

    `base_motion` and `body_motion` at a tangent, times these, are what that takes off xi: given
    back, it is linear at any size.
    """
    base, body = (rigid_transform(rotation_exp(twist[3:]), twist[:3]) for twist in twists)
    there = invert(base) @ comparison.base_T_measured @ invert(body)
    xi = twist_difference(comparison.base_T_encoder, there)
    return replace(comparison, base_T_measured=there, xi=xi)


def about_camera_errors(
    compared: SessionComparison, plain: Comparison, sought: Sequence[Turn], built: ModelBuilder
) -> Comparison:
    """Linearise a session about the errors of its cameras that fit.

    Those are the turns that are sought, or where none are the stated errors, if what is stated
    moves poses farther than first order tells. Else it stays as it is about the joints', `plain`.
    """
    names = compared.systematics.names
    of_cameras = [name.startswith(("left.", "right.")) for name in names]
    root = covariance_root(compared.systematics.covariance) * np.reshape(of_cameras, (-1, 1))
    best = middle = plain
    moved = np.linalg.norm(plain.systematic[:, :3, :-2] @ root, axis=(1, 2))  # m, by what is stated
    if not compared.measurements or not (sought or moved.max(initial=0.0) > MIN_MOVED):
        return plain
    least, degrees = np.inf, 1
    errors, nothing = np.zeros((len(middle), len(names) + 2)), np.zeros((len(middle), 6, 0))
    for _ in range(MAX_STEPS_CAMERAS):
        model, turning = built(middle), camera_turns(middle)
        columns = np.concatenate([nothing, *(turning[turn][0] for turn in sought)], axis=2)
        shown = model.joints[:, np.linalg.norm(model.joints, axis=0) > 0]
        free = np.concatenate([model.white.rows(columns), model.fitted, shown], axis=1)
        fit, before = solve(free, model.xi, model.prior), errors
        if fit.chi2 < least:
            best, least, degrees = middle, fit.chi2, fit.degrees_of_freedom
        errors, held = np.zeros_like(before), fit.held[: root.shape[1]]
        farthest = np.sqrt(chi2_bound(P_NOT_STATED, max(len(held), 1)))  # what is stated holds
        if not sought:
            errors[:, :-2] = -root @ held * min(1.0, farthest / max(np.linalg.norm(held), 1e-9))
        angles = np.concatenate([nothing[:, 0], *(turning[turn][1] for turn in sought)], axis=1)
        errors[:, -1] = angles @ fit.value[: angles.shape[1]]
        moved = np.einsum("nip,np->ni", middle.systematic[:, :3], errors - before)
        if np.linalg.norm(moved, axis=1).max(initial=0.0) < TOL_MOVED:
            break
        there, effect = _without_camera_errors(compared, errors)
        middle = tangent_of(there, built)
        middle = replace(middle, xi=middle.xi + effect)
    # with a cause that is not found yet, what fits of the cameras' errors is no error of theirs
    return best if sought or least < MAX_MISFIT * degrees else plain


def _without_camera_errors(
    compared: SessionComparison, errors: Array
) -> tuple[SessionComparison, Array]:
    """Fit all pairs without errors (n, p + 2) of what is stated and of both pan readings.

    Beside it what they do there, (n, 6). What cannot be fitted anew stays as it is.
    """
    start, late = compared.at_shown_clock or (compared.comparison, 0.0)
    base_T_rig, effect = np.linalg.inv(compared.session.rig.rig_T_base), np.zeros((len(start), 6))
    measured, systematic = start.base_T_measured.copy(), start.systematic.copy()
    for row, i in enumerate(start.index.tolist()):
        again = _fit_again(compared, compared.measurements[i], errors[row])
        if again is not None:
            measured[row], systematic[row] = base_T_rig @ again[0], -again[1]
            effect[row] = again[1] @ errors[row]
    xi = twist_difference(start.base_T_encoder, measured)
    moved = replace(start, base_T_measured=measured, xi=xi, systematic=systematic)
    joints = solve_joints(moved, compared.session.arm)
    shown = None if compared.at_shown_clock is None else (moved, late)
    return replace(compared, comparison=moved, joints=joints, at_shown_clock=shown), effect


def _fit_again(
    compared: SessionComparison, measured: Measurement, errors: Array
) -> tuple[Array, Array] | None:
    """Fit a pair's pose (4, 4) without errors (p + 2,) of its cameras; its sensitivities there.

    None where it determines less of the pose then.
    """
    left, right, pose = measured.left, measured.right, measured.pose
    rig, marker, stated = compared.session.rig, compared.session.marker, compared.systematics
    if left is None or right is None or pose is None:
        return None
    off = pixel_sensitivities(stated.names, measured, rig, marker) @ errors[:-2]
    of_left, of_right = np.split(off.reshape(-1, 2), [len(left)])
    left = replace(left, centre=left.centre - of_left)
    right = replace(right, centre=right.centre - of_right)
    rig = replace(rig, right=replace(rig.right, pan_zero=rig.right.pan_zero + errors[-1]))
    columns = partial(spot_columns, stated, rig, marker, left, right)
    try:
        again = fit_pose(left, right, rig, marker, pose.rig_T_flange, columns)
    except np.linalg.LinAlgError:
        return None
    if again.known_dof < pose.known_dof:
        return None
    there = replace(measured, pose=again, left=left, right=right)
    return again.rig_T_flange, sensitivities(stated, there, rig, marker)
