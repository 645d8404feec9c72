import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.devices.bench import (
    Emulated,
    Ramp,
    for_seconds,
    gather,
    kept,
    running,
    same_angles,
)
from verify.devices.encoders.intake import AngleMap
from verify.devices.melfa import protocol
from verify.devices.melfa.reader import MelfaEncoders, MelfaSettings
from verify.devices.ports import SerialLine
from verify.devices.protocols import EncoderReading
from verify.simulation.emulators.arm import MelfaArm
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine
from verify.simulation.emulators.server import EmulatorFaults, TimedMessage

LIMITS = np.tile([-3.0, 3.0], (6, 1))
PORTS = ["tcp:0", "pty"]
FAST = 0.01  # s, pause: tests cannot wait


def controller(options: ControllerOptions | None = None, follows: str = "command") -> MelfaEngine:
    return MelfaEngine(MelfaArm(Ramp(), LIMITS, follows), options or ControllerOptions())


def driver(address: str, pause: float = FAST, **settings: object) -> MelfaEncoders:
    chosen = MelfaSettings(address, pause=pause, **settings)  # type: ignore[arg-type]
    return kept(MelfaEncoders(chosen, same_angles(6)))


def require_true(readings: list[EncoderReading], emulated: Emulated) -> None:
    """Each reading was true at its own time, within its own half-width."""
    for reading in readings:
        true = Ramp().time(reading.q) + emulated.start
        assert abs(reading.t - true) < reading.half_width + 0.005  # of rounding, and the tick


@pytest.mark.realtime
@pytest.mark.parametrize("where", PORTS)
def test_readings_are_true_within_their_half_width(where: str) -> None:
    with running(controller(), where) as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, lambda found: len(found) >= 20)
        encoders.close()
        require_true(readings, emulated)
        assert np.all(np.diff([reading.t for reading in readings]) > 0)
        assert encoders.state().bad == {}


def test_the_controller_is_sent_nothing_but_reading_commands() -> None:
    engine = controller()
    with running(engine) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda found: len(found) >= 5)
        engine.arm.alarm = 1234  # one that it has to ask about
        gather(encoders, lambda found: len(found) >= 5)
        encoders.close()
        time.sleep(0.1)
    names = {re.match("[A-Z]+", command)[0] for command in engine.log}  # type: ignore[index]
    assert {"OPEN", "STATE", "JPOSF", "ERROR", "CLOSE"} <= names
    assert all(any(name.startswith(known) for known in protocol.READ_COMMANDS) for name in names)
    assert engine.log[0] == "OPEN=verify"
    assert engine.log[-1] == "CLOSE"


@pytest.mark.realtime
def test_the_pause_of_the_manual_is_kept() -> None:
    engine = controller(ControllerOptions(least_pause=0.095))
    with running(engine) as emulated:
        encoders = kept(MelfaEncoders(MelfaSettings(emulated.address), same_angles(6)))
        readings = gather(encoders, lambda found: len(found) >= 8)
        assert encoders.state().bad == {}  # it would refuse whoever asks sooner
        assert min(np.diff([reading.t for reading in readings])) > 0.1


@pytest.mark.realtime
@pytest.mark.parametrize("end", [b"\r", b"\r\n", b"\0", b""])
@pytest.mark.parametrize("terminator", [b"\r", b"\r\n", b"\0", b""])
def test_every_terminator_in_use_is_understood(end: bytes, terminator: bytes) -> None:
    with running(controller(ControllerOptions(end=end))) as emulated:
        encoders = driver(emulated.address, terminator=terminator)
        require_true(gather(encoders, lambda found: len(found) >= 2), emulated)
        assert encoders.state().bad == {}


@pytest.mark.realtime
def test_eight_axes_signs_and_zeros() -> None:
    sign = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    offset = np.deg2rad([0.0, 90.0, -90.0, 0.0, 10.0, 0.0])
    with running(controller(ControllerOptions(axes=8))) as emulated:
        settings = MelfaSettings(emulated.address, pause=FAST)
        encoders = kept(MelfaEncoders(settings, AngleMap(sign, offset)))
        for reading in gather(encoders, lambda found: len(found) >= 3):
            Ramp().time(sign * (reading.q - offset))


@pytest.mark.realtime
def test_a_slow_serial_line_gives_few_readings_with_wide_times() -> None:
    """9600 8E2 carries 12 bits a character: 118.8 ms a round trip, says the fact sheet."""
    with running(controller(), "pty", baud=8000) as emulated:  # 8000 at 10 bits is 9600 at 12
        encoders = driver(emulated.address, line=SerialLine(9600, 8, "E", 2))
        readings = gather(encoders, lambda found: len(found) >= 5)
        require_true(readings, emulated)
        widths = [reading.half_width for reading in readings]
        assert 0.045 < np.median(widths) < 0.08


@pytest.mark.realtime
@pytest.mark.parametrize("where", PORTS)
def test_a_disturbed_line_loses_readings_and_gives_no_false_one(where: str) -> None:
    faults = EmulatorFaults(noise=0.2, half=0.1, lost=0.05, split=0.3)
    with running(controller(), where, faults) as emulated:
        encoders = driver(emulated.address, timeout=0.1)
        readings = gather(encoders, for_seconds(4.0))
        assert len(readings) > 10
        require_true(readings, emulated)
        bad = encoders.state().bad
        assert bad["request without an answer"] > 0
        assert bad["answer that is not understood"] > 0
        assert "dropped" in encoders.state().sentence


class Dawdling(MelfaEngine):
    """Every seventh answer comes long after the driver has given up."""

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        messages = super().step(t, received)
        late = 0.3 if len(self.log) % 7 == 0 else 0.0
        return [TimedMessage(message.at + late, message.data) for message in messages]


@pytest.mark.realtime
def test_a_late_answer_is_not_taken_for_the_next_one() -> None:
    engine = Dawdling(MelfaArm(Ramp(), LIMITS, "command"), ControllerOptions())
    with running(engine) as emulated:
        encoders = driver(emulated.address, timeout=0.1)
        readings = gather(encoders, for_seconds(4.0))
        assert len(readings) > 10
        require_true(readings, emulated)
        assert encoders.state().bad["request without an answer"] > 3


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_a_port_that_vanishes_is_named_and_taken_up_again(kind: str, tmp_path: Path) -> None:
    where = "tcp:0" if kind == "tcp" else f"pty:{tmp_path / 'port'}"
    with running(controller(), where, EmulatorFaults(unplug=(0.6, 0.7))) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda found: len(found) >= 3)
        gather(encoders, lambda _: not encoders.state().connected)
        assert f"{emulated.address}: not connected: " in encoders.state().sentence
        require_true(gather(encoders, lambda found: len(found) >= 3), emulated)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("options", "faults", "words"),
    [
        ({"least_pause": 0.09}, {}, "pause is back at 100 ms"),
        ({"robot_type": "RV-6S"}, {}, "the robot is RV-6S; the station says RV-3SD"),
        ({}, {"silence": (0.5, 2.5)}, "silent for"),
        ({}, {"reset": (0.5, 0.5)}, "error 6500: the line is not opened"),
        ({}, {"alarm": (0.0, 4140.0)}, "alarm 4140 is active: the program is missing"),
        ({}, {"alarm": (0.0, 999.0)}, "NO MESSAGE"),  # asked of the controller
    ],
)
def test_a_mishap_is_reported_and_true_readings_continue(
    options: dict[str, Any], faults: dict[str, Any], words: str
) -> None:
    engine = controller(ControllerOptions(**options))
    with running(engine, faults=EmulatorFaults(**faults)) as emulated:
        encoders = driver(emulated.address, robot_type="RV-3SD", timeout=0.3)
        gather(encoders, lambda _: words in encoders.state().sentence)
        readings = gather(encoders, lambda found: len(found) >= 3)
        if "reset" not in faults:  # its arm begins anew
            require_true(readings, emulated)


@pytest.mark.realtime
def test_whether_the_program_runs_is_reported_and_procedural_rs232_is_refused() -> None:
    class Procedural(MelfaEngine):
        def step(self, t: float, received: bytes) -> list[TimedMessage]:
            return [TimedMessage(t, b"\x05")] if received else []

    engine = controller()
    with running(engine) as emulated:
        encoders = driver(emulated.address, state_every=0.2)
        gather(encoders, lambda _: encoders.state().program_running is True)
        engine.arm.running = False
        gather(encoders, lambda _: encoders.state().program_running is False)
    with running(Procedural(engine.arm, ControllerOptions()), "pty") as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda _: "CPRC232" in encoders.state().sentence)
