"""Forward kinematics and the geometric Jacobian, for one pose or for arrays of them."""

from typing import Any

import numpy as np
import pinocchio

from robots.arm import Arm, DhArm, UrdfArm
from robots.transforms import Array, invert

# Plain floats for one pose (a camera frame must not wait for numpy's overhead), arrays (m,) for
# many: the same arithmetic serves both, one coordinate at a time.
Number = Any
Vector = tuple[Number, Number, Number]
Frame = tuple[Vector, Vector, Vector, Vector]  # x, y, z axes and origin, in the base frame


def forward(arm: Arm, q: Array) -> Array:
    """Place the flange: base_T_flange (..., 4, 4), m, of joint angles q (..., n), rad."""
    q = _checked(arm, q)
    if isinstance(arm, UrdfArm):
        return _one_by_one(arm, q, _urdf_forward, (4, 4))
    assert isinstance(arm, DhArm)
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
    if isinstance(arm, UrdfArm):
        return _one_by_one(arm, q, _urdf_jacobian, (6, arm.dof))
    assert isinstance(arm, DhArm)
    if q.ndim > 1 and q.size == arm.dof:
        return jacobian(arm, q.reshape(-1)).reshape(*q.shape[:-1], 6, 6)
    *before, (_, _, _, tip) = _chain(arm, q)
    columns = []
    for sign, (_, _, axis, origin) in zip(arm.sign.tolist(), before, strict=True):
        signed = (sign * axis[0], sign * axis[1], sign * axis[2])
        columns.append((*_cross(signed, _sum(1.0, tip, -1.0, origin)), *signed))
    if q.ndim == 1:
        return np.array(columns, dtype=float).T
    matrix = np.empty((q.size // 6, 6, 6))
    for joint, column in enumerate(columns):
        for row, value in enumerate(column):
            matrix[:, row, joint] = value
    return matrix.reshape(*q.shape[:-1], 6, 6)


def link_frames(arm: Arm, q: Array) -> Array:
    """Place a frame on every joint's axis, and the flange, at joint angles q (m, n), rad.

    Returns base_T_frame, (m, n + 1, 4, 4), m. Joint i + 1 turns about z of frame i, the last frame
    is the flange: frames 0 to n of a DH table. At a joint of a URDF the origin is the joint's, z
    grows its angle, and x is any direction across.
    """
    q = _checked(arm, q)
    if isinstance(arm, DhArm):
        return np.stack([_assembled(frame, q.shape[:-1]) for frame in _chain(arm, q)], axis=1)
    assert isinstance(arm, UrdfArm)
    rest, q = arm.rest_frames, arm.axis_angles(q)
    frames = np.empty((len(q), arm.dof + 1, 4, 4))
    base_T_moved = np.tile(np.eye(4), (len(q), 1, 1))  # carries a link from q = 0 to q
    turn = np.tile(np.eye(4), (len(q), 1, 1))
    for j in range(arm.dof):
        frames[:, j] = base_T_moved @ rest[j]
        c, s = np.cos(q[:, j]), np.sin(q[:, j])
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
        base_T_moved = frames[:, j] @ turn @ invert(rest[j])
    frames[:, -1] = base_T_moved @ rest[-1]
    return frames


def _checked(arm: Arm, q: Array) -> Array:
    q = np.asarray(q, dtype=float)
    if q.ndim == 0 or q.shape[-1] != arm.dof:
        raise ValueError(f"{arm.name} has {arm.dof} joints; q has shape {q.shape}")
    return q


def _chain(arm: DhArm, q: Array) -> list[Frame]:
    """DH frames 0 to 6."""
    theta = arm.theta(q)
    cosines: Any
    sines: Any
    if q.ndim == 1:
        cosines, sines = np.cos(theta).tolist(), np.sin(theta).tolist()
    else:
        by_joint = np.ascontiguousarray(theta.reshape(-1, 6).T)
        cosines, sines = np.cos(by_joint), np.sin(by_joint)
    frame: Frame = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    frames = [frame]
    for c, s, link in zip(cosines, sines, arm.links, strict=True):
        frame = _next(frame, c, s, link)
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


def _one_by_one(arm: UrdfArm, q: Array, compute: Any, shape: tuple[int, int]) -> Array:
    rows = [compute(arm, row) for row in q.reshape(-1, arm.dof)]
    return np.array(rows, dtype=float).reshape(*q.shape[:-1], *shape)


def _urdf_forward(arm: UrdfArm, q: Array) -> Array:
    pinocchio.framesForwardKinematics(arm.model, arm.data, arm.configuration(q))
    placed = arm.data.oMf
    base_T_flange: Array = placed[arm.base_frame].actInv(placed[arm.tip_frame]).homogeneous
    return base_T_flange


def _urdf_jacobian(arm: UrdfArm, q: Array) -> Array:
    world = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    moved = pinocchio.computeFrameJacobian(
        arm.model, arm.data, arm.configuration(q), arm.tip_frame, world
    )
    # of one joint pinocchio gives a vector
    columns = moved.reshape(6, -1)[:, [place for _, place, _ in arm.joints]]
    pinocchio.updateFramePlacement(arm.model, arm.data, arm.base_frame)
    base_R_world = arm.data.oMf[arm.base_frame].rotation.T
    return np.concatenate([base_R_world @ columns[:3], base_R_world @ columns[3:]])
