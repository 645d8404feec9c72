import time
from pathlib import Path

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
from verify.devices.encoders.labenc.reader import LabencEncoders, LabencSettings
from verify.devices.protocols import EncoderReading
from verify.simulation.emulators.encoders import LabencEngine, LabencOptions
from verify.simulation.emulators.server import EmulatorFaults

PORTS = ["tcp:0", "pty"]
QUICK = LabencOptions(greeting_after=0.05)


def driver(address: str, joints: int = 6, **settings: object) -> LabencEncoders:
    chosen = LabencSettings(address, **settings)  # type: ignore[arg-type]
    return kept(LabencEncoders(chosen, same_angles(joints)))


def require_true(readings: list[EncoderReading], emulated: Emulated) -> None:
    """Within a segment, the controller's time is the trajectory's but for a constant."""
    for segment in {reading.segment for reading in readings}:
        mine = [reading for reading in readings if reading.segment == segment]
        t = np.array([reading.t for reading in mine])
        true = np.array([Ramp().time(reading.q) for reading in mine])
        assert np.all(np.diff(t) > 0)
        np.testing.assert_allclose(t - true, (t - true)[0], atol=1e-3)
        late = np.array([reading.t_host for reading in mine]) - emulated.start - true
        assert np.all(late > -1e-3)  # nothing is there before it was read


@pytest.mark.parametrize("where", PORTS)
def test_every_sample_of_the_stream_arrives_and_is_true(where: str) -> None:
    engine = LabencEngine(Ramp(), 6, QUICK)
    with running(engine, where) as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, lambda found: len(found) >= 100)
        require_true(readings, emulated)
        np.testing.assert_allclose(np.diff([r.t for r in readings]), 0.01, atol=2e-5)
        state = encoders.state()
        assert (state.lost, dict(state.bad)) == (0, {})
        assert state.sentence == f"{emulated.address}: reading"
        encoders.close()
    assert {order.split(",")[0] for order in engine.log} <= {"Q", "S", "R", "D"}


@pytest.mark.realtime
def test_the_counter_wraps_in_mid_run() -> None:
    options = LabencOptions(greeting_after=0.05, first_tick=2**32 - 500_000)
    with running(LabencEngine(Ramp(), 6, options)) as emulated:
        readings = gather(driver(emulated.address), lambda found: len(found) >= 100)
        require_true(readings, emulated)
        assert {reading.segment for reading in readings} == {0}
        assert readings[-1].t > 2**32 * 1e-6


@pytest.mark.realtime
def test_raw_counts_are_requested_and_scaled() -> None:
    with running(LabencEngine(Ramp(), 6, QUICK)) as emulated:
        encoders = driver(emulated.address, unit="counts", rate=50)
        readings = gather(encoders, lambda found: len(found) >= 60)
        for reading in readings:
            Ramp().time(reading.q)
        np.testing.assert_allclose(np.diff([r.t for r in readings[-20:]]), 0.02, atol=2e-5)


@pytest.mark.realtime
def test_crc16_and_carriage_returns() -> None:
    options = LabencOptions(greeting_after=0.05, checksum="crc16", carriage_return=True)
    with running(LabencEngine(Ramp(), 6, options)) as emulated:
        encoders = driver(emulated.address, checksum="crc16")
        require_true(gather(encoders, lambda found: len(found) >= 20), emulated)
        assert dict(encoders.state().bad) == {}


@pytest.mark.realtime
@pytest.mark.parametrize("where", PORTS)
def test_a_disturbed_line_loses_samples_and_gives_no_false_one(where: str) -> None:
    faults = EmulatorFaults(noise=0.1, half=0.05, digit=0.1, double=0.1, lost=0.1, split=0.2)
    with running(LabencEngine(Ramp(), 6, QUICK), where, faults) as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, for_seconds(3.0))
        assert len(readings) > 50
        require_true(readings, emulated)
        state = encoders.state()
        assert state.bad["wrong checksum"] > 0
        assert state.bad["not later than the one before"] > 0
        assert state.lost > 0
        assert "wrong checksum" in state.sentence
        assert "lost on the way" in state.sentence


@pytest.mark.realtime
def test_a_board_that_was_reset_begins_a_segment() -> None:
    with running(
        LabencEngine(Ramp(), 6, QUICK), faults=EmulatorFaults(reset=(1.0, 1.0))
    ) as emulated:
        readings = gather(driver(emulated.address), for_seconds(2.0))
        require_true(readings, emulated)
        assert {reading.segment for reading in readings} == {0, 1}


@pytest.mark.realtime
@pytest.mark.parametrize("leap", [30.0, -0.4])
def test_a_clock_jump_begins_a_segment(leap: float) -> None:
    with running(
        LabencEngine(Ramp(), 6, QUICK), faults=EmulatorFaults(jump=(1.0, leap))
    ) as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, for_seconds(2.0))
        require_true(readings, emulated)
        assert {reading.segment for reading in readings} == {0, 1}
        assert sum(encoders.state().bad.values()) > 0


@pytest.mark.realtime
def test_silence_and_a_port_that_vanishes(tmp_path: Path) -> None:
    faults = EmulatorFaults(silence=(0.5, 2.4), unplug=(3.4, 0.5))
    where = f"pty:{tmp_path / 'board'}"
    with running(LabencEngine(Ramp(), 6, QUICK), where, faults) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda _: "silent for" in encoders.state().sentence)
        gather(encoders, lambda _: ": reading" in encoders.state().sentence)
        gather(encoders, lambda _: "not connected" in encoders.state().sentence)
        again = gather(encoders, lambda found: len(found) >= 10)
        require_true(again, emulated)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("bits", "message"), [(1, "not homed"), (2, "encoder fault"), (4, "held or interpolated")]
)
def test_samples_that_the_board_itself_doubts_are_not_used(bits: int, message: str) -> None:
    faults = EmulatorFaults(status=(0.0, float(bits)))
    with running(LabencEngine(Ramp(), 6, QUICK), faults=faults) as emulated:
        encoders = driver(emulated.address)
        assert gather(encoders, lambda _: encoders.state().bad.get(message, 0) > 20) == []
        assert message in encoders.state().sentence


@pytest.mark.realtime
def test_a_board_that_greets_late_or_never() -> None:
    late = LabencOptions(greeting_after=2.3)
    with running(LabencEngine(Ramp(), 6, late)) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda found: len(found) >= 5)
    with running(Mute(Ramp(), 6, LabencOptions(greeting_after=None))) as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, lambda _: "no LABENC greeting" in encoders.state().sentence)
        assert readings == []
        assert encoders.state().bad["sample before the greeting"] > 0


class Mute(LabencEngine):
    def _answer(self, line: bytes, t: float) -> list[str]:
        super()._answer(line, t)
        return []


@pytest.mark.realtime
def test_a_board_of_another_robot_or_version_is_refused() -> None:
    with running(LabencEngine(Ramp(5), 5, QUICK)) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda _: "5 axes, 6 are expected" in encoders.state().sentence)
        assert encoders.read() == []

    class Newer(LabencEngine):
        def _hello(self) -> str:
            return super()._hello().replace("1.0", "2.0")

    with running(Newer(Ramp(), 6, QUICK)) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda _: "speaks LABENC 2" in encoders.state().sentence)
        assert encoders.read() == []


@pytest.mark.realtime
def test_a_newer_minor_version_may_add_fields_and_types() -> None:
    class Newer(LabencEngine):
        def _hello(self) -> str:
            return super()._hello().replace("1.0", "1.3") + ",more"

        def _sample(self, t: float) -> str:
            return super()._sample(t) + ",17,x"

    with running(Newer(Ramp(), 6, QUICK)) as emulated:
        readings = gather(driver(emulated.address), lambda found: len(found) >= 10)
        require_true(readings, emulated)


@pytest.mark.realtime
def test_a_rate_that_the_line_cannot_carry_is_refused_by_the_board() -> None:
    with running(LabencEngine(Ramp(), 6, QUICK)) as emulated:
        encoders = driver(emulated.address, rate=500)
        gather(encoders, lambda _: "R,2,bad rate" in encoders.state().sentence)


@pytest.mark.realtime
def test_arrival_times_after_a_pause_have_larger_uncertainty() -> None:
    with running(LabencEngine(Ramp(), 6, QUICK)) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda found: len(found) >= 10)
        time.sleep(0.7)
        readings = gather(encoders, lambda found: len(found) >= 80)
        require_true(readings, emulated)
        assert encoders.state().lost == 0
