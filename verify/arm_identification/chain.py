"""Any serial arm of revolute joints as a table: standard DH, with Hayati's β at parallel axes."""

from dataclasses import dataclass

import numpy as np

import robots
from robots.transforms import invert
from verify.records import Array

NEAR_PARALLEL = np.radians(10.0)  # below, DH's common normal is badly placed, and β takes over
COAXIAL = 1e-9  # m


@dataclass(frozen=True, slots=True)
class Chain:
    """n joints: base_T_first · Π RotZ(θ) TransZ(d) TransX(a) RotX(α) RotY(β) · last_T_flange.

    θ = sign · (q + correction) + offset: a correction is what has to be added to the reading.
    Where axes i and i + 1 are (nearly) parallel, β turns about y as α does about x: together they
    lean the next axis either way, which d cannot do for parallel axes. Source: Hayati,
    "Robot arm geometric link parameter estimation", 22nd IEEE CDC, 1983.
    """

    base_T_first: Array  # (4, 4), m
    last_T_flange: Array  # (4, 4), m
    sign: Array  # (n,), +1 or -1
    offset: Array  # (n,), rad
    correction: Array  # (n,), rad, less "encoder less measured"
    d: Array  # (n,), m
    a: Array  # (n,), m
    alpha: Array  # (n,), rad
    beta: Array  # (n,), rad

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.sign)

    @property
    def hayati(self) -> tuple[int, ...]:
        """Joints, from 0, whose axis is nearly parallel to the next one's."""
        lean = np.abs(np.sin(np.hypot(self.alpha, self.beta)))
        near = lean[:-1] < np.sin(NEAR_PARALLEL)
        return tuple(np.flatnonzero(near).tolist())


def chain_of(arm: robots.Arm) -> Chain:
    """Describe an arm as a chain that gives the same poses.

    Args:
        arm: a DH table is taken as it is; a URDF's axes at q = 0 are turned into one.

    Returns:
        The chain, all corrections 0.
    """
    if isinstance(arm, robots.DhArm):
        return Chain(
            np.eye(4), np.eye(4), arm.sign, arm.offset, np.zeros(arm.dof), arm.d, arm.a, arm.alpha,
            np.zeros(arm.dof),
        )  # fmt: skip
    rest = np.zeros(arm.dof)
    base_T_flange, columns = robots.forward(arm, rest), robots.jacobian(arm, rest)
    turns = columns[3:].T
    points = base_T_flange[:3, 3] - np.cross(columns[:3].T, turns)  # nearest to the flange's origin
    frame = _first_frame(turns[0], points[0])
    base_T_first = frame.copy()
    rows = []
    for turn, point in zip(turns[1:], points[1:], strict=True):
        row, step = _link(frame, turn, point)
        rows.append(row)
        frame = frame @ step
    rows.append((0.0,) * 5)
    offset, d, a, alpha, beta = np.array(rows).T
    return Chain(
        base_T_first, invert(frame) @ base_T_flange, np.ones(arm.dof), offset, rest, d, a, alpha,
        beta,
    )  # fmt: skip


def link_transforms(chain: Chain) -> Array:
    """What follows each joint's turn: TransZ(d) TransX(a) RotX(α) RotY(β), (n, 4, 4)."""
    steps = [_after(*row) for row in zip(chain.d, chain.a, chain.alpha, chain.beta, strict=True)]
    return np.array(steps)


def turn_z(angle: float) -> Array:
    """RotZ, (4, 4)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0, 0, 0, 1.0]])


def _first_frame(turn: Array, point: Array) -> Array:
    """Lay z along axis 1, the origin nearest the base's, x near the base's x."""
    frame = np.eye(4)
    x = np.eye(3)[0] if abs(turn[0]) < 0.9 else np.eye(3)[1]
    x = x - (x @ turn) * turn
    x /= np.linalg.norm(x)
    frame[:3, :3] = np.column_stack([x, np.cross(turn, x), turn])
    frame[:3, 3] = point - (point @ turn) * turn
    return frame


def _link(frame: Array, turn: Array, point: Array) -> tuple[tuple[float, ...], Array]:
    """Lead from a frame on one axis to one on the next: offset, d, a, alpha, beta and the step."""
    local = invert(frame)
    w, p = local[:3, :3] @ turn, local[:3, :3] @ point + local[:3, 3]
    across = np.hypot(w[0], w[1])
    if across < np.sin(NEAR_PARALLEL):
        meet = p - w * p[2] / w[2]  # where the next axis crosses this frame's x-y plane
        a, d = float(np.hypot(meet[0], meet[1])), 0.0
        offset = float(np.arctan2(meet[1], meet[0])) if a > COAXIAL else 0.0
    else:
        x = np.array([-w[1], w[0], 0.0]) / across  # along z × w, as the common normal is
        a, d = float(p @ x), float(p[2] - w[2] * (p @ w - p[2] * w[2]) / across**2)
        if a < -COAXIAL:
            x, a = -x, -a
        offset = float(np.arctan2(x[1], x[0]))
    turned = turn_z(-offset)[:3, :3] @ w
    beta = float(np.arcsin(turned[0])) if across < np.sin(NEAR_PARALLEL) else 0.0
    alpha = float(np.arctan2(-turned[1], turned[2]))
    return (offset, d, a, alpha, beta), turn_z(offset) @ _after(d, a, alpha, beta)


def _after(d: float, a: float, alpha: float, beta: float) -> Array:
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    return np.array(
        [[cb, 0.0, sb, a], [sa * sb, ca, -sa * cb, 0.0], [-ca * sb, sa, ca * cb, d], [0, 0, 0, 1.0]]
    )
