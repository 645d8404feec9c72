"""Forward kinematics and the geometric Jacobian, for one pose or for arrays of them."""

from typing import Any

import numpy as np

from robots.arm import Arm, DhArm, Frame, UrdfArm, Vector
from robots.elementary import Number
from robots.transforms import Array

BASE: Frame = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


def forward(arm: Arm, q: Array) -> Array:
    """Place the flange: base_T_flange (..., 4, 4), m, of joint angles q (..., n), rad."""
    q = _checked(arm, q)
    if q.ndim > 1 and q.size == arm.dof:  # one pose, the quicker way
        return forward(arm, q.reshape(-1)).reshape(*q.shape[:-1], 4, 4)
    return _assembled(_chain(arm, q)[-1], q.shape[:-1])


def jacobian(arm: Arm, q: Array) -> Array:
    """How the flange moves with each joint: the geometric Jacobian (..., 6, n) at q (..., n), rad.

    Velocity of the flange's origin (m/rad), then angular velocity (rad/rad), both in the base
    frame, for q itself (a joint's sign and linkage included).
    """
    q = _checked(arm, q)
    if arm.linkage is not None:
        return np.asarray(jacobian(arm.unlinked, arm.axis_angles(q)) @ arm.linkage)
    if q.ndim > 1 and q.size == arm.dof:
        return jacobian(arm, q.reshape(-1)).reshape(*q.shape[:-1], 6, arm.dof)
    *before, (_, _, _, tip) = _chain(arm, q)
    columns = []
    signs = arm.sign.tolist() if isinstance(arm, DhArm) else [1.0] * arm.dof
    for sign, (_, _, axis, origin) in zip(signs, before, strict=True):
        signed = (sign * axis[0], sign * axis[1], sign * axis[2])
        columns.append((*_cross(signed, _sum(1.0, tip, -1.0, origin)), *signed))
    if q.ndim == 1:
        return np.array(columns, dtype=float).T
    matrix = np.empty((q.size // arm.dof, 6, arm.dof))
    for joint, column in enumerate(columns):
        for row, value in enumerate(column):
            matrix[:, row, joint] = value
    return matrix.reshape(*q.shape[:-1], 6, arm.dof)


def link_frames(arm: Arm, q: Array) -> Array:
    """Place a frame on every joint's axis, and the flange, at joint angles q (m, n), rad.

    Returns base_T_frame, (m, n + 1, 4, 4), m. Joint i + 1 turns about z of frame i, the last frame
    is the flange: frames 0 to n of a DH table. At a joint of a URDF the origin is the joint's, z
    grows its angle, and x is any direction across.
    """
    q = _checked(arm, q)
    return np.stack([_assembled(frame, q.shape[:-1]) for frame in _chain(arm, q)], axis=1)


def _checked(arm: Arm, q: Array) -> Array:
    q = np.asarray(q, dtype=float)
    if q.ndim == 0 or q.shape[-1] != arm.dof:
        raise ValueError(f"{arm.name} has {arm.dof} joints; q has shape {q.shape}")
    return q


def _chain(arm: Arm, q: Array) -> list[Frame]:
    """Frames 0 to n: those of a DH table, or those of `link_frames`."""
    cosines: Any
    sines: Any
    following: Any
    steps: list[Any]
    if isinstance(arm, DhArm):
        frame, steps, following, angles = BASE, arm.links, _next, arm.theta(q)
    else:
        assert isinstance(arm, UrdfArm)
        (frame, *steps), following, angles = arm.steps, _moved, arm.axis_angles(q)
    if q.ndim == 1:
        cosines, sines = np.cos(angles).tolist(), np.sin(angles).tolist()
    else:
        by_joint = np.ascontiguousarray(angles.reshape(-1, arm.dof).T)
        cosines, sines = np.cos(by_joint), np.sin(by_joint)
    frames = [frame]
    for c, s, step in zip(cosines, sines, steps, strict=True):
        frame = following(frame, c, s, step)
        frames.append(frame)
    return frames


def _next(frame: Frame, c: Number, s: Number, link: tuple[float, float, float, float]) -> Frame:
    """Frame · RotZ(θ) TransZ(d) TransX(a) RotX(α)."""
    x, y, z, origin = frame
    a, d, cos_alpha, sin_alpha = link
    x, y = _sum(c, x, s, y), _sum(c, y, -s, x)
    if d:
        origin = _sum(1.0, origin, d, z)
    if a:
        origin = _sum(1.0, origin, a, x)
    if sin_alpha:
        y, z = _sum(cos_alpha, y, sin_alpha, z), _sum(cos_alpha, z, -sin_alpha, y)
    elif cos_alpha < 0:
        y, z = (-y[0], -y[1], -y[2]), (-z[0], -z[1], -z[2])
    return x, y, z, origin


def _moved(frame: Frame, c: Number, s: Number, fixed: Frame) -> Frame:
    """Frame · RotZ(q) · the fixed motion to the next joint."""
    x, y, z, origin = frame
    x, y = _sum(c, x, s, y), _sum(c, y, -s, x)
    along, across, axis, way = (
        (
            a * x[0] + b * y[0] + d * z[0],
            a * x[1] + b * y[1] + d * z[1],
            a * x[2] + b * y[2] + d * z[2],
        )
        for a, b, d in fixed
    )
    return along, across, axis, (origin[0] + way[0], origin[1] + way[1], origin[2] + way[2])


def _sum(a: Number, u: Vector, b: Number, v: Vector) -> Vector:
    return (a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2])


def _cross(u: Vector, v: Vector) -> Vector:
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


def _assembled(frame: Frame, shape: tuple[int, ...]) -> Array:
    if not shape:
        return np.array([*zip(*frame, strict=True), (0.0, 0.0, 0.0, 1.0)])
    pose = np.zeros((int(np.prod(shape)), 4, 4))
    for column, vector in enumerate(frame):
        for row, value in enumerate(vector):
            pose[:, row, column] = value
    pose[:, 3, 3] = 1
    return pose.reshape(*shape, 4, 4)
