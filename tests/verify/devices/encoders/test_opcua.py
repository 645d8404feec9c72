"""OPC UA: the driver against a server of asyncua, and the time of a poll by hand."""

import json
import math
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.support.devices.bench import Ramp, gather, kept, require_one_clock, same_angles
from tests.support.devices.bridge_server import bridge
from verify.devices.encoders.opcua import OpcUaEncoders, OpcUaSettings, _poll
from verify.devices.ports import Chunk
from verify.errors import InputError
from verify.simulation.emulators.server import EmulatorFaults

pytest.importorskip("asyncua")
from verify.simulation.emulators.opcua import OpcUaEmulator

SIX = tuple(f"ns=2;s=Axis{joint}.Position" for joint in range(1, 7))


def driver(url: str, nodes: tuple[str, ...] = SIX, **settings: Any) -> OpcUaEncoders:
    return kept(OpcUaEncoders(OpcUaSettings(url, nodes, **settings), same_angles(6)))


@pytest.fixture(scope="module")
def started() -> Iterator[OpcUaEmulator]:
    server = OpcUaEmulator("127.0.0.1", 0, Ramp(), 6)
    stop = threading.Event()
    thread = threading.Thread(target=server.serve, args=(stop.is_set,))
    thread.start()
    yield server
    stop.set()
    thread.join()
    server.close()


@pytest.fixture
def server(started: OpcUaEmulator) -> OpcUaEmulator:
    """The one server of this file, without faults; its time began before the test."""
    started.faults, started.trajectory = EmulatorFaults(), Ramp()
    return started


@pytest.mark.realtime
def test_nodes_are_read_at_the_time_stamps_of_their_source(server: OpcUaEmulator) -> None:
    encoders = driver(server.address)
    readings = gather(encoders, lambda found: len(found) >= 60)
    state = encoders.state()
    # a poll may fall between two writes: then its half-width says so
    require_one_clock(readings, 0.03)
    t = np.array([r.t - Ramp().time(r.q) for r in readings])
    half = np.array([r.half_width for r in readings])
    assert np.all(np.abs(t - np.median(t)) <= half + 2e-3)
    assert (state.connected, state.bad) == (True, {})


@pytest.mark.realtime
def test_an_array_node_in_radians_holds_all_axes(server: OpcUaEmulator) -> None:
    encoders = driver(server.address, ("ns=2;s=Axes.Position",), radians_per_unit=1.0)
    readings = gather(encoders, lambda found: len(found) >= 30)
    require_one_clock(readings, 5e-3)
    assert {reading.half_width for reading in readings} == {0.005}


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("nodes", "faults", "words"),
    [
        ((*SIX[:5], "ns=2;s=Axis7.Position"), {}, "node ns=2;s=Axis7.Position is BadNodeIdUnknown"),
        (SIX, {"status": (0.0, 1.0)}, "node ns=2;s=Axis1.Position is BadNotReadable"),
        (SIX[:1], {}, "the nodes hold 1 numbers, 6 are expected"),
        (
            (*SIX[:5], "i=2254"),
            {},
            "node i=2254 holds no number",
        ),  # the server's own array of texts
    ],
)
def test_nodes_that_cannot_be_used_are_named(
    server: OpcUaEmulator, nodes: tuple[str, ...], faults: dict[str, Any], words: str
) -> None:
    server.faults = EmulatorFaults(**faults)
    encoders = driver(server.address, nodes)
    readings = gather(encoders, lambda _: words in encoders.state().sentence)
    assert len(readings) < 3  # before the next write
    assert "\n" not in encoders.state().sentence


@pytest.mark.realtime
def test_a_leaping_clock_and_a_lost_server_begin_a_segment(server: OpcUaEmulator) -> None:
    encoders = driver(server.address)
    readings = gather(encoders, lambda found: len(found) >= 20)
    server.faults = EmulatorFaults(jump=(0.0, 30.0))
    readings += gather(encoders, lambda found: len(found) >= 20)
    server.faults = EmulatorFaults(jump=(0.0, 30.0), unplug=(0.0, 1e9))
    gather(encoders, lambda _: not encoders.state().connected)
    server.faults = EmulatorFaults(jump=(0.0, 30.0))
    end = time.monotonic() + 20.0
    while readings[-1].segment < 2 and time.monotonic() < end:
        readings += encoders.read()  # no limit of time: it waits while it connects
    readings += gather(encoders, lambda found: len(found) >= 20)
    assert {reading.segment for reading in readings} == {0, 1, 2}
    require_one_clock(readings, 0.03)


@pytest.mark.realtime
def test_an_arm_at_rest_is_read_on(server: OpcUaEmulator) -> None:
    home = Ramp()(0.0)
    server.trajectory = lambda _: home
    time.sleep(0.2)
    encoders = driver(server.address, rate=100.0)
    readings = gather(encoders, lambda found: len(found) >= 60)
    assert np.all(np.diff([reading.t for reading in readings]) > 0)
    assert len({reading.segment for reading in readings}) == 1


@pytest.mark.realtime
def test_what_listens_there_but_is_no_opc_ua_is_named() -> None:
    with bridge(lambda _: "") as other:
        encoders = driver(other.url.replace("ws:", "opc.tcp:"))
        for _ in range(3):
            assert encoders.read() == []
        assert encoders.state().sentence.startswith(f"opc.tcp://127.0.0.1:{other.port}: not con")
    encoders = driver(f"opc.tcp://user:secret@127.0.0.1:{other.port}")
    assert encoders.read() == []
    assert "nothing listens there" in encoders.state().sentence
    assert "secret" not in encoders.state().sentence


class Polls:
    """A driver that is fed with polls: six axes, in degrees, at stamps of their own."""

    def __init__(self, **settings: Any) -> None:
        chosen = OpcUaSettings("opc.tcp://nowhere:1", SIX, **settings)
        self.encoders = kept(OpcUaEncoders(chosen, same_angles(6)))
        self._chunk: Chunk | None = None
        self.encoders.link.receive = lambda _=0.0: self._chunk  # type: ignore[method-assign]

    def __call__(
        self, t: float, degrees: list[float], stamps: list[float | None]
    ) -> tuple[float, float] | None:
        """A poll sent at t and answered 2 ms later: the reading's time and half-width, or None."""
        poll = {"sent": t, "values": degrees, "stamps": stamps, "server_stamp": None, "fault": ""}
        self._chunk = Chunk(json.dumps(poll).encode(), t + 0.002, t)
        found = self.encoders.read()
        return (found[0].t, found[0].half_width) if found else None


def test_axes_that_moved_give_the_time_and_its_half_width() -> None:
    polls = Polls(cycle=0.004)
    assert polls(100.0, [0.0] * 6, [1000.0] * 6) == (0.0, 0.002)
    # one controller cycle for all; axis 6 rests, and its stamp is an old one
    assert polls(100.1, [1.0] * 5 + [0.0], [1000.1] * 5 + [1000.0]) == pytest.approx((0.1, 0.002))
    # the answer mixes two cycles: known within half their distance and half a cycle
    t, half = polls(100.2, [2.0] * 5 + [0.0], [1000.204] * 2 + [1000.2] * 3 + [1000.0])
    assert (t, half) == pytest.approx((0.202, 0.004))


def test_at_rest_the_time_runs_on_and_is_never_ahead_of_the_source() -> None:
    polls = Polls()
    polls(100.0, [0.0] * 6, [1000.0] * 6)
    polls(100.1, [1.0] * 6, [1000.1 - 0.03] * 6)  # 30 ms old
    polls(100.2, [2.0] * 6, [1000.199] * 6)  # 1 ms old
    for number in range(3, 50):
        found = polls(100.0 + number / 10, [2.0] * 6, [1000.199] * 6)
        assert found is not None
        assert found[0] <= number / 10
        assert found[0] > number / 10 - 0.02
    moved = polls(105.0, [3.0] * 6, [1004.999] * 6)
    assert moved == pytest.approx((4.999, 0.005))


def test_polls_that_cannot_be_timed_are_dropped_and_counted() -> None:
    polls = Polls()
    polls(100.0, [0.0] * 6, [1000.0] * 6)
    assert polls(100.1, [1.0] * 6, [1000.0] * 6) is None
    assert polls(100.2, [2.0] * 6, [1000.2] * 5 + [1000.05]) is None
    assert polls(100.3, [1e4] + [0.0] * 5, [1000.3] * 6) is None
    assert polls(100.4, [math.nan] + [0.0] * 5, [1000.4] * 6) is None
    assert dict(polls.encoders.state().bad) == {
        "angles that change without their time stamps": 1,
        "axes of different instants": 1,
        "poll with impossible angles": 2,
    }
    unstamped = Polls()
    assert unstamped(100.0, [0.0] * 6, [None] * 6) is None
    unstamped.encoders.link._port = object()  # type: ignore[assignment]
    assert 'write stamp = "arrival"' in unstamped.encoders._fault
    unstamped.encoders.link._port = None
    arrival = Polls(arrival=True, latency=0.05)
    assert arrival(100.0, [0.0] * 6, [None] * 6) == pytest.approx((99.976, 0.026))


@pytest.mark.parametrize("node", ["", "axis 1", "ns=x;i=1", "ns=2"])
def test_a_node_id_that_is_none_is_refused(node: str) -> None:
    with pytest.raises(InputError, match="a node id is expected"):
        OpcUaSettings("opc.tcp://nowhere:1", (node,))


def test_an_answer_of_fewer_values_than_nodes_is_a_fault() -> None:
    assert _poll(0.0, SIX, []).fault == "0 values came for 6 nodes"
