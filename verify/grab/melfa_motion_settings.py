"""How a MELFA controller is reached for moving, and what no move may pass."""

from dataclasses import dataclass

import numpy as np

from verify.devices.melfa import FACTORY_LINE
from verify.devices.ports import SerialLine
from verify.records import Array


@dataclass(frozen=True, eq=False)
class MoveLimits:
    """What no move may pass, besides the controller's own limits."""

    joints: Array  # (joints, 2), rad, least and greatest angles of the robot file
    largest_step: float = np.pi  # rad that a joint may turn in one move
    hand_speed: float = 0.25  # m/s; faster, and the arm is stopped (the usual reduced speed)
    override: int = 5  # %: the whole arm stretched out then keeps about to the speed above


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """How a MELFA controller is reached for moving."""

    port: str  # tcp:HOST:10001, or a serial device
    robot_type: str  # e.g. RV-3SD: another one is not moved
    line: SerialLine = FACTORY_LINE
    terminator: bytes = b"\r"
    pause: float = 0.1  # s, from an answer to the next request: the maker's wish while it moves
    timeout: float = 1.0  # s
    client: str = "verify"
    slot: int = 1  # whose EXEC is used; the maker's examples use 9
    move_limit: float = 60.0  # s


def outside(limits: MoveLimits, own_deg: Array, q_now: Array, q: Array, angle_deg: Array) -> str:
    """Say why a target is refused; empty where it is not.

    Args:
        limits: the station's.
        own_deg: (joints, 2), the controller's own.
        q_now: (joints,), rad, where the arm stands.
        q: (joints,), rad, the target.
        angle_deg: (joints,), the target in the controller's own angles.
    """
    lower, upper = limits.joints.T
    if q.shape != lower.shape or not np.all((q >= lower) & (q <= upper)):
        return f"{np.rad2deg(q).round(2)} degrees are outside the joint limits"
    if not np.all((angle_deg >= own_deg[:, 0]) & (angle_deg <= own_deg[:, 1])):
        return f"{angle_deg.round(2)} degrees are outside the controller's limits"
    if np.max(np.abs(q - q_now)) > limits.largest_step:
        return f"a joint would turn by more than {np.rad2deg(limits.largest_step):.0f} degrees"
    return ""
