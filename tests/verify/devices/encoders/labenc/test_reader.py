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
def test_raw_counts_are_requested_and_scaled() -> None:
    with running(LabencEngine(Ramp(), 6, QUICK)) as emulated:
        encoders = driver(emulated.address, unit="counts", rate=50)
        readings = gather(encoders, lambda found: len(found) >= 60)
        for reading in readings:
            Ramp().time(reading.q)
        np.testing.assert_allclose(np.diff([r.t for r in readings[-20:]]), 0.02, atol=2e-5)


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
        assert state.bad["not later than the previous one"] > 0
        assert state.lost > 0
        assert "wrong checksum" in state.sentence
        assert "lost on the way" in state.sentence


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
def test_arrival_times_after_a_pause_have_larger_uncertainty() -> None:
    with running(LabencEngine(Ramp(), 6, QUICK)) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda found: len(found) >= 10)
        time.sleep(0.7)
        readings = gather(encoders, lambda found: len(found) >= 80)
        require_true(readings, emulated)
        assert encoders.state().lost == 0


@pytest.mark.realtime
@pytest.mark.parametrize(
    "fault", [{"reset": (1.0, 1.0)}, {"jump": (1.0, 30.0)}, {"jump": (1.0, -0.4)}], ids=str
)
def test_a_board_that_was_reset_or_whose_clock_jumps_begins_a_segment(fault: Any) -> None:
    with running(LabencEngine(Ramp(), 6, QUICK), faults=EmulatorFaults(**fault)) as emulated:
        readings = gather(driver(emulated.address), for_seconds(2.0))
        require_true(readings, emulated)
        assert {reading.segment for reading in readings} == {0, 1}


class Newer(LabencEngine):
    """Of a later minor version: more fields."""

    def _hello(self) -> str:
        return super()._hello().replace("1.0", "1.3") + ",more"

    def _sample(self, t: float) -> str:
        return super()._sample(t) + ",17,x"


class Unknown(LabencEngine):
    """Of a later major version."""

    def _hello(self) -> str:
        return super()._hello().replace("1.0", "2.0")


class Mute(LabencEngine):
    """Streams and answers nothing."""

    def _answer(self, line: bytes, t: float) -> list[str]:
        super()._answer(line, t)
        return []


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (LabencEngine, {"first_tick": 2**32 - 500_000}),  # the counter wraps in mid run
        (LabencEngine, {"checksum": "crc16", "carriage_return": True}),
        (LabencEngine, {"greeting_after": 2.3}),
        (Newer, {}),
    ],
)
def test_every_kind_of_board_gives_true_readings_of_one_segment(
    kind: type[LabencEngine], options: dict[str, Any]
) -> None:
    chosen = LabencOptions(**({"greeting_after": 0.05} | options))
    with running(kind(Ramp(), 6, chosen)) as emulated:
        encoders = driver(emulated.address, checksum=options.get("checksum", "xor"))
        readings = gather(encoders, lambda found: len(found) >= 100)
        require_true(readings, emulated)
        assert {reading.segment for reading in readings} == {0}
        assert options.get("greeting_after") or dict(encoders.state().bad) == {}


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("engine", "fault", "words"),
    [
        (LabencEngine(Ramp(), 6, QUICK), {"status": (0.0, 1.0)}, "not homed"),
        (LabencEngine(Ramp(), 6, QUICK), {"status": (0.0, 2.0)}, "encoder fault"),
        (LabencEngine(Ramp(), 6, QUICK), {"status": (0.0, 4.0)}, "held or interpolated"),
        (LabencEngine(Ramp(5), 5, QUICK), {}, "5 axes, 6 are expected"),
        (Unknown(Ramp(), 6, QUICK), {}, "speaks LABENC 2"),
        (Mute(Ramp(), 6, LabencOptions(greeting_after=None)), {}, "no LABENC greeting"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_board_that_is_not_fit_gives_no_reading_and_is_named(
    engine: LabencEngine, fault: dict[str, Any], words: str
) -> None:
    with running(engine, faults=EmulatorFaults(**fault)) as emulated:
        encoders = driver(emulated.address)
        assert gather(encoders, lambda _: words in encoders.state().sentence) == []
        assert gather(encoders, for_seconds(0.2)) == []


@pytest.mark.realtime
def test_a_rate_that_the_line_cannot_carry_is_refused_by_the_board() -> None:
    with running(LabencEngine(Ramp(), 6, QUICK)) as emulated:
        encoders = driver(emulated.address, rate=500)
        gather(encoders, lambda _: "R,2,bad rate" in encoders.state().sentence)
