"""The current state of a run for terminal, page and metrics, with percentiles of the latency."""

import threading
import time
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import takewhile

import numpy as np

from verify.core.records import Array, Measurement, StereoPair
from verify.devices.protocols import CameraState, DeviceState
from verify.live.joint_row import JointRow
from verify.live.protocols import Alarm

MAX_RESULTS = 1800  # results: a minute at 30 pairs a second
BIN_WIDTH, N_BINS = 1e-4, 20_000  # s, and how many: what took longer than 2 s counts as that


Percentiles = tuple[float, float] | None  # median and 99th, s; None before the first result


class Latency:
    """Collects how long each result took."""

    def __init__(self) -> None:
        self._values: deque[float] = deque(maxlen=MAX_RESULTS)
        self._counts = np.zeros(N_BINS, dtype=np.int64)  # a whole run's memory must not grow

    def add(self, seconds: float) -> None:
        """Take one."""
        self._values.append(seconds)
        self._counts[min(max(int(seconds / BIN_WIDTH), 0), N_BINS - 1)] += 1

    def percentiles(self) -> Percentiles:
        """Percentiles of the last results."""
        values = list(self._values)
        if not values:
            return None
        p50, p99 = np.percentile(values, [50, 99]).tolist()
        return p50, p99

    def of_all(self) -> Percentiles:
        """Percentiles of the whole run, to a tenth of a millisecond."""
        until = np.cumsum(self._counts)
        if not until[-1]:
            return None
        p50, p99 = (np.searchsorted(until, [0.5 * until[-1], 0.99 * until[-1]]) + 1) * BIN_WIDTH
        return float(p50), float(p99)


MAX_ALARMS = 200  # remembered; the JSON lines have all
MAX_ROWS = 600  # remembered for displays: twenty seconds at 30 pairs a second
RATE_SPAN = 5.0  # s
SILENCE_TIMEOUT = 1.0  # s; longer for devices that give less often


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """One device in a line."""

    name: str
    well: bool  # connected, and giving something
    sentence: str


def device_status(
    name: str, state: CameraState | DeviceState, timeout: float = SILENCE_TIMEOUT
) -> DeviceStatus:
    """Summarise a device's state; it is not well if it is silent for longer than `timeout`, s."""
    silent = state.age is None or state.age > timeout
    return DeviceStatus(name, state.connected and not silent, state.sentence)


def with_troubles(
    lines: Iterable[DeviceStatus], troubles: Mapping[str, str]
) -> tuple[DeviceStatus, ...]:
    """Put defects of threads, by name, in place of their devices' lines, others at the end."""
    merged = {line.name: line for line in lines}
    merged |= {name: DeviceStatus(name, False, text) for name, text in troubles.items()}
    return tuple(merged.values())


@dataclass(frozen=True, slots=True)
class LiveSnapshot:
    """The state of a run at one moment."""

    row: JointRow | None
    statistic: Array | None  # (j,), share of what raises an alarm
    rate: float  # pairs a second, of the last seconds
    pairs: int
    measured: int
    dropped: Mapping[str, int]
    latency: Percentiles
    devices: tuple[DeviceStatus, ...]
    alarms: tuple[Alarm, ...]  # newest first
    alarm_counts: Mapping[str, int]  # all of the run, by kind
    recording: str


@dataclass
class LiveState:
    """Shared between the loop, which writes, and the displays, which read."""

    latency: Latency = field(default_factory=Latency)
    pictures: tuple[StereoPair, Measurement] | None = None  # the newest pair, measured
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _pair_done: threading.Condition = field(default_factory=threading.Condition)
    _rows: "deque[tuple[int, JointRow]]" = field(default_factory=lambda: deque(maxlen=MAX_ROWS))
    _times: "deque[float]" = field(default_factory=lambda: deque(maxlen=MAX_ROWS))
    _alarms: dict[int, Alarm] = field(default_factory=dict)
    _counts: Counter[str] = field(default_factory=Counter)
    _status: Counter[str] = field(default_factory=Counter)
    _statistic: Array | None = None
    _dropped: Mapping[str, int] = field(default_factory=dict)
    _devices: tuple[DeviceStatus, ...] = ()
    _recording: str = ""
    _count: int = 0

    def row(self, row: JointRow, statistic: Array) -> None:
        """Take a pair's outcome."""
        with self._lock:
            self._count += 1
            self._rows.append((self._count, row))
            self._times.append(time.monotonic())
            self._status[row.status] += 1
            self._statistic = statistic

    def pair_done(self) -> None:
        """Report that a pair is compared: nothing is urgent until the next one."""
        with self._pair_done:
            self._pair_done.notify_all()

    def wait_for_pair(self, timeout: float) -> bool:
        """Wait until a pair is compared, for at most so many s; whether one was.

        Displays that begin then delay no measurement: threads take turns.
        """
        with self._pair_done:
            return self._pair_done.wait(timeout)

    def alarm(self, alarm: Alarm) -> None:
        """Take an alarm that is new, revised or over."""
        with self._lock:
            self._counts[alarm.kind] += not alarm.revised and alarm.ended is None
            self._alarms[alarm.number] = alarm
            while len(self._alarms) > MAX_ALARMS:
                del self._alarms[min(self._alarms)]

    def set_status(
        self, devices: tuple[DeviceStatus, ...], dropped: Mapping[str, int], recording: str
    ) -> None:
        """Replace the states of devices and recording, and the counts of what was dropped."""
        with self._lock:
            self._devices, self._dropped, self._recording = devices, dict(dropped), recording

    def rows_after(self, number: int) -> list[tuple[int, JointRow]]:
        """Give the rows that came after one, with their numbers, oldest first."""
        with self._lock:
            new = list(takewhile(lambda item: item[0] > number, reversed(self._rows)))
        return new[::-1]

    def statuses(self) -> dict[str, int]:
        """Count pairs by their status."""
        with self._lock:
            return dict(self._status)

    def snapshot(self) -> LiveSnapshot:
        """Describe the run."""
        with self._lock:
            now = time.monotonic()
            recent = sum(1 for t in self._times if t > now - RATE_SPAN)
            alarms = tuple(self._alarms[n] for n in sorted(self._alarms, reverse=True))
            return LiveSnapshot(
                row=self._rows[-1][1] if self._rows else None,
                statistic=self._statistic,
                rate=recent / RATE_SPAN,
                pairs=self._count,
                measured=self._status["measured"],
                dropped=self._dropped,
                latency=self.latency.percentiles(),
                devices=self._devices,
                alarms=alarms,
                alarm_counts=dict(self._counts),
                recording=self._recording,
            )
