"""Fault models of an arm's links, and the dictionary of all faults that a diagnosis tries.

A single link parameter: standard DH, RotZ(θ) TransZ(d) TransX(a) RotX(α), with Hayati's RotY(β)
behind it where the next axis is parallel, as the common normal is not determined there and d is
redundant with the next joint's. Source: Hayati, Robot arm geometric link parameter estimation,
22nd IEEE CDC, 1983.

The geometry as a whole: every link displaced against the next axis in the four ways that matter,
one fault of many coefficients, for any arm. Small errors of many links together would otherwise be
taken for offsets, waves and drifts of joints.
"""

from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.analysis.comparison import base_motion, body_motion
from verify.analysis.diagnosis.faults import Fault, common_faults, joint_faults
from verify.analysis.model import JointErrorModel
from verify.core.records import Array
from verify.core.rig import Rig

# of the largest singular value: what registration leaves of a gauge is rounding
MIN_SINGULAR_VALUE = 1e-3
MAX_PARALLEL_SINE = np.sin(np.deg2rad(10.0))  # below, two axes count as parallel


def geometry_fault(model: JointErrorModel, arm: robots.Arm) -> Fault:
    """All links together; what the session's own registration takes in is left out."""
    rows = model.white.rows(link_displacements(arm, model.comparison.q_jacobian))
    rows = rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    taken = [model.fitted]
    if model.through_encoders:  # registered by another motion: as if it had been this one
        taken.append(_registration_rows(model))
    beside = np.concatenate(taken, axis=1)
    basis, size, _ = np.linalg.svd(
        beside / np.maximum(np.linalg.norm(beside, axis=0), 1e-300), full_matrices=False
    )
    basis = basis[:, size > 1e-9]
    columns, size, _ = np.linalg.svd(rows - basis @ (basis.T @ rows), full_matrices=False)
    return Fault("geometry", None, "", columns[:, size > MIN_SINGULAR_VALUE * size[0]])


def link_displacements(arm: robots.Arm, q: Array) -> Array:
    """Twist of the flange (m, 6, 4 (n - 1)) when links 1 to n - 1 are displaced, at angles (m, n).

    Each along and about two directions square to the next axis: along it a link may slide, and
    about it turn, as that joint's zero does. Axes by products of exponentials from q = 0.
    """
    arm, q = arm.unlinked, arm.axis_angles(q)
    rest = np.zeros(arm.dof)
    tip = robots.forward(arm, rest)[:3, 3]
    columns = robots.jacobian(arm, rest)
    axes = columns[3:].T
    points = tip - np.cross(columns[:3].T, axes)  # of each axis, nearest to the flange
    flange = robots.forward(arm, q)[:, :3, 3]
    turn, shift = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    effects = []
    for j in range(arm.dof - 1):
        own = Rotation.from_rotvec(q[:, [j]] * axes[j]).as_matrix()
        shift = shift + turn @ points[j] - (turn @ own) @ points[j]
        turn = turn @ own
        place = turn @ points[j + 1] + shift
        across = np.linalg.svd(axes[[j + 1]])[2][1:]  # two directions square to the next axis
        for direction in across:
            way = turn @ direction
            effects.append(np.concatenate([way, np.zeros_like(way)], axis=1))
            effects.append(np.concatenate([np.cross(way, flange - place), way], axis=1))
    return np.stack(effects, axis=2)


def translation_twist(axis: Array) -> Array:
    """Twist of the flange (m, 6, 1) a metre along axes (m, 3)."""
    return np.concatenate([axis, np.zeros_like(axis)], axis=1)[:, :, None]


def rotation_twist(axis: Array, lever: Array) -> Array:
    """Twist of the flange (m, 6, 1) a radian about axes (m, 3), at a lever (m, 3), m, from them."""
    return np.concatenate([np.cross(axis, lever), axis], axis=1)[:, :, None]


def link_faults(model: JointErrorModel, arm: robots.DhArm) -> list[Fault]:
    """One fault a link parameter; values are what has to be added to the robot file."""
    comparison = model.comparison
    frames = robots.link_frames(arm, comparison.q_jacobian)
    tip = frames[:, -1, :3, 3]
    parallel = np.append(np.abs(np.sin(arm.alpha[:-1])) < MAX_PARALLEL_SINE, False)
    effects: list[tuple[int, str, str, Array]] = []
    for i in range(arm.dof):
        before, after = frames[:, i], frames[:, i + 1]
        lever = tip - after[:, :3, 3]
        effects.append((i, "a", "mm", translation_twist(after[:, :3, 0])))
        effects.append((i, "alpha", "deg", rotation_twist(after[:, :3, 0], lever)))
        if parallel[i]:
            effects.append((i, "beta", "deg", rotation_twist(after[:, :3, 1], lever)))
        else:
            effects.append((i, "d", "mm", translation_twist(before[:, :3, 2])))
    rows = [-model.white.rows(effect) for _, _, _, effect in effects]
    if model.through_encoders and not model.stands_in:
        rows = _minus_registration(model, rows)
    return [
        Fault("dh", i + 1, unit, columns, parameter=f"{name}{i + 1}")
        for (i, name, unit, _), columns in zip(effects, rows, strict=True)
    ]


def _minus_registration(model: JointErrorModel, rows: list[Array]) -> list[Array]:
    """Take off what base and LEDs took in of it, as if they were registered by this motion.

    They were registered by another one, which is not known here; a length was as wrong then.
    """
    basis, size, _ = np.linalg.svd(_registration_rows(model), full_matrices=False)
    basis = basis[:, size > 1e-9 * size[0]]
    return [columns - basis @ (basis.T @ columns) for columns in rows]


def _registration_rows(model: JointErrorModel) -> Array:
    """Whitened columns of a motion of base and LED body, (r, 12)."""
    pose = model.comparison.base_T_jacobian
    return model.white.rows(np.concatenate([base_motion(pose), body_motion(pose)], axis=2))


def fault_dictionary(
    model: JointErrorModel, arm: robots.Arm | None = None, rig: Rig | None = None
) -> Iterator[Fault]:
    """Every fault that this session's motion can show at all.

    Without an arm no links are tried, and single ones need a DH table; without a rig, which says
    where the cameras stand, their skew is not tried.
    """

    def groups() -> Iterator[Iterable[Fault]]:
        yield from (joint_faults(model, j) for j in range(model.joints.shape[1]))
        yield common_faults(model, rig)
        if isinstance(arm, robots.DhArm):
            yield link_faults(model, arm)
        if arm is not None and arm.dof > 1:
            yield [geometry_fault(model, arm)]

    for fault in chain.from_iterable(groups()):
        if fault.freedom and np.all(np.linalg.norm(fault.columns, axis=0) > 0):
            yield fault
