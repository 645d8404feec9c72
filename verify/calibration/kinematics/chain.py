"""Kinematic chain of any serial arm of revolute joints, and its parameters that may be identified.

    base_T_flange = T_first Π_j [ RotZ(θ_j) TransZ(d_j) TransX(a_j) RotX(α_j) RotY(β_j) ] T_last
    θ_j           = sign_j (q_j + correction_j) + offset_j, or by linkage · (q + correction)

Standard DH; where axes j and j + 1 are (nearly) parallel, β turns about y as α does about x:
together they lean the next axis either way, which d cannot do there. Source: Hayati, "Robot arm
geometric link parameter estimation", 22nd IEEE CDC, 1983.

    correction, d, a, alpha, beta     of joint 1 … n            rad, m, m, rad, rad
    base_x … base_rz                  of each placing (6)       m, rad, along its own axes
    tool_x … tool_rz                  of each mounting (6)      m, rad, along the flange's axes
"""

from dataclasses import dataclass, field, replace

import numpy as np

import robots
from robots.transforms import invert, rotation_exp, turn_z
from verify.core.records import Array, rigid_transform

MIN_AXIS_ANGLE = np.radians(10.0)  # below, DH's common normal is badly placed, and β takes over
TOL_COAXIAL = 1e-9  # m
AXES = ("x", "y", "z", "rx", "ry", "rz")
LINK_COLUMNS = ("correction", "d", "a", "alpha", "beta")  # columns of a chain, in this order
# what a parameter is scaled by, so that millimetres and degrees can be set side by side
LENGTH_UNIT = 1e-3  # m
ANGLE_UNIT = float(np.radians(1.0))
# standard deviations about the arm's own numbers, as far as is known before anything is measured
LENGTH_PRIOR = 3e-3  # m
ANGLE_PRIOR = float(np.radians(3.0))
PLACEMENT_PRIOR = 1.0  # m or rad: of a free base or tool nothing is known


@dataclass(frozen=True, slots=True)
class KinematicChain:
    """A chain of n joints; a correction is what has to be added to a reading."""

    base_T_first: Array  # (4, 4), m
    last_T_flange: Array  # (4, 4), m
    sign: Array  # (n,), +1 or -1
    offset: Array  # (n,), rad
    correction: Array  # (n,), rad, less "encoder less measured"
    d: Array  # (n,), m
    a: Array  # (n,), m
    alpha: Array  # (n,), rad
    beta: Array  # (n,), rad
    linkage: Array | None  # (n, n), as of `robots.Arm`

    def theta(self, q: Array) -> Array:
        """DH angles (..., n) of readings q (..., n), rad."""
        turned = q + self.correction
        if self.linkage is not None:
            turned = turned @ self.linkage.T
        return np.asarray(self.sign * turned + self.offset)

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.sign)

    @property
    def hayati(self) -> tuple[int, ...]:
        """Joints, from 0, whose axis is nearly parallel to the next one's."""
        lean = np.abs(np.sin(np.hypot(self.alpha, self.beta)))
        return tuple(np.flatnonzero(lean[:-1] < np.sin(MIN_AXIS_ANGLE)).tolist())


def chain_of(arm: robots.Arm) -> KinematicChain:
    """Describe an arm as a chain of the same poses, all corrections 0.

    A DH table is taken as it is; a URDF's axes at q = 0 are turned into one.
    """
    if isinstance(arm, robots.DhArm):
        return KinematicChain(
            np.eye(4), np.eye(4), arm.sign, arm.offset, np.zeros(arm.dof), arm.d, arm.a, arm.alpha,
            np.zeros(arm.dof), arm.linkage,
        )  # fmt: skip
    rest, linkage, arm = np.zeros(arm.dof), arm.linkage, arm.unlinked
    base_T_flange, columns = robots.forward_and_jacobian(arm, rest)
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
    return KinematicChain(
        base_T_first, invert(frame) @ base_T_flange, np.ones(arm.dof), offset, rest, d, a, alpha,
        beta, linkage,
    )  # fmt: skip


def link_transforms(chain: KinematicChain) -> Array:
    """What follows each joint's turn: TransZ(d) TransX(a) RotX(α) RotY(β), (n, 4, 4)."""
    rows = zip(chain.d, chain.a, chain.alpha, chain.beta, strict=True)
    return np.array([_link_transform(*row) for row in rows])


def _first_frame(turn: Array, point: Array) -> Array:
    """Lay z along axis 1, the origin nearest the base's, x near the base's x."""
    x = np.eye(3)[0] if abs(turn[0]) < 0.9 else np.eye(3)[1]
    x = x - (x @ turn) * turn
    x /= np.linalg.norm(x)
    rotation = np.column_stack([x, np.cross(turn, x), turn])
    return rigid_transform(rotation, point - (point @ turn) * turn)


def _link(frame: Array, turn: Array, point: Array) -> tuple[tuple[float, ...], Array]:
    """Lead from a frame on one axis to one on the next: offset, d, a, alpha, beta and the step."""
    local = invert(frame)
    w, p = local[:3, :3] @ turn, local[:3, :3] @ point + local[:3, 3]
    across = np.hypot(w[0], w[1])
    if across < np.sin(MIN_AXIS_ANGLE):
        meet = p - w * p[2] / w[2]  # where the next axis crosses this frame's x-y plane
        a, d = float(np.hypot(meet[0], meet[1])), 0.0
        offset = float(np.arctan2(meet[1], meet[0])) if a > TOL_COAXIAL else 0.0
    else:
        x = np.array([-w[1], w[0], 0.0]) / across  # along z × w, as the common normal is
        a, d = float(p @ x), float(p[2] - w[2] * (p @ w - p[2] * w[2]) / across**2)
        if a < -TOL_COAXIAL:
            x, a = -x, -a
        offset = float(np.arctan2(x[1], x[0]))
    turned = turn_z(-offset)[:3, :3] @ w
    beta = float(np.arcsin(turned[0])) if across < np.sin(MIN_AXIS_ANGLE) else 0.0
    alpha = float(np.arctan2(-turned[1], turned[2]))
    return (offset, d, a, alpha, beta), turn_z(offset) @ _link_transform(d, a, alpha, beta)


def _link_transform(d: float, a: float, alpha: float, beta: float) -> Array:
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    return np.array(
        [[cb, 0.0, sb, a], [sa * sb, ca, -sa * cb, 0.0], [-ca * sb, sa, ca * cb, d], [0, 0, 0, 1.0]]
    )


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number that may be identified."""

    kind: str  # base, tool, or a column of `LINK_COLUMNS`
    place: int  # of base and tool: which of several; else the joint, from 0
    axis: str = ""  # of base and tool: x, y, z, rx, ry, rz
    # m or rad, of its kind in this arm as poses show it; None: not known
    spread: float | None = field(default=None, compare=False)

    @property
    def angular(self) -> bool:
        """In rad, not in m."""
        return self.axis in AXES[3:] or self.kind in ("correction", "alpha", "beta")

    @property
    def tolerance(self) -> float:
        """1 mm or 1°, in m or rad."""
        return ANGLE_UNIT if self.angular else LENGTH_UNIT

    @property
    def prior(self) -> float:
        """Standard deviation that is taken for granted, m or rad."""
        if self.axis:
            return PLACEMENT_PRIOR
        if self.spread is not None:
            return self.spread
        return ANGLE_PRIOR if self.angular else LENGTH_PRIOR

    @property
    def name(self) -> str:
        """The name in tables: offset_3, d_4, base_rz, tool_2_x (the second tool)."""
        if self.axis:
            return "_".join([self.kind, *([f"{self.place + 1}"] if self.place else []), self.axis])
        kind = "offset" if self.kind == "correction" else self.kind
        return f"{kind}_{self.place + 1}"


@dataclass(frozen=True, slots=True)
class ArmState:
    """An arm with its placings in the world and the targets mounted on its flange."""

    chain: KinematicChain
    base: Array  # (g, 4, 4): world_T_base of each placing
    tool: Array  # (h, 4, 4): flange_T_target of each mounting


def registration_parameters(bases: int, tools: int, *, position_only: bool) -> list[Parameter]:
    """The parameters of so many bases, then of so many tools; a point has no turn."""
    placed = ("base", bases, AXES), ("tool", tools, AXES[:3] if position_only else AXES)
    return [Parameter(kind, k, axis) for kind, n, axes in placed for k in range(n) for axis in axes]


def offset_parameters(chain: KinematicChain) -> list[Parameter]:
    """The constant offset of every joint."""
    return [Parameter("correction", joint) for joint in range(chain.dof)]


def geometry_parameters(chain: KinematicChain) -> list[Parameter]:
    """Every α and a, β where the next axis is parallel, and d, those that are redundant last.

    Of several that only their sum shows, the first is kept: along parallel axes the d of the last
    joint, which is where a DH table has its offset.
    """
    joints = range(chain.dof)
    hayati = chain.hayati
    return [
        *(Parameter("alpha", joint) for joint in joints),
        *(Parameter("beta", joint) for joint in hayati),
        *(Parameter("a", joint) for joint in joints),
        *(Parameter("d", joint) for joint in joints if joint not in hayati),
        *(Parameter("d", joint) for joint in hayati),
    ]


def change_state(state: ArmState, parameters: tuple[Parameter, ...], change: Array) -> ArmState:
    """Change L parameters of a state by (L,), m and rad.

    A base moves along and about its own axes, a tool along the flange's and about those through the
    target.
    """
    columns = {key: getattr(state.chain, key).copy() for key in LINK_COLUMNS}
    steps = {"base": np.zeros((len(state.base), 6)), "tool": np.zeros((len(state.tool), 6))}
    for parameter, value in zip(parameters, change.tolist(), strict=True):
        if parameter.axis:
            steps[parameter.kind][parameter.place, AXES.index(parameter.axis)] = value
        else:
            columns[parameter.kind][parameter.place] += value
    tools, moved = state.tool.copy(), _small_motion(steps["tool"])
    tools[:, :3, 3] += moved[:, :3, 3]
    tools[:, :3, :3] = moved[:, :3, :3] @ state.tool[:, :3, :3]
    base = state.base @ _small_motion(steps["base"])
    return ArmState(replace(state.chain, **columns), base, tools)


def _small_motion(steps: Array) -> Array:
    """Shift by x, y, z and turn by RotX RotY RotZ: (g, 6) to (g, 4, 4)."""
    x, y, z = (rotation_exp(np.eye(3)[k] * steps[:, 3 + k, None]) for k in range(3))
    return rigid_transform(x @ y @ z, steps[:, :3])
