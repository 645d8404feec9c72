"""What may be identified: named parameters of base, arm and tool, and how one order is kept."""

from dataclasses import dataclass, replace

import numpy as np

from robots.transforms import rotation_exp
from verify.arm_identification.chain import Chain
from verify.records import Array

AXES = ("x", "y", "z", "rx", "ry", "rz")
LINK = ("correction", "d", "a", "alpha", "beta")  # columns of a chain, in this order
# what a parameter is scaled by, so that millimetres and degrees can be set side by side
TOLERANCE_LENGTH = 1e-3  # m
TOLERANCE_ANGLE = float(np.radians(1.0))


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number that may be identified."""

    kind: str  # base, tool, or a column of `LINK`
    place: int  # of base and tool: which of several; else the joint, from 0
    axis: str = ""  # of base and tool: x, y, z, rx, ry, rz

    @property
    def angular(self) -> bool:
        """In rad, not in m."""
        return self.axis in AXES[3:] or self.kind in ("correction", "alpha", "beta")

    @property
    def tolerance(self) -> float:
        """1 mm or 1°, in m or rad."""
        return TOLERANCE_ANGLE if self.angular else TOLERANCE_LENGTH

    @property
    def name(self) -> str:
        """The name in tables: offset_3, d_4, base_rz, tool_2_x (the second tool)."""
        if self.axis:
            return f"{self.kind}_{self.axis}" if not self.place else (
                f"{self.kind}_{self.place + 1}_{self.axis}"
            )  # fmt: skip
        kind = "offset" if self.kind == "correction" else self.kind
        return f"{kind}_{self.place + 1}"


@dataclass(frozen=True, slots=True)
class State:
    """An arm between what measures and what is measured."""

    chain: Chain
    base: Array  # (g, 4, 4): world_T_base of each placing
    tool: Array  # (h, 4, 4): flange_T_target of each mounting


def registration_parameters(kind: str, count: int, *, position_only: bool) -> list[Parameter]:
    """The parameters of `count` bases or tools; a point has no turn."""
    axes = AXES[:3] if position_only and kind == "tool" else AXES
    return [Parameter(kind, place, axis) for place in range(count) for axis in axes]


def offset_parameters(chain: Chain) -> list[Parameter]:
    """The constant offset of every joint."""
    return [Parameter("correction", joint) for joint in range(chain.dof)]


def geometry_parameters(chain: Chain) -> list[Parameter]:
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


def moved(state: State, parameters: tuple[Parameter, ...], change: Array) -> State:
    """Change parameters of a state.

    Args:
        state: what to start from.
        parameters: L of them.
        change: (L,), m and rad. A base moves along and about its own axes, a tool along the
            flange's and about those through the target.
    """
    columns = {key: getattr(state.chain, key).copy() for key in LINK}
    steps = {"base": np.zeros((len(state.base), 6)), "tool": np.zeros((len(state.tool), 6))}
    for parameter, value in zip(parameters, change.tolist(), strict=True):
        if parameter.axis:
            steps[parameter.kind][parameter.place, AXES.index(parameter.axis)] = value
        else:
            columns[parameter.kind][parameter.place] += value
    return State(
        replace(state.chain, **columns),
        state.base @ _step(steps["base"]),
        _mounted(state.tool, steps["tool"]),
    )


def _step(steps: Array) -> Array:
    """Shift by x, y, z and turn by RotX RotY RotZ: (g, 6) to (g, 4, 4)."""
    step = np.tile(np.eye(4), (len(steps), 1, 1))
    step[:, :3, 3] = steps[:, :3]
    for axis in range(3):
        turn = rotation_exp(np.eye(3)[axis] * steps[:, 3 + axis, None])
        step[:, :3, :3] = step[:, :3, :3] @ turn
    return step


def _mounted(tools: Array, steps: Array) -> Array:
    step = _step(steps)
    mounted = tools.copy()
    mounted[:, :3, 3] += step[:, :3, 3]
    mounted[:, :3, :3] = step[:, :3, :3] @ tools[:, :3, :3]
    return mounted
