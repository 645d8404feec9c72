"""MELFA's R3 line protocol, the commands that move a robot (BFP-A4288, section 3.3); no port.

What verification may send is `verify.devices.melfa_lines.Request`; an `Order` is another type, from
a list of its own. What neither list holds cannot be worded: the brakes, jogging, programs, hands,
other people's variables, clearing an alarm, the real-time control.
"""

import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from verify.devices.melfa_lines import ForbiddenCommandError
from verify.records import Array

JOINTS, POSE = "JVFY", "PVFY"  # this program's own variables on the controller; 8 letters at most
_NUMBER = r"-?[0-9]{1,3}\.[0-9]{3}"
# each with the grammar of its argument
MOVING: Final = MappingProxyType(
    {
        "CNTLON": "",
        "CNTLOFF": "",
        "SRVON": "",
        "SRVOFF": "",
        "STOP": "",
        "OVRD": r"=(100|[1-9][0-9]?)",
        "EXEC": rf"{JOINTS}=\({_NUMBER}(,{_NUMBER}){{0,7}}\)|{POSE}=JTOP\({JOINTS}\)"
        rf"|MOV {JOINTS}|MVS {POSE}",
    }
)
_PARAMETER = re.compile(r"[A-Za-z0-9]+;([-+0-9.,;]+)")


@dataclass(frozen=True, slots=True)
class Order:
    """A command that moves the robot, or gives the right and the power to.

    Raises:
        ForbiddenCommandError: not on the list, or an argument that the list does not allow.
    """

    name: str
    argument: str = ""
    slot: int = 1

    def __post_init__(self) -> None:
        grammar = MOVING.get(self.name)
        if grammar is None or not re.fullmatch(grammar, self.argument):
            raise ForbiddenCommandError(f"{self.name}{self.argument} is no order of this program")

    def encoded(self, terminator: bytes) -> bytes:
        """Word it for robot 1."""
        return f"1;{self.slot};{self.name}{self.argument}".encode("ascii") + terminator


def joint_move(angle_deg: Array, slot: int) -> list[Order]:
    """Word a joint-interpolated move to the controller's own angles, (joints,)."""
    return [_set_joints(angle_deg, slot), Order("EXEC", f"MOV {JOINTS}", slot)]


def line_move(angle_deg: Array, slot: int) -> list[Order]:
    """Word a straight move to where the controller's own angles, (joints,), put the hand.

    The controller turns the angles into its pose itself (JTOP), with its own tool and base: no
    convention of Euler angles, and no other posture that reaches the same pose, can come between.
    """
    pose = Order("EXEC", f"{POSE}=JTOP({JOINTS})", slot)
    return [_set_joints(angle_deg, slot), pose, Order("EXEC", f"MVS {POSE}", slot)]


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


def _set_joints(angle_deg: Array, slot: int) -> Order:
    words = ",".join(f"{angle:.3f}" for angle in angle_deg.tolist())
    return Order("EXEC", f"{JOINTS}=({words})", slot)
