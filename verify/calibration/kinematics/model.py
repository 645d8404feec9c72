"""Forward model of a chain with its Jacobian by every parameter, and start values.

    world_T_target = base T_first Π_j [ RotZ(θ_j) TransZ(d_j) TransX(a_j) RotX(α_j) RotY(β_j) ]
                     T_last tool,           θ_j as in `chain`

A frame is carried along the chain; every elementary shift leaves its direction, every turn its
axis and the point that it passes: together the columns of the geometric Jacobian.
"""

from dataclasses import replace

import numpy as np

from robots.transforms import invert
from verify.calibration.handeye import nearest_rotation, solve_robustly
from verify.calibration.kinematics.chain import AXES, ArmState, KinematicChain, Parameter
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array, Index, rigid_transform

X, Y, Z = 0, 1, 2
MAX_ITERATIONS = 100  # of base and tool in turn; the fit does the rest
TOL_STEP = 1e-6  # m
MAX_RESIDUAL_RATIO = 10.0  # times the median: a pose that is not the arm's spoils the start


class _JacobianBuilder:
    """A frame carried along the chain, and the axis of every step."""

    def __init__(self, pose: Array) -> None:
        self.axes = [pose[:, :3, k].copy() for k in range(3)]
        self.origin = pose[:, :3, 3].copy()
        # direction of each parameter; of a turn also a point of its axis
        self.steps: dict[Parameter, tuple[Array, Array | None]] = {}

    def shift(self, axis: int, by: Array | float, parameter: Parameter) -> None:
        self.steps[parameter] = (self.axes[axis].copy(), None)
        self.origin = self.origin + np.reshape(by, (-1, 1)) * self.axes[axis]

    def turn(self, axis: int, by: Array | float, parameter: Parameter, sign: float = 1.0) -> None:
        self.steps[parameter] = (sign * self.axes[axis], self.origin)
        c, s = np.reshape(np.cos(by), (-1, 1)), np.reshape(np.sin(by), (-1, 1))
        one, other = (axis + 1) % 3, (axis + 2) % 3
        u, v = self.axes[one], self.axes[other]
        self.axes[one], self.axes[other] = c * u + s * v, c * v - s * u

    def fixed(self, step: Array) -> None:
        """Move on by (4, 4) or (n, 4, 4)."""
        step = np.broadcast_to(step, (len(self.origin), 4, 4))
        frame = np.stack(self.axes, axis=2)
        self.origin = self.origin + np.einsum("nij,nj->ni", frame, step[:, :3, 3])
        turned = frame @ step[:, :3, :3]
        self.axes = [turned[:, :, k] for k in range(3)]

    def twist(self, parameter: Parameter) -> Array:
        """Motion of the present origin a unit of a parameter, (n, 6), m and rad."""
        direction, point = self.steps[parameter]
        if point is None:
            return np.concatenate([direction, np.zeros_like(direction)], axis=1)
        return np.concatenate([np.cross(direction, self.origin - point), direction], axis=1)

    def pose(self) -> Array:
        return rigid_transform(np.stack(self.axes, axis=2), self.origin)


def predict_poses(state: ArmState, q: Array, base: Index, tool: Index) -> Array:
    """Place the target at readings q (n, j), rad: world_T_target (n, 4, 4), m.

    `base` (n,) and `tool` (n,) tell which of the state's each row belongs to.
    """
    return _walk(state, q, base, tool).pose()


def predict_with_jacobian(
    state: ArmState, q: Array, base: Index, tool: Index, parameters: tuple[Parameter, ...]
) -> tuple[Array, Array]:
    """Place the target and differentiate its pose by L parameters.

    Returns world_T_target (n, 4, 4) and (n, 6, L): twist at the target's origin in world axes a
    unit of each parameter, m and rad.
    """
    walk = _walk(state, q, base, tool)
    columns = np.zeros((len(q), 6, len(parameters)))
    for k, parameter in enumerate(parameters):
        if parameter.axis:
            own = (base if parameter.kind == "base" else tool) == parameter.place
            columns[own, :, k] = walk.twist(replace(parameter, place=0))[own]
        elif parameter.kind == "correction" and state.chain.linkage is not None:
            for j, factor in enumerate(state.chain.linkage[:, parameter.place].tolist()):
                columns[:, :, k] += factor * walk.twist(replace(parameter, place=j))
        else:
            columns[:, :, k] = walk.twist(parameter)
    return walk.pose(), columns


def _walk(state: ArmState, q: Array, base: Index, tool: Index) -> _JacobianBuilder:
    chain = state.chain
    walk = _JacobianBuilder(np.tile(np.eye(4), (len(q), 1, 1)))
    walk.fixed(state.base[base])
    _placement_columns(walk, "base")
    walk.fixed(chain.base_T_first)
    theta = chain.theta(q)
    for j in range(chain.dof):
        walk.turn(Z, theta[:, j], Parameter("correction", j), float(chain.sign[j]))
        walk.shift(Z, float(chain.d[j]), Parameter("d", j))
        walk.shift(X, float(chain.a[j]), Parameter("a", j))
        walk.turn(X, float(chain.alpha[j]), Parameter("alpha", j))
        walk.turn(Y, float(chain.beta[j]), Parameter("beta", j))
    walk.fixed(chain.last_T_flange)
    mounted = state.tool[tool]
    walk.fixed(rigid_transform(np.eye(3), mounted[:, :3, 3]))
    _placement_columns(walk, "tool")
    walk.fixed(rigid_transform(mounted[:, :3, :3], np.zeros(3)))
    return walk


def _placement_columns(walk: _JacobianBuilder, kind: str) -> None:
    """Register the six parameters of a base or tool at the present frame."""
    for axis in range(3):
        walk.shift(axis, 0.0, Parameter(kind, 0, AXES[axis]))
    for axis in range(3):
        walk.turn(axis, 0.0, Parameter(kind, 0, AXES[3 + axis]))


def start_state(chain: KinematicChain, poses: IdentificationPoses) -> ArmState:
    """Place each base and mount each tool.

    Each combination of base and tool is solved by itself; the fit brings shared ones together.

    Raises:
        ValueError: fewer than three rows of a base or tool.
    """
    bases, tools = int(poses.base.max()) + 1, int(poses.tool.max()) + 1
    state = ArmState(chain, np.tile(np.eye(4), (bases, 1, 1)), np.tile(np.eye(4), (tools, 1, 1)))
    flange = predict_poses(state, poses.q, np.zeros_like(poses.base), np.zeros_like(poses.tool))
    for base, tool in sorted(set(zip(poses.base.tolist(), poses.tool.tolist(), strict=True))):
        own = (poses.base == base) & (poses.tool == tool)
        targets = poses.world_T_target[own]
        if poses.position_only:
            state.base[base], state.tool[tool] = _by_points(targets[:, :3, 3], flange[own])
        else:
            solved, _ = solve_robustly(targets, flange[own], MAX_RESIDUAL_RATIO)
            state.base[base], state.tool[tool] = solved.y, invert(solved.x)
    return state


def _by_points(measured: Array, flange: Array) -> tuple[Array, Array]:
    """Fit the base by a rigid motion of points, the tool by least squares, in turn."""
    if len(flange) < 3:
        raise ValueError("three positions or more are needed")
    tool, centre = np.eye(4), measured.mean(axis=0)
    for _ in range(MAX_ITERATIONS):
        points = flange[:, :3, :3] @ tool[:3, 3] + flange[:, :3, 3]
        middle = points.mean(axis=0)  # carried nearest to the measured ones (Kabsch, 1976)
        turn = nearest_rotation((measured - centre).T @ (points - middle))
        base = rigid_transform(turn, centre - turn @ middle)
        wanted = (measured - base[:3, 3]) @ base[:3, :3] - flange[:, :3, 3]
        found = np.einsum("nij,ni->j", flange[:, :3, :3], wanted) / len(flange)
        step = found - tool[:3, 3]
        tool[:3, 3] = found
        if np.linalg.norm(step) < TOL_STEP:
            break
    return base, tool
