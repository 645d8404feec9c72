"""A MELFA controller whose program stands in an Mxt instruction: packets over UDP."""

import struct

import numpy as np

from verify.emulators.server import Message
from verify.emulators.trajectory import Trajectory
from verify.records import Array

CYCLE = 64 / 9 * 1e-3  # s
TIMEOUT = 0.5  # s without a packet: error 7820, the stream ends (parameter MXTTOUT)
SERVO_LAG = 0.02  # s by which the arm follows its command
PULSES_PER_RADIAN = 2_000_000.0  # gears and encoders are not public
CYCLES = 1 << 32
COMMANDED, COMMANDED_PULSES, MEASURED, MEASURED_PULSES = 2, 3, 8, 9
LAYOUT = struct.Struct("<HHHH40sHHHHHHIHH40sHH40sHH40s")


class RealtimeEngine:
    """Once asked, answers every cycle while packets keep coming.

    Args:
        trajectory: how the arm moves.
        joints: how many it has.
        drift: by which the controller's clock is fast.
    """

    def __init__(self, trajectory: Trajectory, joints: int, drift: float = 0.0) -> None:
        self.log: list[bytes] = []  # first bytes of every packet received
        self._trajectory, self._joints = trajectory, joints
        self._cycle_time = CYCLE / (1.0 + drift)
        self._wanted = (0, 0, 0, 0)
        self._heard: float | None = None
        self._next = 0.0
        self._count = 0
        self._missed = 0

    def greet(self, t: float) -> None:
        """Take the next caller like the last."""

    def reset(self, t: float) -> None:
        """Start the cycle counter anew."""
        self._count, self._missed, self._next = 0, 0, t

    def afflict(self, fault: str, value: float) -> None:
        """Let the cycle counter leap by so many s."""
        if fault == "jump":
            self._count = (self._count + round(value / CYCLE)) % CYCLES

    def step(self, t: float, received: bytes) -> list[Message]:
        """Count cycles; say one packet in each."""
        if len(received) == LAYOUT.size:
            self._hear(received, t)
        messages = []
        while self._next <= t:
            self._next += self._cycle_time
            self._count = (self._count + 1) % CYCLES
            if self._heard is None:
                continue
            if t - self._heard > TIMEOUT:
                self._heard = None
                continue
            if t - self._heard > 1.5 * self._cycle_time:
                self._missed = (self._missed + 1) % (1 << 16)
            messages.append(Message(t, self._packet(t)))
        return messages

    def _hear(self, data: bytes, t: float) -> None:
        self.log.append(data[:8])
        fields = LAYOUT.unpack(data)
        if fields[0] == 255:
            self._heard = None
            return
        self._wanted = (fields[2], fields[12], fields[15], fields[18])
        if self._heard is None:
            self._missed = 0
        self._heard = t

    def _packet(self, t: float) -> bytes:
        blocks = [(kind, self._block(kind, t)) for kind in self._wanted]
        (first, data), *others = blocks
        rest = [part for kind, block in others for part in (kind, 0, block)]
        return LAYOUT.pack(
            0, 0, first, 0, data, 0, 0, 0, 0, 0, self._missed, self._count, *rest
        )  # fmt: skip

    def _block(self, kind: int, t: float) -> bytes:
        lag = SERVO_LAG if kind in (MEASURED, MEASURED_PULSES) else 0.0
        joints = np.zeros(8)
        joints[: self._joints] = self._at(t - lag)
        if kind in (COMMANDED, MEASURED):
            return joints.astype("<f4").tobytes().ljust(40, b"\0")
        if kind in (COMMANDED_PULSES, MEASURED_PULSES):
            return np.rint(joints * PULSES_PER_RADIAN).astype("<i4").tobytes().ljust(40, b"\0")
        return bytes(40)

    def _at(self, t: float) -> Array:
        return self._trajectory.at(max(t, 0.0))
