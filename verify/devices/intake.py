"""The last yards of every encoder driver: sign and zero, impossible leaps, and the counts."""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from verify.devices.controller_clock import Instant
from verify.devices.link import Link
from verify.devices.protocols import DeviceState, EncoderReading
from verify.errors import InputError
from verify.records import Array

FASTEST = 4 * np.pi  # rad/s: 720°/s; the RV-3SD's quickest joint does 660°/s
SLACK = np.deg2rad(0.5)  # rad: at rest a reading flickers by its last digit
CONFIRM = 5  # readings in a row that contradict the last one before they are believed
LEAP = "leap that no arm can make"
SILENT = 2.0  # s without a reading on an open line before it is called silent


@dataclass(frozen=True, eq=False)
class AngleMap:
    """From a controller's angles to the robot file's own: q = sign · angle + offset.

    The identity where robot file and controller agree, as `rv_3sd_melfa` and the teach pendant do.
    """

    sign: Array  # (joints,), +1 or -1
    offset: Array  # (joints,), rad

    def __post_init__(self) -> None:
        if self.sign.shape != self.offset.shape or not np.all(np.abs(self.sign) == 1.0):
            raise InputError("encoders, sign", "is not 1 or -1 for each joint", "", "Mend it.")
        if not np.all(np.isfinite(self.offset)):
            raise InputError("encoders, offset_deg", "holds what is no number", "", "Mend it.")

    @property
    def joints(self) -> int:
        """How many joints the robot has."""
        return len(self.sign)

    def joint_angles(self, angle: Array) -> Array:
        """Joint angles of the robot file, (joints,), rad."""
        return self.sign * angle + self.offset


class Counts:
    """What came, what was dropped and why; worded for people."""

    def __init__(self) -> None:
        self.bad: Counter[str] = Counter()
        self.readings = 0
        self.lost = 0
        self._last: float | None = None

    def good(self, t_host: float) -> None:
        """Note a good reading."""
        self.readings += 1
        self._last = t_host

    def state(
        self, link: Link, complaint: str = "", note: str = "", program_running: bool | None = None
    ) -> DeviceState:
        """Word how the device is.

        Args:
            link: its line.
            complaint: why no reading can come though the line is open.
            note: what there is to say though readings come.
            program_running: of the robot, where the device tells.
        """
        age = None if self._last is None else link.now() - self._last
        if not link.connected:
            said = f"not connected: {link.fault}"
        elif complaint:
            said = complaint
        elif age is None or age > SILENT:
            said = "connected, no reading yet" if age is None else f"silent for {age:.1f} s"
        else:
            said = "reading"
        parts = [said, note, self._dropped()]
        sentence = f"{link.name}: " + "; ".join(part for part in parts if part)
        return DeviceState(
            link.connected, age, self.readings, self.lost, dict(self.bad), sentence, program_running
        )

    def _dropped(self) -> str:
        parts = [f"{count} {reason}" for reason, count in self.bad.most_common()]
        said = f"dropped: {', '.join(parts)}" if parts else ""
        lost = f"{self.lost} lost on the way" if self.lost else ""
        return "; ".join(part for part in (said, lost) if part)


class Intake:
    """Turns a controller's angles into readings; refuses what no arm can do."""

    def __init__(self, angles: AngleMap, counts: Counts) -> None:
        self._angles, self._counts = angles, counts
        self._last: EncoderReading | None = None
        self._against = 0

    def take(
        self, instant: Instant, t_host: float, half_width: float, angle: Array
    ) -> list[EncoderReading]:
        """Make a reading of angles (joints,), rad, or count why not.

        A leap that is confirmed by those after it is believed: then the arm moved unseen.
        """
        q = self._angles.joint_angles(angle)
        reading = EncoderReading(instant.t, t_host, half_width, instant.segment, q)
        if self._leaps(reading) and self._against < CONFIRM - 1:
            self._against += 1
            self._counts.bad[LEAP] += 1
            return []
        self._against, self._last = 0, reading
        self._counts.good(t_host)
        return [reading]

    def _leaps(self, reading: EncoderReading) -> bool:
        before = self._last
        if before is None:
            return False
        same = before.segment == reading.segment
        elapsed = reading.t - before.t if same else reading.t_host - before.t_host
        room = FASTEST * (max(elapsed, 0.0) + reading.half_width + before.half_width) + SLACK
        turned = np.abs((reading.q - before.q + math.pi) % math.tau - math.pi)  # 359° to 0° is 1°
        return bool(np.any(turned > room))
