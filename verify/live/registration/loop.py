"""Record a moving robot without comparing: devices in threads, the recorder, what is missing."""

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable

import numpy as np

import robots
from verify.calibration.registration.led_tracks import PairSpots
from verify.core.records import Array
from verify.core.rig import Rig
from verify.devices.protocols import CapturedPair, EncoderReading
from verify.live.alarms.loss import DeviceWatch
from verify.live.intake import OVERRUN, DeviceIntake
from verify.live.protocols import LiveDevices
from verify.live.recording.recorder import SessionRecorder
from verify.live.registration.goals import MIN_LEDS, MotionCoverage, leds_seen
from verify.live.registration.show import RecordingState, SpotDetection
from verify.live.state import SILENCE_TIMEOUT, DeviceStatus, device_status, with_troubles
from verify.measurement import chain

DEVICE_CHECK_PERIOD = 0.1  # s from one look at the devices to the next
DETECTION_PERIOD = 0.2  # s from one pair in which spots are looked for to the next
JOIN_TIMEOUT = 10.0  # s: pairs that are there are still recorded
DISK_BEHIND = "the disk is slower than the cameras"
MAX_APART = 0.25  # s between a pair and the reading that came nearest to it
READINGS_SPAN = 2.0  # s of readings that are remembered


def warm_up(arm: robots.Arm) -> None:
    """Load what looks for spots and counts postures: loading it later would hold all threads up."""
    chain.warm_up()
    coverage = MotionCoverage(arm)
    for q in np.linspace(arm.lower, arm.upper, 3):
        coverage.moved(q)
        coverage.saw(q)
    coverage.goals()


class RecordingLoop:
    """Records until it is stopped, the time is up, or the robot's program, pictures or room end.

    Args:
        arm: whose motion it is.
        rig: the cameras; None where they are not calibrated.
        devices: open; the loop closes them.
        recorder: open; the loop closes it.
        state: where the loop writes its state.
        warn: called with a sentence where a device is silent, and where it is back.
    """

    def __init__(
        self,
        arm: robots.Arm,
        rig: Rig | None,
        devices: LiveDevices,
        recorder: SessionRecorder,
        state: RecordingState,
        warn: Callable[[str], None],
    ) -> None:
        self._rig, self._recorder, self._state, self._warn = rig, recorder, state, warn
        standing = (0.0, 0.0) if rig is None else (rig.left.pan, rig.right.pan)
        self._intake = DeviceIntake(devices, standing, self._add_reading)
        self._coverage, self._lock = MotionCoverage(arm), threading.Lock()
        self._readings: deque[tuple[float, Array]] = deque()  # when each came, s, and joints, rad
        self._lost = DeviceWatch(SILENCE_TIMEOUT, itertools.count(1))
        self._newest: CapturedPair | None = None
        self._looked = -1  # number of the pair in which spots were looked for last
        self._ended = False

    def run(
        self, stop: threading.Event, duration: float | None, look: Callable[[], None]
    ) -> tuple[str, ...]:
        """Record; gives the defects of this program, if there were any.

        Args:
            stop: set to end it; what is under way is still recorded.
            duration: s; None: until it is stopped.
            look: called several times a second, from this thread.
        """
        begin = time.monotonic()
        work = threading.Thread(target=self._record, name="recording", daemon=True)
        self._intake.start()
        work.start()
        due = begin
        try:
            while not self._over(stop, begin, duration):
                self._check_devices()
                if time.monotonic() >= due:
                    due = time.monotonic() + DETECTION_PERIOD
                    self._look_for_spots()
                look()
                stop.wait(DEVICE_CHECK_PERIOD)
        finally:
            self._intake.end_pictures()
            work.join(JOIN_TIMEOUT)
            self._intake.end_readings()
            self._recorder.close()
            self._intake.close()
        # closed devices say nothing of the run
        self._report(self._state.snapshot().devices, finished=True)
        look()
        return tuple(f"The {name} has failed: {why}" for name, why in self._intake.troubles.items())

    def _over(self, stop: threading.Event, begin: float, duration: float | None) -> bool:
        if stop.is_set() or self._ended or not self._recorder.state().recording:
            return True
        late = duration is not None and time.monotonic() - begin >= duration
        return late or self._intake.over()

    def _record(self) -> None:
        try:
            for pair in self._recorder.keep(taken for taken, _, _ in self._intake.pairs()):
                self._newest = pair
                self._recorder.through(pair.frame)  # nothing waits: it may be encoded
        except Exception as error:
            self._intake.fail("recording", error)
        finally:
            self._ended = True

    def _add_reading(self, reading: EncoderReading) -> None:
        written = self._recorder.reading(reading)
        with self._lock:
            self._readings.append((written.t_host, written.q))
            while self._readings[0][0] < written.t_host - READINGS_SPAN:
                self._readings.popleft()
            self._coverage.moved(written.q)

    def _look_for_spots(self) -> None:
        """Look for spots in the newest pair; a posture in which LEDs are seen counts."""
        pair = self._newest
        if pair is None or pair.frame == self._looked:
            return
        self._looked = pair.frame
        spots = chain.detect_in_turn(pair, None, None)
        found = PairSpots(
            frame=pair.frame,
            t=(pair.t_left, pair.t_right),
            pan=(pair.pan_left, pair.pan_right),
            spots=spots,
            height=pair.left.shape[0],
        )
        leds = leds_seen(found, self._rig)
        with self._lock:
            apart, q = min(
                ((abs(t - pair.t_left), q) for t, q in self._readings),
                key=lambda reading: reading[0],
                default=(MAX_APART, None),
            )
            if q is not None and apart < MAX_APART and leds >= MIN_LEDS:
                self._coverage.saw(q)
        images, centres = (pair.left, pair.right), (spots[0].centre, spots[1].centre)
        self._state.change(look=SpotDetection(pair.frame, images, centres, leds))

    def _check_devices(self) -> None:
        t, now = time.monotonic(), time.time()
        lines = []
        for name, device in self._intake.named.items():
            state = device.state()
            for alarm in self._lost.take(name, state.age, state.sentence, t, now):
                self._warn(alarm.text if alarm.ended is None else f"The {name} is back.")
            lines.append(device_status(name, state, self._lost.timeout(name)))
        self._report(tuple(lines))

    def _report(self, devices: tuple[DeviceStatus, ...], *, finished: bool = False) -> None:
        with self._lock:
            goals = self._coverage.goals()
        recorder, dropped = self._recorder.state(), self._intake.dropped()
        if overrun := dropped.pop(OVERRUN, 0):
            dropped[DISK_BEHIND] = overrun
        self._state.change(
            goals=goals, devices=with_troubles(devices, self._intake.troubles),
            pairs=recorder.pairs, readings=recorder.readings, dropped=dropped,
            recording=recorder.sentence, finished=finished,
        )  # fmt: skip
