"""The live loop: devices in their threads, the chain in one, comparison and alarms in another."""

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import robots
from verify.core.records import Array, Measurement, StereoPair
from verify.devices.protocols import CapturedPair
from verify.live.alarms.joints import AlarmLimits, JointAlarms
from verify.live.alarms.loss import LOSS_TIMEOUT, DeviceWatch, TargetWatch
from verify.live.bracketing import (
    MAX_PAIRS_TOGETHER,
    MAX_QUEUED,
    BracketedPair,
    Bracketing,
    MeasuredPair,
)
from verify.live.buffers import ReadingBuffer
from verify.live.clock import ClockKeeper, Estimator
from verify.live.intake import DeviceIntake
from verify.live.joint_row import JointRow
from verify.live.pan_follow import PanFollower
from verify.live.protocols import Alarm, ExpectedPoses, Listener, LiveDevices, MonitoredRobot
from verify.live.recording.recorder import SessionRecorder
from verify.live.state import SILENCE_TIMEOUT, DeviceStatus, LiveState, device_status, with_troubles

DEVICE_CHECK_PERIOD = 0.1  # s from one look at the devices to the next
JOIN_TIMEOUT = 3.0  # s
ARRIVAL_OFFSETS = np.array([-0.1, -0.05, 0.0, 0.05, 0.1])  # s: an arrival's clock is known to that
MAX_PAIRS_IN_PROGRESS = 8  # pairs between the cameras and the comparison, at most


@dataclass(frozen=True, slots=True)
class LoopComputation:
    """What other processes compute for the loop."""

    estimate_clock: Estimator
    measure: Callable[[Iterator[StereoPair], ExpectedPoses], Iterator[Measurement]]
    prepare: Callable[[StereoPair], None] = lambda _: None  # called while a pair is recorded


class LiveLoop:
    """Watches a robot.

    Args:
        subject: the robot and the cameras.
        devices: open; the loop closes them.
        recorder: open; the loop closes it.
        limits: of the alarms.
        duration: s; None: until it is stopped.
        computation: by other processes.
        listeners: called with every row and alarm in the loop's threads: they must not wait.
        state: where the loop writes its state.
    """

    def __init__(
        self,
        subject: MonitoredRobot,
        devices: LiveDevices,
        recorder: SessionRecorder,
        limits: AlarmLimits,
        duration: float | None,
        computation: LoopComputation,
        listeners: Sequence[Listener],
        state: LiveState,
    ) -> None:
        self.state = state
        self._subject, self._devices, self._recorder = subject, devices, recorder
        self._duration, self._listeners = duration, listeners
        self._book = ReadingBuffer()
        self._keeper = ClockKeeper(
            subject.arm, subject.rig, self._book, subject.clock, computation.estimate_clock
        )
        standing = (subject.rig.left.pan, subject.rig.right.pan)
        self._intake = DeviceIntake(
            devices, standing, lambda new: self._book.add(recorder.reading(new)), self._turn
        )
        follows = devices.turn is not None
        self._follower = PanFollower(subject.rig, subject.marker) if follows else None
        turning = devices.pan is not None
        self._bracketing = Bracketing(subject, self._book, self._keeper, turning=turning)
        self._numbers = numbers = itertools.count(1)
        self._joints = JointAlarms(subject.arm.dof, limits, numbers)
        self._target = TargetWatch(LOSS_TIMEOUT, numbers)
        self._lost = DeviceWatch(SILENCE_TIMEOUT, numbers)
        self._measuring = computation.measure
        self._prepare = computation.prepare
        self._arrivals: dict[float, tuple[float, float, CapturedPair]] = {}
        self._measured: deque[MeasuredPair] = deque()
        self._unsettled: dict[float, MeasuredPair] = {}
        self._settled: deque[MeasuredPair] = deque()
        self._wake = threading.Condition()
        self._watching = threading.Lock()  # of the target's alarm: two threads use it
        self._measuring_ended = False
        self.defects: tuple[str, ...] = ()  # why measuring or comparing failed, oldest first
        self._unrecorded = False

    def run(
        self, stop: threading.Event, look: Callable[[LiveState], None] = lambda _: None
    ) -> None:
        """Watch until told to stop, the time is up, the program ends, or the pictures do.

        Args:
            stop: set to end the run; what is under way is still measured and recorded.
            look: called ten times a second, from this thread.
        """
        begin = time.monotonic()
        halt = threading.Event()
        works = [
            threading.Thread(target=self._measure, name="measurement", daemon=True),
            threading.Thread(target=self._compare, name="comparison", daemon=True),
            threading.Thread(target=self._keeper.run, args=(halt,), name="clock", daemon=True),
        ]
        plain, threading.excepthook = threading.excepthook, self._thread_ended
        self._intake.start()
        for work in works:
            work.start()
        try:
            while not self._over(begin, stop):
                self._look()
                look(self.state)
                stop.wait(DEVICE_CHECK_PERIOD)
        finally:
            self._end(works, halt)
            threading.excepthook = plain
        self._look(final=True)
        look(self.state)

    def _turn(self) -> None:
        """Send the follower's order, in the thread that owns the bases' line."""
        order = None if self._follower is None else self._follower.order()
        if order is not None and self._devices.turn is not None:
            self._devices.turn(*order)

    def _thread_ended(self, ended: threading.ExceptHookArgs) -> None:
        """Take note of a thread, of the loop or beside it, that an error has ended."""
        name = "thread" if ended.thread is None else ended.thread.name
        self._failed_step(name, ended.exc_value or ended.exc_type())

    def _failed_step(self, name: str, error: BaseException) -> None:
        """Record that a step of the loop failed, and raise an alarm: its pairs are lost."""
        if name not in self._intake.troubles:
            t, now = time.monotonic(), time.time()
            self._intake.fail(name, error)
            text = f"The {name} has failed: {self._intake.troubles[name]}"
            self.defects += (text,)
            self._raise(Alarm(next(self._numbers), "defect", now, t, text, device=name))

    def _over(self, begin: float, stop: threading.Event) -> bool:
        if stop.is_set() or self._measuring_ended:
            return True
        if self._duration is not None and time.monotonic() - begin >= self._duration:
            return True
        return self._intake.over()

    def _end(self, works: list[threading.Thread], halt: threading.Event) -> None:
        """Cameras first; then what they gave is measured, recorded and told; devices last."""
        self._intake.end_pictures()
        for work in works[:2]:
            work.join(JOIN_TIMEOUT)
        halt.set()
        self._intake.end_readings()
        self._recorder.close()
        self._intake.close()
        for listener in self._listeners:
            listener.close()

    # measuring

    def _measure(self) -> None:
        try:
            pairs = self._recorder.keep(self._taken(), self._prepare)
            for measurement in self._measuring(pairs, self._expected):
                self._hand_over(measurement)
        except Exception as error:
            self._failed_step("measurement", error)
        finally:
            with self._wake:
                self._measuring_ended = True
                self._wake.notify_all()

    def _taken(self) -> Iterator[CapturedPair]:
        """Pairs as they come; pictures of those that are through are let go."""
        for taken, arrived, doubt in self._intake.pairs():
            while len(self._arrivals) >= MAX_PAIRS_IN_PROGRESS:
                del self._arrivals[min(self._arrivals)]
            self._arrivals[taken.t_left] = (arrived, doubt, taken)
            yield taken

    def _hand_over(self, measurement: Measurement) -> None:
        if measurement.settled:
            taken = replace(self._unsettled.pop(measurement.t), measurement=measurement)
            with self._wake:
                self._settled.append(taken)
                self._wake.notify_all()
            return
        self._keeper.add(measurement)
        nothing = (time.monotonic(), 0.0, None)
        arrived, doubt, pair = self._arrivals.pop(measurement.t, nothing)
        if pair is not None:
            self.state.pictures = (pair, measurement)
            if self._follower is not None:
                self._follower.look(pair, measurement, self._expected)
        taken = self._unsettled[measurement.t] = MeasuredPair(measurement, arrived, doubt)
        with self._wake:
            self._measured.append(taken)
            self._wake.notify_all()

    def _expected(self, t: float) -> Sequence[Array]:
        """Where the readings put the flange in the rig, about an instant (s, cameras' clock)."""
        clock = self._keeper.at(t)
        readings = None if clock is None else self._book.about(t - clock.offset)
        if clock is None or readings is None or len(readings.t) < 2:
            return ()
        around = np.zeros(1) if clock.source != "arrival" else ARRIVAL_OFFSETS
        q = readings.at(t - clock.offset + around)
        poses: Array = self._subject.rig.rig_T_base @ robots.forward(self._subject.arm, q)
        return list(poses)

    # comparing

    def _compare(self) -> None:
        while (item := self._next_measured()) is not None:
            try:
                if item[0].measurement.settled:
                    self._settle(item[0])
                    continue
                pairs = [self._bracketing.wait(*item, self._meanwhile)]
                while len(pairs) < MAX_PAIRS_TOGETHER and (more := self._another()) is not None:
                    pairs.append(more)
                for row, since in self._bracketing.compare(pairs):
                    alarms = self._judge(row)
                    self.state.latency.add(time.monotonic() - since)
                    self._publish(row, alarms)
            except Exception as error:
                self._failed_step("comparison", error)

    def _next_measured(self) -> tuple[MeasuredPair, int] | None:
        """Take the next pair and how many wait behind it; settled ones when no other waits."""
        with self._wake:
            self._wake.wait_for(lambda: self._measured or self._settled or self._measuring_ended)
            queue = self._measured or self._settled
            return (queue.popleft(), len(self._measured)) if queue else None

    def _meanwhile(self, frame: int) -> None:
        """Do what is not urgent while a pair waits for its reading."""
        self._recorder.through(frame)
        while len(self._settled) > MAX_QUEUED:
            self._settle(self._settled.popleft())

    def _settle(self, taken: MeasuredPair) -> None:
        """Hand on a pair again, once its successor has shown its motion too."""
        pair = self._bracketing.wait(taken, MAX_QUEUED, lambda _: None)
        (row, _), statistic = self._bracketing.compare([pair])[0], self._joints.statistic
        for listener in self._listeners:
            listener.row(row, statistic)

    def _another(self) -> BracketedPair | None:
        """Take the next measured pair if it needs no wait."""
        with self._wake:
            pair = self._bracketing.at_once(self._measured[0]) if self._measured else None
            if pair is not None:
                self._measured.popleft()
            return pair

    def _judge(self, row: JointRow) -> list[Alarm]:
        now = time.time()
        with self._watching:
            alarms, misfit = self._target.take(row, time.monotonic(), now), self._target.misfit
        return alarms if misfit else alarms + self._joints.take(row, now)

    def _publish(self, row: JointRow, alarms: list[Alarm]) -> None:
        statistic = self._joints.statistic
        self.state.row(row, statistic)
        for alarm in alarms:
            self._raise(alarm)
        for listener in self._listeners:
            listener.row(row, statistic)
        self._recorder.through(row.frame)
        self.state.pair_done()

    def _raise(self, alarm: Alarm) -> None:
        self.state.alarm(alarm)
        for listener in self._listeners:
            listener.alarm(alarm)

    # looking after

    def _look(self, *, final: bool = False) -> None:
        """Update the devices' states; after the end, when they are closed, only the counts."""
        known = self.state.snapshot().devices if final else self._check_devices()
        lines = with_troubles(known, self._intake.troubles)
        self.state.set_status(lines, self._intake.dropped(), self._recorder.state().sentence)

    def _check_devices(self) -> tuple[DeviceStatus, ...]:
        """Describe every device, and raise alarms for those that are silent."""
        t, now = time.monotonic(), time.time()
        alarms: list[Alarm] = []
        lines = []
        for name, device in self._intake.named.items():
            state = device.state()
            alarms += self._lost.take(name, state.age, state.sentence, t, now)
            lines.append(device_status(name, state, self._lost.timeout(name)))
        if self._keeper.trouble:
            lines.append(DeviceStatus("clock", False, self._keeper.trouble))
        with self._watching:
            alarms += self._target.look(t, now)
        recorder = self._recorder.state()
        if not (recorder.recording or self._unrecorded):
            self._unrecorded, text = True, f"The {recorder.sentence}."
            alarms.append(Alarm(next(self._numbers), "device", now, t, text, device="recording"))
        for alarm in alarms:
            self._raise(alarm)
        return tuple(lines)
