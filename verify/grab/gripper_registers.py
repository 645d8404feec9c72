"""The Robotiq 3-finger gripper's registers: what is ordered, what it tells; no port.

Layout and meanings: Robotiq 3-Finger Adaptive Robot Gripper Instruction Manual, sections 4.4, 4.5.
Two bytes a register, the first in the high half.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Final

from verify.grab.motion_port import GripMode

OUTPUTS, INPUTS = 1000, 2000  # first registers, as they stand on the wire
INPUT_REGISTERS = 8
CLOSED = 255  # position byte; 0 is open
MODES: Final = tuple(GripMode)  # in the order of rMOD
RESET: Final = (0, 0, 0)  # clears faults and the activation
# gFLT -> meaning
FAULTS: Final = MappingProxyType(
    {
        0x05: "it waits for its activation to end",
        0x06: "it waits for its mode to change",
        0x07: "it is not activated",
        0x09: "its communication chip is not ready",
        0x0A: "the fingers stand in the scissor axis's way",
        0x0B: "automatic release is under way",
        0x0D: "the activation has failed: is something between the fingers?",
        0x0E: "the fingers have been in the scissor axis's way for too long",
        0x0F: "automatic release has ended: it must be reset and activated",
    }
)
FIRST_LASTING = 0x09  # lesser ones are gone when what they wait for has happened


class Activation(IntEnum):
    """What gIMC tells."""

    RESET = 0
    ACTIVATING = 1
    CHANGING_MODE = 2
    READY = 3


class Finger(IntEnum):
    """What gDTA to gDTS tell of a finger, or of the scissor axis."""

    MOVING = 0
    CONTACT_OPENING = 1
    CONTACT_CLOSING = 2
    THERE = 3


@dataclass(frozen=True, slots=True)
class Action:
    """What is ordered of all fingers together; the activation bit is always set.

    Any write without that bit would reset the gripper and let go of what it has.
    """

    mode: GripMode = GripMode.BASIC
    go: bool = False
    position: int = 0  # 0 open to 255 closed
    speed: int = 0  # 0 to 255
    force: int = 0  # 0 to 255

    def registers(self) -> list[int]:
        """Word it for registers 1000 to 1002."""
        action = 1 | MODES.index(self.mode) << 1 | int(self.go) << 3
        return [action << 8, self.position, self.speed << 8 | self.force]


@dataclass(frozen=True, slots=True)
class Inputs:
    """What the gripper tells."""

    active: bool
    mode: GripMode
    go: bool
    activation: Activation
    fault: int  # gFLT, 0 none
    moving: bool  # gSTA 0: at least one of them is on its way
    axes: tuple[Finger, ...]  # those that the mode moves: three fingers, or the scissor axis
    echo: int  # of the position that is being gone to
    position: int  # of the axis that is open widest

    @property
    def contacts(self) -> int:
        """How many of the axes something stopped while closing."""
        return self.axes.count(Finger.CONTACT_CLOSING)


def parse_inputs(registers: Sequence[int]) -> Inputs | None:
    """Read registers 2000 to 2007; None if that is not how many there are."""
    if len(registers) != INPUT_REGISTERS:
        return None
    data = b"".join(register.to_bytes(2, "big") for register in registers)
    status, each, mode = data[0], data[1], MODES[data[0] >> 1 & 3]
    moved = (3,) if mode is GripMode.SCISSOR else (0, 1, 2)
    return Inputs(
        bool(status & 1),
        mode,
        bool(status & 8),
        Activation(status >> 4 & 3),
        data[2],
        status >> 6 == 0,
        tuple(Finger(each >> 2 * axis & 3) for axis in moved),
        data[3],
        min(data[4 + 3 * axis] for axis in moved),
    )


def fault_words(fault: int) -> str:
    """Say what a fault means; empty where there is none."""
    if not fault:
        return ""
    return f"fault {fault:#04x}: {FAULTS.get(fault, 'not in the manual')}"
