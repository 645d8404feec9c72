"""Where to start: base and tool in closed form, from readings taken as true."""

import numpy as np

from robots.transforms import invert
from verify.arm_identification.chain import Chain
from verify.arm_identification.model import predict
from verify.arm_identification.parameters import State
from verify.arm_identification.poses import Poses, some
from verify.calibration.handeye import solve_hand_eye
from verify.records import Array

TURNS = 100  # of the two steps below; the fit polishes what they leave
SETTLED = 1e-6  # m


def start(chain: Chain, poses: Poses) -> State:
    """Place each base and mount each tool.

    Rows of the first base and tool determine both; what other bases or tools share with them is
    found again for each, and the fit brings them together.

    Raises:
        ValueError: fewer than three rows of a base or tool.
    """
    bases, tools = int(poses.base.max()) + 1, int(poses.tool.max()) + 1
    state = State(chain, np.tile(np.eye(4), (bases, 1, 1)), np.tile(np.eye(4), (tools, 1, 1)))
    flange = predict(state, poses.q, np.zeros_like(poses.base), np.zeros_like(poses.tool))
    for base, tool in sorted(set(zip(poses.base.tolist(), poses.tool.tolist(), strict=True))):
        own = (poses.base == base) & (poses.tool == tool)
        placed = _by_points if poses.position_only else _by_poses
        state.base[base], state.tool[tool] = placed(some(poses, own), flange[own])
    return state


def _by_poses(poses: Poses, flange: Array) -> tuple[Array, Array]:
    solved = solve_hand_eye(poses.world_T_target, flange)
    return solved.y, invert(solved.x)


def _by_points(poses: Poses, flange: Array) -> tuple[Array, Array]:
    """Base by fitting points to points, tool by least squares, in turn."""
    if len(flange) < 3:
        raise ValueError("three positions or more are needed")
    seen = poses.world_T_target[:, :3, 3]
    base, tool = np.eye(4), np.eye(4)
    for _ in range(TURNS):
        points = flange[:, :3, :3] @ tool[:3, 3] + flange[:, :3, 3]
        base[:3, :3], base[:3, 3] = _rigid(points, seen)
        wanted = (seen - base[:3, 3]) @ base[:3, :3] - flange[:, :3, 3]
        found = np.einsum("nij,ni->j", flange[:, :3, :3], wanted) / len(flange)
        step = found - tool[:3, 3]
        tool[:3, 3] = found
        if np.linalg.norm(step) < SETTLED:
            break
    return base, tool


def _rigid(points: Array, seen: Array) -> tuple[Array, Array]:
    """The motion that carries points nearest to where they were seen (Kabsch, 1976)."""
    middle, centre = points.mean(axis=0), seen.mean(axis=0)
    u, _, vt = np.linalg.svd((seen - centre).T @ (points - middle))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return turn, centre - turn @ middle
