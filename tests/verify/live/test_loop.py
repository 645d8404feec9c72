"""The loop with devices that a test plays: measurements, losses, messages."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from rich.console import Console

from tests.support.rounding import ROUNDING_RAD
from tests.support.spot_level import READ_EVERY, SpotRun, facing_rig, picture, without_pictures
from verify.core.fiducials import Marker
from verify.core.readings import Readings
from verify.core.records import Array, Measurement, StereoPair
from verify.devices.protocols import CameraFrame, CameraState, DeviceState, EncoderReading
from verify.errors import InputError
from verify.live.alarms.joints import AlarmLimits
from verify.live.clock import estimate_offset
from verify.live.intake import MAX_QUEUED_PAIRS, REPEATED, PairQueue, PollingThread, camera_step
from verify.live.joint_row import JointRow
from verify.live.loop import LiveLoop, LoopComputation
from verify.live.measuring_process import ParallelDetector
from verify.live.outputs.listeners import AlarmCommand, JsonLines, ListenerThread, connect_mqtt
from verify.live.outputs.terminal import render_snapshot
from verify.live.pairing import Pairing
from verify.live.protocols import Alarm, ExpectedPoses, LiveDevices, MonitoredRobot
from verify.live.state import DeviceStatus, LiveState
from verify.measurement.chain import Setup, measure
from verify.measurement.detection.detect import detect

RATE = 10.0  # pairs a second: a machine that does other things keeps up
WAIT = 0.02  # s


@dataclass
class Stage:
    """What the played devices share: a clock, a robot, and what is wrong."""

    run: SpotRun
    began: float = field(default_factory=time.monotonic)
    away: dict[str, tuple[float, float]] = field(default_factory=dict)
    ends_at: float = float("inf")

    def now(self) -> float:
        return time.monotonic() - self.began

    def gone(self, name: str) -> bool:
        begin, end = self.away.get(name, (0.0, 0.0))
        return begin <= self.now() < end


class PlayedCamera:
    def __init__(self, stage: Stage, side: int) -> None:
        self._stage, self._side, self._name = stage, side, ("left", "right")[side]
        self._number = 0
        self._last: float | None = None

    def read(self) -> CameraFrame | None:
        due = 0.1 + self._number / RATE
        time.sleep(min(max(due - self._stage.now(), 0.0), WAIT))
        if self._stage.now() < due:
            return None
        self._number += 1
        if self._stage.gone(self._name):
            return None
        t = self._stage.began + due
        self._last = time.monotonic()
        spots = self._stage.run.spots(self._side, due)
        if self._stage.gone("leds"):
            spots = spots[:0]
        return CameraFrame(t, 0.0, picture(spots), None, self._number)

    def state(self) -> CameraState:
        age = None if self._last is None else time.monotonic() - self._last
        return CameraState(not self._stage.gone(self._name), age, 0, f"played {self._name}")

    def close(self) -> None:
        pass


class PlayedEncoders:
    def __init__(self, stage: Stage) -> None:
        self._stage, self._number = stage, 0
        self._last: float | None = None

    def read(self) -> list[EncoderReading]:
        time.sleep(0.005)
        found = []
        while self._number * READ_EVERY < self._stage.now() - 0.002:
            reading = self._stage.run.reading(self._number)
            self._number += 1
            if self._stage.gone("encoders"):
                continue
            t_host = self._stage.began + self._number * READ_EVERY
            found.append(EncoderReading(reading.t, t_host, 50e-6, 0, reading.q))
        if found:
            self._last = time.monotonic()
        return found

    def state(self) -> DeviceState:
        age = None if self._last is None else time.monotonic() - self._last
        running = self._stage.now() < self._stage.ends_at
        return DeviceState(True, age, 0, {}, "played encoders", running)

    def close(self) -> None:
        pass


@dataclass(frozen=True)
class RecorderStatus:
    recording: bool = True
    sentence: str = "kept by the test"


@dataclass
class Memory:
    """A recorder that keeps everything in memory."""

    pairs: list[StereoPair] = field(default_factory=list)
    readings: list[EncoderReading] = field(default_factory=list)
    closed: bool = False

    def keep(
        self, pairs: Iterator[StereoPair], meanwhile: Callable[[StereoPair], None]
    ) -> Iterator[StereoPair]:
        for pair in pairs:
            self.pairs.append(pair)
            meanwhile(pair)
            yield pair

    def through(self, frame: int) -> None:
        assert frame in {pair.frame for pair in self.pairs}

    def reading(self, reading: EncoderReading) -> EncoderReading:
        self.readings.append(reading)
        return reading

    def state(self) -> RecorderStatus:
        return RecorderStatus()

    def close(self) -> None:
        self.closed = True


@dataclass
class Listener:
    rows: list[JointRow] = field(default_factory=list)
    alarms: list[Alarm] = field(default_factory=list)

    def row(self, row: JointRow, _statistic: Array) -> None:
        self.rows.append(row)

    def alarm(self, alarm: Alarm) -> None:
        self.alarms.append(alarm)

    def close(self) -> None:
        pass


def watched(
    seconds: float, stage: Stage, *, marker: Marker | None = None, tolerance: Array | None = None
) -> tuple[LiveLoop, Memory, Listener]:
    """Watch; `marker`: what the watch believes, where that is not so."""
    run = stage.run
    believed = run.marker if marker is None else marker
    devices = LiveDevices(PlayedCamera(stage, 0), PlayedCamera(stage, 1), PlayedEncoders(stage))
    recorder, listener = Memory(), Listener()
    subject = MonitoredRobot(run.arm, run.rig, believed, None)
    limits = AlarmLimits(0.1, RATE, tolerance)

    def here(pairs: Iterator[StereoPair], expected: ExpectedPoses) -> Iterator[Measurement]:
        return measure(pairs, Setup(run.rig, believed, expected), causal=True)

    computation = LoopComputation(estimate_offset, here)
    live = LiveLoop(
        subject, devices, recorder, limits, seconds, computation, [listener], LiveState()
    )
    with without_pictures():
        live.run(threading.Event())
    assert not live._intake.troubles, "a defect is told and outlived by a run, but not by its test"
    return live, recorder, listener


@pytest.mark.parametrize("apart", [False, True])
def test_a_step_or_thread_that_fails_raises_an_alarm_and_is_named_at_the_end(apart: bool) -> None:
    def fail(pairs: Iterator[StereoPair], _expected: object) -> Iterator[object]:
        next(pairs)
        if not apart:
            raise ZeroDivisionError("division by zero")
        thread = threading.Thread(target=lambda: 1 / 0, name="measurement")
        thread.start()
        thread.join()
        yield from ()

    here = stage()
    devices = LiveDevices(PlayedCamera(here, 0), PlayedCamera(here, 1), PlayedEncoders(here))
    subject, heard = MonitoredRobot(here.run.arm, here.run.rig, here.run.marker, None), Listener()
    limits = AlarmLimits(0.1, RATE, None)
    computation = LoopComputation(estimate_offset, fail)
    live = LiveLoop(subject, devices, Memory(), limits, 60.0, computation, [heard], LiveState())
    with without_pictures():
        live.run(threading.Event())
    assert [alarm.kind for alarm in heard.alarms] == ["defect"]
    assert "division by zero" in live.defects[0]
    lines = {line.name: line for line in live.state.snapshot().devices}
    assert not lines["measurement"].well


def stage(**wrong: object) -> Stage:
    rig, marker = facing_rig()
    return Stage(SpotRun(rig, marker), **wrong)  # type: ignore[arg-type]  # fields of Stage


def again(recorder: Memory, run: SpotRun) -> list[Measurement]:
    """Measure the recorded pairs, as a session is."""
    with without_pictures():
        return list(measure(iter(recorder.pairs), Setup(run.rig, run.marker)))


@pytest.mark.realtime
def test_settled_joint_angles_equal_the_recorded_session_s_but_for_rounding() -> None:
    played = stage()
    _, recorder, heard = watched(4.0, played)
    from verify.analysis.comparison import compare, solve_joints
    from verify.measurement.track import collect_track

    measured = again(recorder, played.run)
    assert recorder.closed
    causal, settled = ([r for r in heard.rows if r.settled == s] for s in (False, True))
    assert [r.frame for r in causal] == [r.frame for r in settled] == [m.frame for m in measured]
    assert len(measured) == len(recorder.pairs) > 25
    live = [r for r in settled if r.status == "measured"]
    assert len(live) >= 0.9 * len(measured)
    # each pair is out at once, before it is settled
    first = {r.frame: i for i, r in reversed(list(enumerate(heard.rows)))}
    assert all(not heard.rows[i].settled for i in first.values())
    track = collect_track(measured, played.run.rig, [np.zeros((6, 2))] * len(measured))
    readings = Readings(
        np.array([r.t for r in recorder.readings]), np.array([r.q for r in recorder.readings])
    )
    clock = live[-1].clock
    comparison = compare(track, played.run.arm, readings, clock.offset)
    joints = solve_joints(comparison, played.run.arm)
    found = dict(zip(track.t[comparison.index].tolist(), joints.q, strict=True))
    for row in live:
        if row.t in found:
            np.testing.assert_allclose(row.measured, found[row.t], rtol=0, atol=ROUNDING_RAD)


@pytest.mark.realtime
def test_covered_leds_are_a_lost_target_and_never_no_error() -> None:
    _, _, listener = watched(5.0, stage(away={"leds": (1.5, 3.2)}))
    target = [a for a in listener.alarms if a.kind == "target"]
    assert "too few LEDs" in target[0].text
    assert target[-1].ended is not None
    dark = [r for r in listener.rows if r.status == "too_few_leds"]
    assert dark
    assert all(np.isnan(r.error).all() for r in dark)


@pytest.mark.realtime
def test_leds_placed_by_hand_are_said_at_once_and_no_joint_is_accused() -> None:
    played = stage()
    placed = played.run.marker.leds + np.random.default_rng(2).normal(0, 6e-4, (4, 3))  # m
    marker = replace(played.run.marker, leds=placed)
    _, _, heard = watched(6.0, played, marker=marker, tolerance=np.full(6, np.deg2rad(0.1)))
    first = next(a for a in heard.alarms if "marker.toml" in a.text)
    causal = [r for r in heard.rows if not r.settled]
    assert 10 <= sum(r.t <= first.t for r in causal) <= 30
    # a few fit by chance, with errors that are wrong
    assert any(r.status == "measured" for r in causal)
    assert {a.kind for a in heard.alarms} == {"target"}


@pytest.mark.realtime
def test_silent_encoders_leave_pairs_without_error_and_are_named() -> None:
    _, _, listener = watched(4.5, stage(away={"encoders": (1.0, 9.0)}))
    assert "no_encoder" in {r.status for r in listener.rows}
    assert [a.device for a in listener.alarms if a.kind == "device"] == ["encoders"]
    late = [r for r in listener.rows if r.status == "no_encoder"]
    assert all(np.isnan(r.error).all() for r in late)


@pytest.mark.realtime
def test_the_run_ends_with_the_robot_s_program() -> None:
    begin = time.monotonic()
    watched(60.0, stage(ends_at=1.0))
    assert time.monotonic() - begin < 20.0


@pytest.mark.parametrize("url", ["mqtt://host:99999/a", "mqtt://[::::]/a", "mqtt:///a", "ws://h/a"])
def test_a_broker_that_cannot_be_there_is_refused_in_a_line(url: str) -> None:
    with pytest.raises(InputError, match="mqtt://HOST:PORT/TOPIC is expected"):
        connect_mqtt(url)


@pytest.mark.realtime
def test_a_hanging_listener_blocks_nothing_and_gets_its_alarms() -> None:
    release, listener = threading.Event(), Listener()

    class Slow(Listener):
        def row(self, _row: JointRow, _statistic: Array) -> None:
            release.wait(30.0)

        def alarm(self, alarm: Alarm) -> None:
            listener.alarm(alarm)

    posted = ListenerThread(Slow(), lambda _words: None)
    row = JointRow(0, 0.0, "measured", 4, *[np.zeros(6)] * 5, None)
    begin = time.monotonic()
    for _ in range(5000):
        posted.row(row, np.zeros(6))
    posted.alarm(Alarm(1, "target", 0.0, 0.0, "gone"))
    assert time.monotonic() - begin < 5.0
    release.set()
    posted.close()
    assert [a.number for a in listener.alarms] == [1]


def test_json_lines_carry_units_the_clock_and_no_nan() -> None:
    written: list[dict[str, object]] = []
    lines = JsonLines(written.append)
    row = JointRow(3, 1.5, "too_few_leds", 1, *[np.full(6, np.nan)] * 5, None)
    lines.row(row, np.zeros(6))
    lines.alarm(Alarm(1, "change", 2.0, 1.5, "text", (4, 3), 0.01, 0.001))
    assert written[0]["error_deg"] == [None] * 6
    assert written[0]["clock"] is None
    assert written[0]["settled"] is False
    assert written[1]["joint"] == 4
    assert written[1]["not_told_apart_from"] == [3]
    assert written[1]["error_deg"] == pytest.approx(0.573, abs=1e-3)


def test_the_command_gets_the_facts_and_no_shell_reads_them(tmp_path: Path) -> None:
    script, out = tmp_path / "told.py", tmp_path / "out"
    script.write_text(
        "import os, sys, pathlib\n"
        "pathlib.Path(sys.argv[1]).write_text("
        "os.environ['VERIFY_ALARM_JOINT'] + '|' + sys.argv[2] + '|' + sys.stdin.read())\n"
    )
    command = AlarmCommand(f"{sys.executable} {script} {out} '$(touch nothing); *'")
    command.alarm(Alarm(7, "change", 0.0, 0.0, "text", (4,), 0.01, 0.001))
    joint, word, output = out.read_text().split("|")
    assert (joint, word) == ("4", "$(touch nothing); *")
    assert '"alarm": 7' in output
    command.alarm(Alarm(8, "change", 0.0, 0.0, "text", (4,), 0.01, 0.001, revised=True))
    assert '"alarm": 7' in out.read_text()  # a revision calls nobody again


@pytest.mark.realtime
def test_a_second_process_finds_the_same_spots_and_its_loss_costs_none() -> None:
    message: list[str] = []
    pictures = [np.zeros((240, 320), dtype=np.uint8) for _ in range(2)]
    for image, x in zip(pictures, (100, 141), strict=True):
        cv2.circle(image, (x, 120), 4, 200, -1, cv2.LINE_AA)
        cv2.GaussianBlur(image, (0, 0), 1.2, dst=image)
    windows = np.array([[60.0, 80.0, 200.0, 160.0]])
    pair = StereoPair(0, 0.0, 0.0, 0.0, 0.0, *pictures)
    detector = ParallelDetector(message.append)
    for where in (None, windows):
        found = detector(pair, where, where)
        for image, spots in zip(pictures, found, strict=True):
            expected = detect(image, where)
            np.testing.assert_array_equal(spots.centre, expected.centre)
            np.testing.assert_array_equal(spots.covariance, expected.covariance)
    process = detector._process
    os.kill(process._process.pid, signal.SIGSTOP)
    for _ in range(3):  # waited for once
        assert len(detector(pair, None, None)[1]) == 1
    assert len(message) == 1
    assert "now and then: no answer within 1 s" in message[0]
    assert detector._process is process
    process._process.kill()
    process._process.join()
    found = detector(pair, None, None)
    assert len(found[1]) == 1
    assert len(message) == 2
    assert "from now on" in message[1]
    detector.close()


@pytest.mark.realtime
def test_a_file_waits_until_its_pictures_are_measured() -> None:
    class File:
        """Gives pictures as fast as they are read."""

        def __init__(self) -> None:
            self.number = 0

        def read(self) -> CameraFrame | None:
            if self.number == 200:
                time.sleep(WAIT)
                return None
            self.number += 1
            return CameraFrame(self.number / 30, 0.0, np.zeros((2, 2), np.uint8), None, 0)

    queue, failed = PairQueue(Pairing(1 / 30)), []
    steps = [camera_step(File(), side, queue, patient=True) for side in (0, 1)]  # type: ignore[arg-type]
    pumps = [PollingThread("camera", step, lambda *e: failed.append(e)) for step in steps]
    for pump in pumps:
        pump.start()
    times = []
    for _ in range(200):
        times.append(queue.take().left.t)
        time.sleep(0.001)
    for pump in pumps:
        pump.stop()
        pump.join(5.0)
    assert times == [k / 30 for k in range(1, 201)]
    assert queue.dropped() == {}
    assert failed == []
    assert MAX_QUEUED_PAIRS < 200


def test_a_picture_that_repeats_the_one_before_is_dropped_and_counted() -> None:
    levels, queue = iter([1, 2, 2, 3]), PairQueue(Pairing(1 / 30))
    times = iter(np.arange(4) / 30)
    stuck: Any = SimpleNamespace(
        read=lambda: CameraFrame(next(times), 0.0, np.full((2, 2), next(levels), np.uint8), None, 0)
    )
    step = camera_step(stuck, 0, queue, patient=False, differ=True)
    assert all(step() for _ in range(4))
    assert queue.dropped() == {REPEATED: 1}
    assert queue.pairing.waiting(0) == 3


def test_the_live_table_shows_the_current_state() -> None:
    state = LiveState()
    error = np.deg2rad([0.01, -0.02, 0.5, np.nan, 0.0, 0.0])
    nothing = np.full(6, np.nan)
    doubt = np.deg2rad(np.full(6, 0.02))
    state.row(JointRow(1, 1.0, "measured", 4, nothing, nothing, error, doubt, error, None), doubt)
    state.alarm(Alarm(1, "target", 0.0, 0.0, "Lost.\x1b[31m[red]"))
    state.set_status(
        (DeviceStatus("left camera", False, "gone"),), {"no partner in time": 3}, "kept"
    )
    console = Console(width=110, record=True, force_terminal=False, no_color=True)
    with console.capture() as capture:
        console.print(render_snapshot(state.snapshot(), [0.2] * 6))
    text = capture.get()
    table = ("+0.500°", "0.020°", "left camera", "gone", "no partner in time (3)")
    for part in (*table, "Lost.", "[red]"):
        assert part in text
    assert "\x1b" not in text
