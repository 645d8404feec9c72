import struct
import time

import numpy as np
import pytest

from tests.support.devices.bench import Ramp, for_seconds, gather, kept, running, same_angles
from verify.devices.melfa import realtime as packets
from verify.devices.melfa.realtime import RealtimeEncoders, RealtimeSettings
from verify.simulation.emulators.melfa import RealtimeEngine
from verify.simulation.emulators.server import EmulatorFaults


def answer(kind: int = 8, place: int = 4, joint: bytes = bytes.fromhex("920A063F")) -> bytes:
    """A packet by the offsets of the fact sheet; J2 holds `joint`, 30° unless stated."""
    data = bytearray(196)
    struct.pack_into("<H", data, place, kind)
    data[place + 4 + 4 : place + 4 + 8] = joint
    struct.pack_into("<H", data, 58, 3)
    struct.pack_into("<I", data, 60, 70000)
    return bytes(data)


def driver(address: str) -> RealtimeEncoders:
    return kept(RealtimeEncoders(RealtimeSettings(address), same_angles(6)))


def test_the_two_packets_that_a_reader_sends() -> None:
    assert bytes.fromhex("0000000008000000") + bytes(188) == packets.READ_REQUEST
    assert b"\xff" + bytes(195) == packets.END_REQUEST


def test_a_packet_of_the_sheet_is_read_wherever_the_joints_stand() -> None:
    for place in (4, 64, 108, 152):
        packet = packets.parse_packet(answer(place=place), 6)
        assert (packet.cycle, packet.missed) == (70000, 3)
        np.testing.assert_allclose(packet.joints, np.deg2rad([0, 30, 0, 0, 0, 0]), atol=1e-7)


def test_what_is_not_encoder_joints_is_no_reading() -> None:
    assert packets.parse_packet(answer(kind=2), 6) == "packet without encoder joints"
    assert packets.parse_packet(answer()[:-1], 6) == "packet of another size"
    for joint in (b"\0\0\xc0\x7f", b"\0\0\x80\x7f", b"\0\0\x80\x44"):  # NaN, infinity, 1024
        assert packets.parse_packet(answer(joint=joint), 6) == "packet with impossible angles"


def test_the_stream_is_read_on_the_cycle_counters_clock() -> None:
    engine = RealtimeEngine(Ramp(), 6)
    with running(engine, "udp:0") as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, lambda found: len(found) >= 100)
        encoders.close()
        t = np.array([reading.t for reading in readings])
        steps = np.diff(t) / (64 / 9 * 1e-3)
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
        for reading in readings:
            Ramp().time(reading.q)
        time.sleep(0.05)
    commands = {struct.unpack("<HH", head[:4]) for head in engine.log}
    assert commands == {(0, 0), (255, 0)}  # never 1, and never a data type for a command


@pytest.mark.realtime
def test_faults_of_the_stream_are_counted_and_give_no_false_time() -> None:
    faults = EmulatorFaults(noise=0.05, half=0.05, double=0.1, lost=0.1, jump=(1.5, 40.0))
    with running(RealtimeEngine(Ramp(), 6), "udp:0", faults) as emulated:
        encoders = driver(emulated.address)
        readings = gather(encoders, for_seconds(3.0))
        assert {reading.segment for reading in readings} == {0, 1}
        for segment in (0, 1):
            mine = [reading for reading in readings if reading.segment == segment]
            offsets = [reading.t - Ramp().time(reading.q) for reading in mine]
            assert np.ptp(offsets) < 0.2  # the emulator samples when its machine lets it
        bad = encoders.state().bad
        assert bad["packet of another size"] > 0
        assert encoders.state().lost > 0


@pytest.mark.realtime
def test_a_missing_controller_is_reported_and_used_once_it_answers() -> None:
    faults = EmulatorFaults(unplug=(0.5, 0.7))
    with running(RealtimeEngine(Ramp(), 6), "udp:0", faults) as emulated:
        encoders = driver(emulated.address)
        gather(encoders, lambda found: len(found) >= 5)
        gather(encoders, lambda _: not encoders.state().connected)
        assert "nothing listens there" in encoders.state().sentence
        gather(encoders, lambda found: len(found) >= 5)
