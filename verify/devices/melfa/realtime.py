"""A MELFA controller's real-time stream (MXT over UDP), read only: a sample a cycle, with a clock.

The robot needs a program that stands in an Mxt instruction. The driver sends two kinds of packets
of 196 bytes, little-endian: "send the encoders' joints" and "end". Without the end the controller
would raise error 7820 and stop that program.

Source: the CR800 Ethernet manual and three public clients that agree.
"""

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from verify.core.records import Array
from verify.devices.encoders.intake import AngleMap, ControllerClock, IntakeCounts, ReadingIntake
from verify.devices.ports import DEFAULT_LINE, ClockFunction, Port, PortLink, open_port
from verify.devices.protocols import DeviceState, EncoderReading

LAYOUT: Final = struct.Struct("<HHHH40sHHHHHHIHH40sHH40sHH40s")
ENCODER_JOINTS: Final = 8  # data type: joints from the encoders
MAX_JOINT_ANGLE: Final = 4 * np.pi  # rad: no joint turns further; garbage does
_EMPTY_FIELD: Final = bytes(40)


def _request(command: int, wanted: int) -> bytes:
    blocks = (0, 0, _EMPTY_FIELD) * 3
    return LAYOUT.pack(command, 0, wanted, 0, _EMPTY_FIELD, 0, 0, 0, 0, 0, 0, 0, *blocks)


# All that a reader ever sends: "no command, tell me the encoders' joints", and "end". The command
# that moves the arm (1) is not made anywhere in this program.
READ_REQUEST: Final = _request(0, ENCODER_JOINTS)
END_REQUEST: Final = _request(255, 0)


@dataclass(frozen=True, slots=True)
class RealtimePacket:
    """What an answer says about the encoders."""

    cycle: int  # counter of the controller's cycles, u32
    missed: int  # packets that the controller missed, u16
    joints: Array  # (joints,), rad, the controller's own angles


def parse_packet(data: bytes, joints: int) -> RealtimePacket | str:
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
    if not np.all(np.abs(angles) <= MAX_JOINT_ANGLE):  # nor what is no number
        return "packet with impossible angles"
    return RealtimePacket(fields[11], fields[10], angles)


CYCLE_TIME = 64 / 9 * 1e-3  # s, on CR750 and CR751; about 3.5 ms on CR800
ANSWER_TIMEOUT = 0.1  # s
COUNTER_MODULUS = 1 << 32
MAX_PACKETS_PER_READ = 64  # packets a call: a flood must not hold the caller


@dataclass(frozen=True, slots=True)
class RealtimeSettings:
    """How the real-time stream is reached."""

    port: str  # udp:HOST:10000
    cycle: float = CYCLE_TIME  # s


class RealtimeEncoders:
    """Joint readings from the encoders, one a cycle of the controller.

    Args:
        settings: how the stream is reached.
        angles: from the controller's angles to the robot file's own.
        port: opens the port instead of the settings' address.
        now: the host's monotonic clock, s.
    """

    def __init__(
        self,
        settings: RealtimeSettings,
        angles: AngleMap,
        port: Callable[[], Port] | None = None,
        now: ClockFunction = time.monotonic,
    ) -> None:
        opens = port or partial(open_port, settings.port, DEFAULT_LINE)
        self._settings, self._joints = settings, angles.joints
        self._link = PortLink(settings.port, opens, now)
        self._counts = IntakeCounts()
        self._intake = ReadingIntake(angles, self._counts)
        self._wrap = COUNTER_MODULUS * settings.cycle
        self._clock = ControllerClock(self._wrap)
        self._cycle: tuple[int, int] | None = None  # and its clock segment
        self._missed: int | None = None
        self._asked_at = float("-inf")

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        readings: list[EncoderReading] = []
        self._ask_if_silent()
        chunk = self._link.receive()
        if self._link.reopened():
            self._clock.restart(self._wrap)
        for _ in range(MAX_PACKETS_PER_READ):
            if chunk is None:
                break
            self._ask()  # one packet each way a cycle
            readings += self._take(chunk.data, chunk.t)
            chunk = self._link.receive(0.0)
        return readings

    def state(self) -> DeviceState:
        """Say how the stream is."""
        note = f"the controller missed {self._missed} of our packets" if self._missed else ""
        return self._counts.state(self._link, "", note)

    def close(self) -> None:
        """End the exchange in good order, and close the port."""
        self._link.send(END_REQUEST)
        self._link.close()

    def _ask(self) -> None:
        self._asked_at = self._link.now()
        self._link.send(READ_REQUEST)

    def _ask_if_silent(self) -> None:
        if self._link.connected and self._link.now() - self._asked_at > ANSWER_TIMEOUT:
            self._ask()

    def _take(self, data: bytes, t_host: float) -> list[EncoderReading]:
        packet = parse_packet(data, self._joints)
        if isinstance(packet, str):
            self._counts.bad[packet] += 1
            return []
        instant = self._clock.stamp(packet.cycle * self._settings.cycle, t_host)
        if isinstance(instant, str):
            self._counts.bad[instant] += 1
            return []
        before, self._cycle = self._cycle, (packet.cycle, instant.segment)
        if before is not None and before[1] == instant.segment:
            self._counts.lost += (packet.cycle - before[0]) % COUNTER_MODULUS - 1
        self._missed = packet.missed
        self._link.steady()
        # where in its cycle the controller latches is not documented: anywhere
        half_width = self._settings.cycle / 2
        return self._intake.take(instant, t_host, half_width, packet.joints)
