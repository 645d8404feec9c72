"""From the lines of a field map to readings: joined where an axis has its own, timed, checked."""

import numpy as np

from verify.devices.controller_clock import ControllerClock, Instant
from verify.devices.field_map import FieldMap, Fields
from verify.devices.intake import AngleMap, Counts, Intake
from verify.devices.link import Chunk
from verify.devices.protocols import EncoderReading
from verify.errors import InputError


class TextIntake:
    """Turns lines into readings.

    Args:
        fields: which field is what.
        angles: from the device's angles to the robot file's own.
        latency: s, the most by which a line comes later than its angles were read.
        counts: where to count.
        in_lumps: lines come late and together as a rule.
    """

    def __init__(
        self,
        fields: FieldMap,
        angles: AngleMap,
        latency: float,
        counts: Counts,
        *,
        in_lumps: bool = False,
    ) -> None:
        if fields.joints != angles.joints:
            found = f"name {fields.joints} joints"
            raise InputError("encoders, columns", found, f"the robot has {angles.joints}")
        self._fields, self._latency, self._counts = fields, latency, counts
        self._intake = Intake(angles, counts)
        self._clock = ControllerClock(fields.wrap, in_lumps=in_lumps)
        self._half: dict[int, float] = {}  # axes of an instant that is not complete yet
        self._half_t: float | None = None
        self._sequence: float | None = None

    def restart(self) -> None:
        """Begin a new line or file: half an instant is forgotten, the clock is not trusted."""
        self._half.clear()
        self._sequence = None
        self._clock.restart(self._fields.wrap)

    def take(self, line: bytes, chunk: Chunk) -> list[EncoderReading]:
        """Make a reading of a line, or count why not."""
        fields = self._fields.parse(line)
        if isinstance(fields, str):
            if fields:
                self._counts.bad[fields] += 1
            return []
        values = self._joined(fields)
        if values is None:
            return []
        timed = self._timed(fields.t, chunk)
        if isinstance(timed, str):
            self._counts.bad[timed] += 1
            return []
        self._count_lost(fields.sequence)
        order = [values[joint] for joint in range(1, self._fields.joints + 1)]
        angle = np.array(order) * self._fields.radians_per_unit
        instant, half_width = timed
        return self._intake.take(instant, chunk.t, half_width, angle)

    def _joined(self, fields: Fields) -> dict[int, float] | None:
        """All joints of an instant; None until the last of them has come."""
        if len(fields.values) == self._fields.joints:
            return fields.values
        if fields.t != self._half_t:
            if self._half:
                self._counts.bad["instant without all joints"] += 1
            self._half, self._half_t = {}, fields.t
        self._half |= fields.values
        if len(self._half) < self._fields.joints:
            return None
        whole, self._half = self._half, {}
        return whole

    def _timed(self, t: float | None, chunk: Chunk) -> tuple[Instant, float] | str:
        """When the angles were read: the device's own time, else the middle of what is possible."""
        unit = self._fields.seconds_per_unit
        if unit is not None and t is not None:
            instant = self._clock.stamp(t * unit, chunk.t)
            # a counter is doubtful by its unit; which decimals of a second count, nobody says
            return instant if isinstance(instant, str) else (instant, unit / 2 if unit < 1 else 0.0)
        earliest = chunk.earliest - self._latency
        return Instant((earliest + chunk.t) / 2, 0), (chunk.t - earliest) / 2

    def _count_lost(self, sequence: float | None) -> None:
        before, self._sequence = self._sequence, sequence
        if before is not None and sequence is not None and sequence > before:
            self._counts.lost += int(sequence - before) - 1
