"""Encode the commands of MELFA's R3 line protocol that move a robot (BFP-A4288, section 3.3).

What only reads is a `ReadCommand`; a `MotionCommand` is another type, from a list of its own. What
neither list holds cannot be sent: the brakes, jogging, programs, hands, other variables, clearing
an alarm, the real-time control. Beside the commands: what no move may pass, and what refusals and
alarms mean.
"""

import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from verify.core.records import Array
from verify.devices.melfa import protocol
from verify.devices.melfa.reader import DEFAULT_MELFA_LINE
from verify.devices.ports import SerialLine

# this program's own variables on the controller; 8 letters at most
JOINT_VARIABLE, POSE_VARIABLE = "JVFY", "PVFY"
_NUMBER = r"-?[0-9]{1,3}\.[0-9]{3}"
# each with the grammar of its argument
MOVE_COMMANDS: Final = MappingProxyType(
    {
        "CNTLON": "",
        "CNTLOFF": "",
        "SRVON": "",
        "SRVOFF": "",
        "STOP": "",
        "OVRD": r"=(100|[1-9][0-9]?)",
        "EXEC": rf"{JOINT_VARIABLE}=\({_NUMBER}(,{_NUMBER}){{0,7}}\)"
        rf"|{POSE_VARIABLE}=JTOP\({JOINT_VARIABLE}\)|MOV {JOINT_VARIABLE}|MVS {POSE_VARIABLE}",
    }
)
_PARAMETER = re.compile(r"[A-Za-z0-9]+;([-+0-9.,;]+)")


class MotionCommand(protocol.ControllerCommand):
    """A command that moves the robot, or gives the right and the power to."""

    allowed = MOVE_COMMANDS


Request = protocol.ReadCommand | MotionCommand


def move_commands(angle_deg: Array, *, on_line: bool) -> list[MotionCommand]:
    """Word a move to the controller's own angles, (joints,): joint-interpolated, or straight.

    For a straight one the controller turns the angles into its pose itself (JTOP), with its own
    tool and base: no convention of Euler angles, and no other posture that reaches the same pose,
    can come between.
    """
    angles = ",".join(f"{angle:.3f}" for angle in angle_deg.tolist())
    texts = [f"{JOINT_VARIABLE}=({angles})", f"MOV {JOINT_VARIABLE}"]
    if on_line:
        texts[1:] = [f"{POSE_VARIABLE}=JTOP({JOINT_VARIABLE})", f"MVS {POSE_VARIABLE}"]
    return [MotionCommand("EXEC", text) for text in texts]


def parse_limits(data: str, joints: int) -> Array | None:
    """Read PARMEJAR's data; joint limits (joints, 2), deg, or None if it is not that."""
    match = _PARAMETER.fullmatch(data)
    if match is None:
        return None
    try:
        values = [float(word) for word in re.split("[,;]", match[1].strip(";")) if word]
    except ValueError:
        return None
    if len(values) < 2 * joints:
        return None
    limits = np.array(values[: 2 * joints]).reshape(joints, 2)
    return limits if np.all(limits[:, 0] < limits[:, 1]) else None


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
    line: SerialLine = DEFAULT_MELFA_LINE
    terminator: bytes = b"\r"
    pause: float = 0.1  # s, from an answer to the next request, by the maker while it moves
    timeout: float = 1.0  # s
    client: str = "verify"
    move_limit: float = 60.0  # s


def refusal_reason(
    limits: MoveLimits, own_deg: Array, q_now: Array, q: Array, angle_deg: Array
) -> str:
    """Say why a target is refused; empty where it is not.

    The limits are the station's and, `own_deg` (joints, 2), the controller's own. The arm stands at
    q_now (joints,), rad, its target is q, in the controller's own angles `angle_deg`.
    """
    lower, upper = limits.joints.T
    if q.shape != lower.shape or not np.all((q >= lower) & (q <= upper)):
        return f"{np.rad2deg(q).round(2)} degrees are outside the joint limits"
    if not np.all((angle_deg >= own_deg[:, 0]) & (angle_deg <= own_deg[:, 1])):
        return f"{angle_deg.round(2)} degrees are outside the controller's limits"
    if np.max(np.abs(q - q_now)) > limits.largest_step:
        return f"a joint would turn by more than {np.rad2deg(limits.largest_step):.0f} degrees"
    return ""


# the slot of EXEC is taken, or holds what cannot be left: clients report these at the first EXEC
SLOT_ERRORS = frozenset({4160, 5100, 5640})


def refusal_text(name: str, error: int) -> str:
    """Word a refusal."""
    text = f"{name} was refused, error {error}: {protocol.ERROR_MEANINGS.get(error, 'not known')}"
    if name == "EXEC" and error in SLOT_ERRORS:
        return f"{text}; reset the program at the pendant"
    return text


def alarm_text(state: protocol.RunState) -> str:
    """Word what STATE tells of an alarm; empty where there is none."""
    if state.error:
        meaning = protocol.ERROR_MEANINGS.get(state.error, "not known")
        return f"alarm {state.error} is active: {meaning}; clear it at the controller"
    return "the emergency stop is pressed" if state.emergency_stop else ""
