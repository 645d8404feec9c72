"""Where a chain puts the target, and how that moves with every parameter: exact, for all rows."""

import numpy as np
from numpy.typing import NDArray

from verify.arm_identification.parameters import AXES, Parameter, State
from verify.records import Array

X, Y, Z = 0, 1, 2


class _Walk:
    """A frame that is carried along the chain; every step leaves its column behind."""

    def __init__(self, pose: Array) -> None:
        self.axes = [pose[:, :3, k].copy() for k in range(3)]
        self.origin = pose[:, :3, 3].copy()
        self.steps: dict[Parameter, tuple[Array, Array | None]] = {}  # direction, and point if turn

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
        """Go on by (4, 4) or (n, 4, 4)."""
        step = np.broadcast_to(step, (len(self.origin), 4, 4))
        frame = np.stack(self.axes, axis=2)
        self.origin = self.origin + np.einsum("nij,nj->ni", frame, step[:, :3, 3])
        turned = frame @ step[:, :3, :3]
        self.axes = [turned[:, :, k] for k in range(3)]

    def pose(self) -> Array:
        found = np.zeros((len(self.origin), 4, 4))
        found[:, :3, :3] = np.stack(self.axes, axis=2)
        found[:, :3, 3], found[:, 3, 3] = self.origin, 1.0
        return found


def predict(state: State, q: Array, base: NDArray[np.int64], tool: NDArray[np.int64]) -> Array:
    """Place the target at readings.

    Args:
        state: chain, bases and tools.
        q: (n, j), rad, as read.
        base: (n,), which base each row belongs to.
        tool: (n,), which tool.

    Returns:
        world_T_target, (n, 4, 4), m.
    """
    return _walk(state, q, base, tool).pose()


def predict_with_jacobian(
    state: State,
    q: Array,
    base: NDArray[np.int64],
    tool: NDArray[np.int64],
    parameters: tuple[Parameter, ...],
) -> tuple[Array, Array]:
    """Place the target, and say how it moves with some parameters.

    Returns:
        world_T_target (n, 4, 4) and (n, 6, L): twist at the target's origin in world axes a unit of
        each parameter, m and rad.
    """
    walk = _walk(state, q, base, tool)
    columns = np.zeros((len(q), 6, len(parameters)))
    for k, parameter in enumerate(parameters):
        if parameter.axis:
            own = (base if parameter.kind == "base" else tool) == parameter.place
            direction, point = walk.steps[Parameter(parameter.kind, 0, parameter.axis)]
        else:
            own = np.ones(len(q), dtype=bool)
            direction, point = walk.steps[parameter]
        if point is None:
            columns[own, :3, k] = direction[own]
        else:
            columns[own, :3, k] = np.cross(direction[own], walk.origin[own] - point[own])
            columns[own, 3:, k] = direction[own]
    return walk.pose(), columns


def _walk(state: State, q: Array, base: NDArray[np.int64], tool: NDArray[np.int64]) -> _Walk:
    chain = state.chain
    walk = _Walk(np.tile(np.eye(4), (len(q), 1, 1)))
    walk.fixed(state.base[base])
    _placing(walk, "base")
    walk.fixed(chain.base_T_first)
    theta = chain.sign * (q + chain.correction) + chain.offset
    for j in range(chain.dof):
        walk.turn(Z, theta[:, j], Parameter("correction", j), float(chain.sign[j]))
        walk.shift(Z, float(chain.d[j]), Parameter("d", j))
        walk.shift(X, float(chain.a[j]), Parameter("a", j))
        walk.turn(X, float(chain.alpha[j]), Parameter("alpha", j))
        walk.turn(Y, float(chain.beta[j]), Parameter("beta", j))
    walk.fixed(chain.last_T_flange)
    mounted = state.tool[tool]
    place, turn = np.tile(np.eye(4), (2, len(q), 1, 1))
    place[:, :3, 3], turn[:, :3, :3] = mounted[:, :3, 3], mounted[:, :3, :3]
    walk.fixed(place)
    _placing(walk, "tool")
    walk.fixed(turn)
    return walk


def _placing(walk: _Walk, kind: str) -> None:
    """Six parameters at a place where nothing is shifted or turned yet."""
    for axis in range(3):
        walk.shift(axis, 0.0, Parameter(kind, 0, AXES[axis]))
    for axis in range(3):
        walk.turn(axis, 0.0, Parameter(kind, 0, AXES[3 + axis]))
