"""From a controller's time stamps and angles to checked readings, with counts of what was dropped.

A controller's clock is unwrapped; a reset or a jump begins a new segment of it. `PortDriver` is the
base of every driver that reads a device on a port.
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from verify.core.records import Array
from verify.devices.ports import Chunk, PortLink
from verify.devices.protocols import DeviceState, EncoderReading

MAX_ADVANCE = 0.1  # s by which a stamp may be early: beyond it the clock has jumped
MAX_DELAY = 1.0  # s: an older reading is of no use, and may be of a clock that was set back unseen
MAX_CLOCK_DRIFT = 2e-4  # a crystal is within 1e-4; so fast may the floor rise
N_CONFIRM_CLOCK = 5  # readings in a row that contradict the clock before it is taken for a new one
STALE = "not later than the previous one"
AHEAD = "time stamp ahead of the clock"
TOO_LATE = "too late to be used"


@dataclass(frozen=True, slots=True)
class ControllerInstant:
    """A time on a controller's clock."""

    t: float  # s
    segment: int


class ControllerClock:
    """Follows the time stamps of a controller.

    A message is never there before it was sent, so host time less controller time has a floor. A
    stamp that steps below the floor, lies far above it, or is not later than the last, is refused;
    if it was no accident but the clock that leapt, the following ones say the same, and a segment
    begins. A lump that a paused line delivers late catches up in small steps, and is over before
    any of this is believed.

    Args:
        wraps_after: s, where a counter starts over; None if it does not.
        in_lumps: messages come late and together as a rule: only their order is looked at.
    """

    def __init__(self, wraps_after: float | None, *, in_lumps: bool = False) -> None:
        self._wrap, self._in_lumps = wraps_after, in_lumps
        self._segment = -1
        self._last_raw = self._last = self._last_host = 0.0
        self._floor = float("inf")
        self._anew = True
        self._against, self._against_since = 0, 0.0

    def restart(self, wraps_after: float | None) -> None:
        """Take the next stamp as the first of a new segment: the device was reset, or lost."""
        self._anew, self._wrap = True, wraps_after

    def least(self, t_host: float) -> float:
        """Say what the clock shows at least at t_host, s; -inf before its first stamp."""
        return t_host - self._floor - MAX_CLOCK_DRIFT * (t_host - self._last_host)

    def stamp(self, raw: float, t_host: float) -> ControllerInstant | str:
        """Place a stamp of the controller, s, in hand at t_host, s; or say why it is not used."""
        if self._anew:
            return self._begin(raw, t_host)
        step = self._step(raw, t_host)
        refusal = self._refusal(step, t_host)
        if not refusal:
            return self._accept(raw, self._last + step, t_host)
        return self._begin(raw, t_host) if self._confirmed(refusal, t_host) else refusal

    def _begin(self, raw: float, t_host: float) -> ControllerInstant:
        self._segment += 1
        self._anew, self._floor, self._last_host = False, float("inf"), t_host
        return self._accept(raw, raw, t_host)

    def _accept(self, raw: float, t: float, t_host: float) -> ControllerInstant:
        self._floor = min(self._floor + MAX_CLOCK_DRIFT * (t_host - self._last_host), t_host - t)
        self._last_raw, self._last, self._last_host = raw, t, t_host
        self._against = 0
        return ControllerInstant(t, self._segment)

    def _step(self, raw: float, t_host: float) -> float:
        """Time since the last stamp; after a long silence a counter may have wrapped often."""
        step = raw - self._last_raw
        if self._wrap is None:
            return step
        step %= self._wrap
        turns = round((t_host - self._last_host - step) / self._wrap)
        return step + max(turns, 0) * self._wrap

    def _refusal(self, step: float, t_host: float) -> str:
        if step <= 0.0:
            return STALE
        if self._in_lumps:
            return ""
        elapsed = t_host - self._last_host
        above = t_host - (self._last + step) - self._floor
        if above < -MAX_ADVANCE and step > elapsed + MAX_ADVANCE:
            back = self._wrap is not None and self._wrap - step < self._wrap / 2
            return STALE if back else AHEAD
        return TOO_LATE if above > MAX_DELAY + MAX_CLOCK_DRIFT * elapsed else ""

    def _confirmed(self, refusal: str, t_host: float) -> bool:
        if self._against == 0:
            self._against_since = t_host
        self._against += 1
        lump_is_over = refusal != TOO_LATE or t_host - self._against_since > MAX_DELAY
        return self._against >= N_CONFIRM_CLOCK and lump_is_over


def arrival(chunk: Chunk, latency: float) -> tuple[ControllerInstant, float]:
    """Take the middle of what is possible for bytes without a time stamp, and half its span, s.

    The latency, s, is the most by which they come later than the angles were read.
    """
    earliest = chunk.earliest - latency
    return ControllerInstant((earliest + chunk.t) / 2, 0), (chunk.t - earliest) / 2


MAX_JOINT_ANGLE = 4 * np.pi  # rad: no joint turns further; garbage does
MAX_JOINT_SPEED = 4 * np.pi  # rad/s: 720°/s; the RV-3SD's quickest joint does 660°/s
TOL_ANGLE = np.deg2rad(0.5)  # rad: at rest a reading flickers by its last digit
N_CONFIRM_LEAP = 5  # readings in a row that contradict the last one before they are believed
LEAP = "jump that no arm can make"
SILENCE_TIMEOUT = 2.0  # s without a reading on an open line before it is called silent


@dataclass(frozen=True, eq=False)
class AngleMap:
    """From a controller's angles to the robot file's own: q = sign · angle + offset.

    The identity where robot file and controller agree, as `rv_3sd_melfa` and the teach pendant do.
    """

    sign: Array  # (joints,), +1 or -1
    offset: Array  # (joints,), rad

    @property
    def joints(self) -> int:
        """How many joints the robot has."""
        return len(self.sign)

    def joint_angles(self, angle: Array) -> Array:
        """Joint angles of the robot file, (joints,), rad."""
        return self.sign * angle + self.offset


class IntakeCounts:
    """Counts of the readings that were lost or dropped, and why."""

    def __init__(self) -> None:
        self.bad: Counter[str] = Counter()
        self.lost = 0
        self.last: float | None = None  # s, host: when the last good one was in hand


class PortDriver:
    """A driver on one port: its link, its counts, its state."""

    def __init__(self, link: PortLink) -> None:
        self.link, self.counts = link, IntakeCounts()
        self._fault = self._remark = ""  # why no reading comes; what there is to say beside
        self._running: bool | None = None  # a program of the robot, where the device tells

    def state(self) -> DeviceState:
        """Describe the device."""
        link, counts = self.link, self.counts
        age = None if counts.last is None else link.now() - counts.last
        if not link.connected:
            status = f"not connected: {link.fault}"
        elif self._fault:
            status = self._fault
        elif age is None or age > SILENCE_TIMEOUT:
            status = "connected, no reading yet" if age is None else f"silent for {age:.1f} s"
        else:
            status = "reading"
        dropped = ", ".join(f"{count} {reason}" for reason, count in counts.bad.most_common())
        parts = [
            status,
            self._remark,
            f"dropped: {dropped}" if dropped else "",
            f"{counts.lost} lost on the way" if counts.lost else "",
        ]
        sentence = f"{link.name}: " + "; ".join(filter(None, parts))
        bad = dict(counts.bad)
        return DeviceState(link.connected, age, counts.lost, bad, sentence, self._running)

    def close(self) -> None:
        """Close the port."""
        self.link.close()

    def _drop(self, reason: str) -> list[Any]:
        """Count what is not used; no reading comes of it."""
        self.counts.bad[reason] += 1
        return []


class ReadingIntake:
    """Turns a controller's angles into readings; refuses what no arm can do."""

    def __init__(self, angles: AngleMap, counts: IntakeCounts) -> None:
        self._angles, self._counts = angles, counts
        self._last: EncoderReading | None = None
        self._against = 0

    def take(
        self, instant: ControllerInstant, t_host: float, half_width: float, angle: Array
    ) -> list[EncoderReading]:
        """Make a reading of angles (joints,), rad, or count why not.

        A leap that is confirmed by those after it is believed: then the arm moved unseen.
        """
        q = self._angles.joint_angles(angle)
        reading = EncoderReading(instant.t, t_host, half_width, instant.segment, q)
        if self._leaps(reading) and self._against < N_CONFIRM_LEAP - 1:
            self._against += 1
            self._counts.bad[LEAP] += 1
            return []
        self._against, self._last = 0, reading
        self._counts.last = t_host
        return [reading]

    def _leaps(self, reading: EncoderReading) -> bool:
        before = self._last
        if before is None:
            return False
        same = before.segment == reading.segment
        elapsed = reading.t - before.t if same else reading.t_host - before.t_host
        elapsed = max(elapsed, 0.0) + reading.half_width + before.half_width
        room = MAX_JOINT_SPEED * elapsed + TOL_ANGLE
        turned = np.abs((reading.q - before.q + math.pi) % math.tau - math.pi)  # 359° to 0° is 1°
        return bool(np.any(turned > room))
