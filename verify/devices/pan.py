"""Turning camera bases: a LABENC board named PANBASE, axis 1 left, axis 2 right.

`PanReader` can only read; `PanServo` may also turn the bases, and nothing else has that right. A
base's angle is used only with an encoder on its axis: a hobby servo that reports the pulse it was
ordered is a fixed base, calibrated as it stands.
"""

import math

import numpy as np

from verify.devices.encoders.labenc.protocol import MOVING
from verify.devices.encoders.labenc.reader import READ_COMMANDS, LabencBoard
from verify.devices.protocols import PanReading

MAX_PAN_ANGLE = math.radians(180.0)  # rad: a base never needs to look behind itself


class PanReader(LabencBoard):
    """Reads the angles of both bases, left and right; cannot turn them."""

    def read(self) -> list[PanReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        readings = []
        for sample in self.samples():
            self.counts.last = sample.t_host
            instant, pan = sample.instant, self._angles.joint_angles(sample.angle)
            moving = bool(sample.status & MOVING)
            readings.append(
                PanReading(instant.t, sample.t_host, self._half_width, instant.segment, pan, moving)
            )
        return readings


class PanServo(PanReader):
    """Reads the bases and turns them."""

    orders = READ_COMMANDS | {"G"}

    def turn_to(self, left: float, right: float) -> bool:
        """Order both bases to angles, rad, as read; False if the line is down.

        The board answers a refusal (a limit, say) with a message that `state` repeats.

        Raises:
            ValueError: an angle that is no number or beyond half a turn.
        """
        target = np.array([left, right])
        if not np.all(np.abs(target) <= MAX_PAN_ANGLE):
            raise ValueError(f"a base cannot be turned to {np.rad2deg(target)} degrees")
        board = np.rad2deg(self._angles.sign * (target - self._angles.offset))
        return all(
            self.send("G", str(axis), f"{angle:.4f}") for axis, angle in enumerate(board, start=1)
        )
