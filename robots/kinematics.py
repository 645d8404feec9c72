"""Forward kinematics and the geometric Jacobian, for one pose or for arrays of them."""

import math
from typing import Any

import numpy as np

from robots.arm import Arm, DhArm, Frame, UrdfArm, Vector
from robots.elementary import Number
from robots.transforms import Array

BASE: Frame = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


def forward(arm: Arm, q: Array) -> Array:
    """Place the flange: base_T_flange (..., 4, 4), m, of joint angles q (..., n), rad."""
    q = _checked(arm, q)
    return _assembled(_chain(arm, q)[-1], q.shape[:-1])


def jacobian(arm: Arm, q: Array) -> Array:
    """How the flange moves with each joint: the geometric Jacobian (..., 6, n) at q (..., n), rad.

    Velocity of the flange's origin (m/rad), then angular velocity (rad/rad), both in the base
    frame, for q itself (a joint's sign and linkage included).
    """
    q = _checked(arm, q)
    return _moves(arm, _chain(arm, q), q.shape[:-1])


def forward_and_jacobian(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Both at once, in little more than the time of one."""
    q = _checked(arm, q)
    frames = _chain(arm, q)
    return _assembled(frames[-1], q.shape[:-1]), _moves(arm, frames, q.shape[:-1])


def _moves(arm: Arm, frames: list[Frame], shape: tuple[int, ...]) -> Array:
    *before, (_, _, _, tip) = frames
    columns = []
    signs = arm.sign.tolist() if isinstance(arm, DhArm) else [1.0] * arm.dof
    for sign, (_, _, axis, origin) in zip(signs, before, strict=True):
        x, y, z = axis if sign > 0 else _opposite(axis)
        a, b, c = tip[0] - origin[0], tip[1] - origin[1], tip[2] - origin[2]
        columns.append((y * c - z * b, z * a - x * c, x * b - y * a, x, y, z))
    if math.prod(shape) == 1:
        matrix = np.array(columns).T
    else:
        matrix = np.empty((math.prod(shape), 6, arm.dof))
        for joint, column in enumerate(columns):
            for row, value in enumerate(column):
                matrix[:, row, joint] = value
    matrix = matrix.reshape(*shape, 6, arm.dof)
    return matrix if arm.linkage is None else np.asarray(matrix @ arm.linkage)


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
    if q.size == arm.dof:
        angles = angles.ravel()
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
    (x0, x1, x2), (y0, y1, y2), z, origin = frame
    a, d, cos_alpha, sin_alpha = link
    x = (c * x0 + s * y0, c * x1 + s * y1, c * x2 + s * y2)
    y = (c * y0 - s * x0, c * y1 - s * x1, c * y2 - s * x2)
    if d:
        origin = (origin[0] + d * z[0], origin[1] + d * z[1], origin[2] + d * z[2])
    if a:
        origin = (origin[0] + a * x[0], origin[1] + a * x[1], origin[2] + a * x[2])
    if sin_alpha and cos_alpha:
        y, z = _sum(cos_alpha, y, sin_alpha, z), _sum(cos_alpha, z, -sin_alpha, y)
    elif sin_alpha:
        y, z = (z, _opposite(y)) if sin_alpha > 0 else (_opposite(z), y)
    elif cos_alpha < 0:
        y, z = _opposite(y), _opposite(z)
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


def _opposite(u: Vector) -> Vector:
    return (-u[0], -u[1], -u[2])


def _assembled(frame: Frame, shape: tuple[int, ...]) -> Array:
    if math.prod(shape) == 1:
        pose = np.array([*zip(*frame, strict=True), (0.0, 0.0, 0.0, 1.0)])
        return pose.reshape(*shape, 4, 4)
    pose = np.zeros((math.prod(shape), 4, 4))
    for column, vector in enumerate(frame):
        for row, value in enumerate(vector):
            pose[:, row, column] = value
    pose[:, 3, 3] = 1
    return pose.reshape(*shape, 4, 4)
