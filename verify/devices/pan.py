"""Turning camera bases: a LABENC board named PANBASE, axis 1 left, axis 2 right.

`PanReader` can only read; `PanServo` may also turn the bases, and nothing else has that right. A
base's angle is taken as known only with an encoder on its axis: a hobby servo that tells the pulse
it was ordered is a fixed base, calibrated as it stands.
"""

import math
import time
from collections.abc import Callable

import numpy as np

from verify.devices.encoders.intake import AngleMap
from verify.devices.encoders.labenc.protocol import MOVING
from verify.devices.encoders.labenc.reader import READ_COMMANDS, LabencBoard, LabencSettings
from verify.devices.ports import ClockFunction, Port
from verify.devices.protocols import PanReading

TURN_COMMANDS = READ_COMMANDS | {"G"}
N_SIDES = 2
MAX_PAN_ANGLE = math.radians(180.0)  # rad: a base never needs to look behind itself


class PanReader(LabencBoard):
    """Reads the angles of both bases; cannot turn them.

    Args:
        settings: how the board is reached.
        angles: from the board's angles to the bases' own, left and right.
        port: opens the port instead of the settings' address.
        now: the host's monotonic clock, s.
    """

    orders = READ_COMMANDS

    def __init__(
        self,
        settings: LabencSettings,
        angles: AngleMap,
        port: Callable[[], Port] | None = None,
        now: ClockFunction = time.monotonic,
    ) -> None:
        super().__init__(settings, N_SIDES, self.orders, port, now)
        self._angles = angles
        self._half_width = settings.latch_span / 2

    def read(self) -> list[PanReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        readings = []
        for sample in self.samples():
            self.counts.good(sample.t_host)
            instant, pan = sample.instant, self._angles.joint_angles(sample.angle)
            moving = bool(sample.status & MOVING)
            readings.append(
                PanReading(instant.t, sample.t_host, self._half_width, instant.segment, pan, moving)
            )
        return readings


class PanServo(PanReader):
    """Reads the bases and turns them."""

    orders = TURN_COMMANDS

    def turn_to(self, left: float, right: float) -> bool:
        """Order both bases to angles, rad, as read; False if the line is down.

        The board answers a refusal (a limit, say) with a message that `state` repeats.

        Raises:
            ValueError: an angle that is no number or beyond half a turn.
        """
        wanted = np.array([left, right])
        if not np.all(np.abs(wanted) <= MAX_PAN_ANGLE):
            raise ValueError(f"a base cannot be turned to {np.rad2deg(wanted)} degrees")
        board = np.rad2deg(self._angles.sign * (wanted - self._angles.offset))
        return all(
            self.send("G", str(axis), f"{angle:.4f}") for axis, angle in enumerate(board, start=1)
        )
