"""Universal Robots by RTDE: the driver, and the emulator against the client of ur-rtde."""

import json
import struct
import subprocess
import sys
from importlib import util
from typing import Any

import numpy as np
import pytest

from tests.support.devices.bench import (
    Ramp,
    for_seconds,
    gather,
    kept,
    require_one_clock,
    running,
    same_angles,
)
from verify.devices.encoders import rtde
from verify.devices.encoders.rtde import PackageBuffer, RtdeEncoders, RtdeSettings
from verify.simulation.emulators.rtde import RtdeEngine, RtdeOptions
from verify.simulation.emulators.server import EmulatorFaults, TimedMessage

UR_HOST = "127.0.41.7"  # its client knows no port but 30004
UR_CLIENT = f"""
import json, time, rtde_receive
client = rtde_receive.RTDEReceiveInterface("{UR_HOST}", 500.0, ["timestamp", "actual_q"])
for _ in range(5):
    time.sleep(0.1)
    print(json.dumps([client.getTimestamp(), client.getActualQ()]), flush=True)
client.disconnect()
"""


def driver(address: str, rate: float | None = None) -> RtdeEncoders:
    return kept(RtdeEncoders(RtdeSettings(address, rate), same_angles(6)))


def test_requests_are_those_of_the_guide_and_no_other_can_be_sent() -> None:
    engine = RtdeEngine(Ramp())
    with running(engine) as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, lambda found: len(found) >= 100)
        state = encoders.state()
        require_one_clock(readings, 1e-9)
        np.testing.assert_allclose(np.diff([r.t for r in readings]), 0.002, atol=1e-9)
        assert {reading.half_width for reading in readings} == {0.001}
        assert (state.sentence, state.program_running) == (f"{emulated.address}: reading", True)
    assert engine.log == ["V", "v", "O", "S"]
    with pytest.raises(ValueError, match="may send"):
        encoders._ask(rtde.PackageType.DATA)


@pytest.mark.realtime
@pytest.mark.skipif(util.find_spec("rtde_receive") is None, reason="ur-rtde is not installed")
def test_the_client_of_ur_rtde_reads_the_emulator_as_the_driver_does() -> None:
    engine = RtdeEngine(Ramp())
    with running(engine, f"tcp:{UR_HOST}:30004") as emulated:
        words = [sys.executable, "-c", UR_CLIENT]
        done = subprocess.run(words, capture_output=True, text=True, timeout=30, check=True)
        theirs = [json.loads(line) for line in done.stdout.splitlines()]
        ours = gather(driver(emulated.address), lambda found: len(found) >= 5)
    zero = [t - Ramp().time(np.array(q)) for t, q in theirs]
    zero += [reading.t - Ramp().time(reading.q) for reading in ours]
    assert np.ptp(zero) < 1e-9
    assert [t for t, _ in theirs] == sorted(t for t, _ in theirs)
    assert engine.log[:4] == ["V", "v", "O", "S"]


@pytest.mark.realtime
def test_an_older_series_is_read_once_a_cycle_of_its_own() -> None:
    with running(RtdeEngine(Ramp(), RtdeOptions(version=(3, 15, 8, 0)))) as emulated:
        readings = gather(driver(emulated.address, 500.0), lambda found: len(found) >= 20)
        np.testing.assert_allclose(np.diff([r.t for r in readings]), 0.008, atol=1e-9)
        assert readings[0].half_width == 0.004
    with running(RtdeEngine(Ramp())) as emulated:
        readings = gather(driver(emulated.address, 50.0), lambda found: len(found) >= 20)
        np.testing.assert_allclose(np.diff([r.t for r in readings]), 0.02, atol=1e-9)


class Garbage(RtdeEngine):
    """Another server on that port: the real-time interface greets with a size of four bytes."""

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        return [TimedMessage(t, struct.pack(">I", 1108) + bytes(1104))] if received else []


class Mute(RtdeEngine):
    """Takes requests and answers none."""

    def step(self, t: float, received: bytes) -> list[TimedMessage]:  # noqa: ARG002
        return []


class Poor(RtdeEngine):
    """Has no joints to tell of."""

    def _set_up(self, payload: bytes) -> bytes:
        return super()._set_up(payload.replace(b"actual_q", b"actual_p"))


class Strange(RtdeEngine):
    """Sends samples of a recipe that nobody asked for, and sends on."""

    def _sample(self, t: float) -> bytes:
        sample = bytearray(super()._sample(t))
        sample[3] += 1
        return bytes(sample)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("engine", "words"),
    [
        (RtdeEngine(Ramp(), RtdeOptions(protocol=1)), "refuses RTDE version 2; a newer PolyScope"),
        (RtdeEngine(Ramp(), RtdeOptions(starts=False)), "refuses to start the stream"),
        (Poor(Ramp()), "the controller has no output actual_q"),
        (Garbage(Ramp()), "what answers there is no RTDE, whose port is 30004"),
        (Mute(Ramp()), "no answer to the request version"),
        (Strange(Ramp()), "not connected: no sample for 2."),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_controller_that_cannot_be_read_gives_no_reading_and_one_line(
    engine: RtdeEngine, words: str
) -> None:
    with running(engine) as emulated:
        encoders = driver(emulated.address)
        assert gather(encoders, lambda _: words in encoders.state().sentence) == []
        assert gather(encoders, for_seconds(0.5)) == []
        assert "\n" not in encoders.state().sentence


class Faulty(RtdeEngine):
    """Now and then a sample whose angles or stamp no arm can have."""

    def _sample(self, t: float) -> bytes:
        number = round(t * 500)
        sample = bytearray(super()._sample(t))
        if number % 10 == 3:
            struct.pack_into(">d", sample, 4 + 8, float("nan"))
        if number % 10 == 6:
            struct.pack_into(">d", sample, 4 + 8, 1e3)
        if number % 10 == 8:
            struct.pack_into(">d", sample, 4, float("inf"))
        return bytes(sample)


@pytest.mark.realtime
def test_numbers_that_cannot_be_are_dropped_and_counted() -> None:
    with running(Faulty(Ramp())) as emulated:
        encoders = driver(emulated.address)
        require_one_clock(gather(encoders, lambda found: len(found) >= 200), 1e-9)
        assert encoders.state().bad["sample with impossible numbers"] > 50


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("fault", "segments"),
    [
        ({"jump": (0.3, 30.0)}, {0, 1}),
        ({"jump": (0.3, -0.2)}, {0, 1}),
        ({"reset": (0.3, 0.3)}, {0, 1}),
        ({"unplug": (0.3, 0.3)}, {0, 1}),
        ({"silence": (0.3, 2.6)}, {0, 1}),  # it is connected anew: nobody closed the old one
        ({"lost": 0.1, "double": 0.1, "split": 0.02}, {0}),
    ],
    ids=str,
)
def test_lost_connections_and_leaping_clocks_begin_a_segment(
    fault: dict[str, Any], segments: set[int]
) -> None:
    with running(RtdeEngine(Ramp()), faults=EmulatorFaults(**fault)) as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, lambda found: len({r.segment for r in found}) == len(segments))
        readings += gather(encoders, lambda found: len(found) >= 100)
        assert {reading.segment for reading in readings} == segments
        require_one_clock(readings, 1e-9)


@pytest.mark.realtime
def test_a_protective_stop_is_told_and_ends_the_program() -> None:
    with running(RtdeEngine(Ramp()), faults=EmulatorFaults(alarm=(0.3, 153.0))) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda _: "C153A0: protective stop" in encoders.state().sentence)
        gather(encoders, lambda _: encoders.state().program_running is False)


def test_packages_are_cut_anywhere_and_garbage_is_noticed() -> None:
    stream = struct.pack(">HB", 4, ord("V")) + b"\x01" + struct.pack(">HB", 3, ord("S"))
    buffer, found = PackageBuffer(), []
    for byte in stream:
        found += buffer.feed(bytes([byte]))
    assert found == [(rtde.PackageType.VERSION, b"\x01"), (rtde.PackageType.START, b"")]
    for wrong in (b"HTTP/1.1 400", b"\x00\x02V", b"\xff\xffU"):
        assert PackageBuffer().feed(wrong) is None


@pytest.mark.parametrize("payload", [b"", b"\x05ab", b"\x02ab\x03cde\x01", b"\xff" * 9])
def test_a_text_message_of_any_kind_is_one_text(payload: bytes) -> None:
    assert isinstance(rtde.parse_text(payload), str)
    assert rtde.parse_text(b"\x02ab\x03cde\x01") == "cde: ab"
