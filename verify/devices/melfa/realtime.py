"""A MELFA controller's real-time stream (MXT over UDP), read only: a sample a cycle, with a clock.

The robot needs a program that stands in an Mxt instruction. The driver sends two kinds of packets
of 196 bytes, little-endian: "send the encoders' joints" and "end". Without the end the controller
would raise error 7820 and stop that program.

Source: the CR800 Ethernet manual and three public clients that agree.
"""

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from verify.core.records import Array
from verify.devices.encoders import intake
from verify.devices.ports import link_to
from verify.devices.protocols import EncoderReading

LAYOUT: Final = struct.Struct("<HHHH40sHHHHHHIHH40sHH40sHH40s")
ENCODER_JOINTS: Final = 8  # data type: joints from the encoders
_EMPTY_FIELD: Final = bytes(40)


def _request(command: int, data_type: int) -> bytes:
    blocks = (0, 0, _EMPTY_FIELD) * 3
    return LAYOUT.pack(command, 0, data_type, 0, _EMPTY_FIELD, 0, 0, 0, 0, 0, 0, 0, *blocks)


# All that a reader ever sends: "no command, send the encoders' joints", and "end". The command that
# moves the arm (1) is not made anywhere in this program.
READ_REQUEST: Final = _request(0, ENCODER_JOINTS)
END_REQUEST: Final = _request(255, 0)


@dataclass(frozen=True, slots=True)
class RealtimePacket:
    """The encoders' joints in one answer."""

    cycle: int  # counter of the controller's cycles, u32
    missed: int  # packets that the controller missed, u16
    joints: Array  # (joints,), rad, the controller's own angles


def parse_packet(data: bytes, joints: int) -> RealtimePacket | str:
    """Read an answer; the reason, where it does not hold encoder angles of so many joints."""
    if len(data) != LAYOUT.size:
        return "packet of another size"
    fields = LAYOUT.unpack(data)
    reserved = (fields[3], fields[13], fields[16], fields[19])
    if any(reserved) or fields[0] not in (0, 1, 255):
        return "packet that is not understood"
    blocks = [(fields[2], fields[4])] + [(fields[i], fields[i + 2]) for i in (12, 15, 18)]
    block = next((block for kind, block in blocks if kind == ENCODER_JOINTS), None)
    if block is None:
        return "packet without encoder joints"
    angles = np.frombuffer(block, dtype="<f4", count=joints).astype(float)
    if not np.all(np.abs(angles) <= intake.MAX_JOINT_ANGLE):  # nor what is no number
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


class RealtimeEncoders(intake.PortDriver):
    """Joint readings from the encoders, one a cycle of the controller."""

    def __init__(self, settings: RealtimeSettings, angles: intake.AngleMap) -> None:
        super().__init__(link_to(settings.port))
        self._cycle_time, self._joints = settings.cycle, angles.joints
        self._intake = intake.ReadingIntake(angles, self.counts)
        self._wrap = COUNTER_MODULUS * settings.cycle
        self._clock = intake.ControllerClock(self._wrap)
        self._cycle: tuple[int, int] | None = None  # and its clock segment
        self._requested_at = float("-inf")

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        readings: list[EncoderReading] = []
        if self.link.connected and self.link.now() - self._requested_at > ANSWER_TIMEOUT:
            self._request()
        chunk = self.link.receive()
        if self.link.reopened():
            self._clock.restart(self._wrap)
        for _ in range(MAX_PACKETS_PER_READ):
            if chunk is None:
                break
            self._request()  # one packet each way a cycle
            readings += self._take(chunk.data, chunk.t)
            chunk = self.link.receive(0.0)
        return readings

    def close(self) -> None:
        """End the exchange in good order, and close the port."""
        self.link.send(END_REQUEST)
        super().close()

    def _request(self) -> None:
        self._requested_at = self.link.now()
        self.link.send(READ_REQUEST)

    def _take(self, data: bytes, t_host: float) -> list[EncoderReading]:
        packet = parse_packet(data, self._joints)
        if isinstance(packet, str):
            return self._drop(packet)
        instant = self._clock.stamp(packet.cycle * self._cycle_time, t_host)
        if isinstance(instant, str):
            return self._drop(instant)
        before, self._cycle = self._cycle, (packet.cycle, instant.segment)
        if before is not None and before[1] == instant.segment:
            self.counts.lost += (packet.cycle - before[0]) % COUNTER_MODULUS - 1
        if packet.missed:
            self._remark = f"the controller missed {packet.missed} of our packets"
        self.link.steady()
        # where in its cycle the controller latches is not documented: anywhere
        return self._intake.take(instant, t_host, self._cycle_time / 2, packet.joints)
