"""MELFA real-time external control (MXT): the two packets a reader sends, and the answers; no port.

196 bytes, little-endian. Source: the CR800 Ethernet manual and three public clients that agree.
"""

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from verify.records import Array

LAYOUT: Final = struct.Struct("<HHHH40sHHHHHHIHH40sHH40sHH40s")
ENCODER_JOINTS: Final = 8  # data type: joints from the encoders
FARTHEST: Final = 4 * np.pi  # rad: no joint turns further; garbage does
_NOTHING: Final = bytes(40)


def _request(command: int, wanted: int) -> bytes:
    blocks = (0, 0, _NOTHING) * 3
    return LAYOUT.pack(command, 0, wanted, 0, _NOTHING, 0, 0, 0, 0, 0, 0, 0, *blocks)


# All that a reader ever sends: "no command, tell me the encoders' joints", and "end". The command
# that moves the arm (1) is not made anywhere in this program.
ASK: Final = _request(0, ENCODER_JOINTS)
END: Final = _request(255, 0)


@dataclass(frozen=True, slots=True)
class Packet:
    """What an answer says about the encoders."""

    cycle: int  # counter of the controller's cycles, u32
    missed: int  # packets that the controller missed, u16
    joints: Array  # (joints,), rad, the controller's own angles


def parse(data: bytes, joints: int) -> Packet | str:
    """Read an answer; where it does not hold encoder angles of so many joints, say why."""
    if len(data) != LAYOUT.size:
        return "packet of another size"
    fields = LAYOUT.unpack(data)
    reserved = (fields[3], fields[13], fields[16], fields[19])
    if any(reserved) or fields[0] not in (0, 1, 255):
        return "packet that is not understood"
    blocks = [(fields[2], fields[4])] + [(fields[i], fields[i + 2]) for i in (12, 15, 18)]
    found = next((block for kind, block in blocks if kind == ENCODER_JOINTS), None)
    if found is None:
        return "packet without encoder joints"
    angles = np.frombuffer(found, dtype="<f4", count=joints).astype(float)
    if not np.all(np.abs(angles) <= FARTHEST):  # nor what is no number
        return "packet with impossible angles"
    return Packet(fields[11], fields[10], angles)
