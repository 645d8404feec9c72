"""A MELFA controller's real-time stream (MXT over UDP), read only: a sample a cycle, with a clock.

The robot needs a program of its own that stands in an Mxt instruction. This driver asks, listens,
and says the orderly end when it leaves: silence would raise the controller's error 7820 and stop
that program.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from verify.devices import melfa_realtime_packets as packets
from verify.devices.controller_clock import ControllerClock
from verify.devices.intake import AngleMap, Counts, Intake
from verify.devices.link import Link, Now
from verify.devices.ports import USUAL_LINE, Port, open_port
from verify.devices.protocols import DeviceState, EncoderReading

CYCLE = 64 / 9 * 1e-3  # s, on CR750 and CR751; about 3.5 ms on CR800
ASK_AGAIN = 0.1  # s without an answer
CYCLES = 1 << 32
AT_ONCE = 64  # packets a call: a flood must not hold the caller


@dataclass(frozen=True, slots=True)
class RealtimeSettings:
    """How the real-time stream is reached."""

    port: str  # udp:HOST:10000
    cycle: float = CYCLE  # s


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
        now: Now = time.monotonic,
    ) -> None:
        opens = port or partial(open_port, settings.port, USUAL_LINE)
        self._settings, self._joints = settings, angles.joints
        self._link = Link(settings.port, opens, now)
        self._counts = Counts()
        self._intake = Intake(angles, self._counts)
        self._wrap = CYCLES * settings.cycle
        self._clock = ControllerClock(self._wrap)
        self._cycle: tuple[int, int] | None = None  # and its clock segment
        self._missed: int | None = None
        self._connection = 0
        self._asked_at = float("-inf")

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        readings: list[EncoderReading] = []
        self._ask_if_silent()
        chunk = self._link.receive()
        if self._link.connections != self._connection:
            self._connection = self._link.connections
            self._clock.restart(self._wrap)
        for _ in range(AT_ONCE):
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
        self._link.send(packets.END)
        self._link.close()

    def _ask(self) -> None:
        self._asked_at = self._link.now()
        self._link.send(packets.ASK)

    def _ask_if_silent(self) -> None:
        if self._link.connected and self._link.now() - self._asked_at > ASK_AGAIN:
            self._ask()

    def _take(self, data: bytes, t_host: float) -> list[EncoderReading]:
        packet = packets.parse(data, self._joints)
        if isinstance(packet, str):
            self._counts.bad[packet] += 1
            return []
        instant = self._clock.stamp(packet.cycle * self._settings.cycle, t_host)
        if isinstance(instant, str):
            self._counts.bad[instant] += 1
            return []
        before, self._cycle = self._cycle, (packet.cycle, instant.segment)
        if before is not None and before[1] == instant.segment:
            self._counts.lost += (packet.cycle - before[0]) % CYCLES - 1
        self._missed = packet.missed
        self._link.steady()
        # where in its cycle the controller latches is not documented: anywhere
        half_width = self._settings.cycle / 2
        return self._intake.take(instant, t_host, half_width, packet.joints)
