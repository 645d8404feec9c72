"""ROS 2 joint states through rosbridge: JSON by hand from a server of another library (aiohttp)."""

import json
import math
import socket
import time
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
from tests.support.devices.bridge_server import PERIOD, bridge
from verify.devices.encoders.rosbridge import RosbridgeEncoders, RosbridgeSettings
from verify.devices.ports import Chunk, PortLink
from verify.simulation.emulators.rosbridge import (
    RosbridgeEngine,
    RosbridgeOptions,
    WebSocketEndpoint,
)
from verify.simulation.emulators.server import EmulatorFaults

NAMES = ("pan", "lift", "elbow", "w1", "w2", "w3")
SHUFFLED = ("elbow", "lift", "finger", "pan", "w3", "w1", "w2")
EPOCH = 1_764_000_000  # s


def driver(url: str, **settings: Any) -> RosbridgeEncoders:
    return kept(RosbridgeEncoders(RosbridgeSettings(url, NAMES, **settings), same_angles(6)))


def joint_state(number: int, **changed: Any) -> dict[str, Any]:
    """A message as rosbridge writes it, PERIOD after the one before."""
    t = number * PERIOD
    angles = {**dict(zip(NAMES, Ramp()(t).tolist(), strict=True)), "finger": 0.02}
    nanoseconds = number * round(PERIOD * 1e9)
    stamp = {"sec": EPOCH + nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
    return {
        "header": {"stamp": stamp, "frame_id": ""},
        "name": list(SHUFFLED),
        "position": [angles[name] for name in SHUFFLED],
        "velocity": [],
        "effort": [None] * 7,
    } | changed


def published(body: Any) -> str:
    return json.dumps({"op": "publish", "topic": "/joint_states", "msg": body})


def test_angles_are_taken_by_name_at_the_stamp_of_the_header() -> None:
    with bridge(lambda number: published(joint_state(number))) as server:
        encoders = driver(server.url)
        readings = gather(encoders, lambda found: len(found) >= 60)
        state = encoders.state()
        require_one_clock(readings, 1e-6)
        np.testing.assert_allclose(np.diff([r.t for r in readings]), PERIOD, atol=1e-6)
        assert {reading.half_width for reading in readings} == {0.005}
        assert (state.sentence, state.bad) == (f"{server.url}: reading", {})
        encoders.close()
        time.sleep(0.1)
        asked = [json.loads(text) for text in server.heard]
    assert asked == [
        {
            "op": "subscribe",
            "id": "verify",
            "topic": "/joint_states",
            "type": "sensor_msgs/msg/JointState",
        },
        {"op": "unsubscribe", "id": "verify", "topic": "/joint_states"},
    ]
    with pytest.raises(ValueError, match="may send"):
        encoders._ask("publish")


def without(name: str, number: int) -> dict[str, Any]:
    body = joint_state(number)
    place = SHUFFLED.index(name)
    return body | {
        key: [v for i, v in enumerate(body[key]) if i != place] for key in ("name", "position")
    }


def with_angle(value: Any, number: int) -> dict[str, Any]:
    body = joint_state(number)
    body["position"][2 + 1] = value
    return body


WRONG: dict[str, Any] = {
    "message that is no JSON": lambda _: '{"op": "publish", "topic": ',
    "message that is not understood": lambda _: "[1, 2]",
    "message that is no JointState": lambda _: published({"data": "hello"}),
    "message with other than one position a joint": lambda n: published(
        joint_state(n, position=[0.0])
    ),
    "message that names a joint twice": lambda n: published(
        joint_state(n, name=["pan", *SHUFFLED[1:]])
    ),
    "message without a joint": lambda n: published(without("w2", n)),
    "message with impossible angles": lambda n: published(
        with_angle((None, float("nan"), float("inf"), 1e9, "x")[n // 4 % 5], n)
    ),
    "message without a time stamp": lambda n: published(
        joint_state(n, header={"stamp": {"sec": 0, "nanosec": 0}})
    ),
    "not later than the previous one": lambda n: published(
        joint_state(n) | {"header": joint_state(n - 3)["header"]}
    ),
}


@pytest.mark.realtime
@pytest.mark.parametrize("reason", WRONG)
def test_one_wrong_message_in_four_is_dropped_counted_and_leads_to_no_false_reading(
    reason: str,
) -> None:
    def say(number: int) -> str:
        return str(WRONG[reason](number)) if number % 4 == 3 else published(joint_state(number))

    with bridge(say) as server:
        encoders = driver(server.url)
        require_one_clock(gather(encoders, lambda found: len(found) >= 60), 1e-6)
        assert encoders.state().bad.keys() == {reason}
        assert encoders.state().bad[reason] >= 15
        assert reason in encoders.state().sentence


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("say", "words"),
    [
        (
            lambda n: published(without("w2", n)),
            "the messages name elbow, lift, finger, pan, w3, w1; no joint is called w2",
        ),
        (
            lambda _: published(joint_state(0, name=["finger"], position=[0.0])),
            "the messages name finger; no joint is called pan, lift",
        ),
        (
            lambda n: published(joint_state(n, header={"stamp": {"sec": 0, "nanosec": 0}})),
            'the messages have no time stamp; write stamp = "arrival"',
        ),
        (
            lambda _: '{"op": "status", "level": "error", "msg": "no such topic"}',
            "no reading yet; the bridge says: no such topic",
        ),
        (lambda _: b"\xff\xfe\x00", "message that is no JSON"),
        (lambda _: "[" * 5000, "message that is no JSON"),
    ],
)
def test_a_topic_that_cannot_be_used_is_said_in_one_line(say: Any, words: str) -> None:
    with bridge(say) as server:
        encoders = driver(server.url)
        assert gather(encoders, lambda _: words in encoders.state().sentence) == []
        assert "\n" not in encoders.state().sentence


@pytest.mark.realtime
def test_without_stamps_the_time_of_arrival_is_taken_and_covers_the_true_one() -> None:
    def say(number: int) -> str:
        return published(joint_state(number, header={"stamp": {"sec": 0, "nanosec": 0}}))

    with bridge(say) as server:
        encoders = driver(server.url, arrival=True, latency=0.05)
        readings = gather(encoders, lambda found: len(found) >= 20)
        time.sleep(0.3)  # what waited meanwhile came at any time within
        readings += gather(encoders, lambda found: len(found) >= 20)
        for reading in readings:
            sent = server.start + Ramp().time(reading.q)  # the server's period is never shorter
            assert reading.t + reading.half_width >= sent
        assert max(reading.half_width for reading in readings) > 0.15
        assert encoders.state().bad["overtaken by the next one"] > 20


@pytest.mark.realtime
def test_what_listens_there_but_is_no_websocket_is_named() -> None:
    with bridge(lambda _: "") as server:
        encoders = driver(f"{server.url}/elsewhere")
        gather(encoders, lambda _: "is no websocket: server rej" in encoders.state().sentence)
    gather(encoders, lambda _: "nothing listens there" in encoders.state().sentence)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        encoders = driver(f"ws://127.0.0.1:{mute.getsockname()[1]}")
        assert encoders.read() == []  # waits as long as it may while it connects
        assert "no answer; check address" in encoders.state().sentence


def emulated(faults: EmulatorFaults | None = None, **options: Any) -> Any:
    engine = RosbridgeEngine(Ramp(), RosbridgeOptions(NAMES, **options))
    return running(engine, WebSocketEndpoint("127.0.0.1", 0), faults)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("fault", "segments"),
    [
        ({"jump": (0.5, 30.0)}, {0, 1}),
        ({"jump": (0.5, -0.4)}, {0, 1}),
        ({"unplug": (0.5, 0.3)}, {0, 1}),
        ({"silence": (0.3, 0.3)}, {0}),
        ({"lost": 0.1, "double": 0.1, "half": 0.1, "noise": 0.1}, {0}),
    ],
    ids=str,
)
def test_lost_connections_and_leaping_stamps_begin_a_segment(
    fault: dict[str, Any], segments: set[int]
) -> None:
    with emulated(EmulatorFaults(**fault)) as server:
        encoders = driver(server.address)
        readings = gather(encoders, lambda found: len({r.segment for r in found}) == len(segments))
        readings += gather(encoders, lambda found: len(found) >= 100)
        assert {reading.segment for reading in readings} == segments
        require_one_clock(readings, 1e-5)


@pytest.mark.realtime
def test_a_bridge_that_is_silent_is_named_and_its_topic_waited_for() -> None:
    with emulated(EmulatorFaults(silence=(0.5, 2.6))) as server:
        encoders = driver(server.address)
        gather(encoders, lambda _: "silent for" in encoders.state().sentence)
        gather(encoders, lambda found: len(found) >= 10)
    assert isinstance(encoders.link, PortLink)
    gather(encoders, for_seconds(0.1))


@pytest.mark.parametrize(
    "changed",
    [
        {"header": {"stamp": {"sec": math.inf, "nanosec": 0}}},
        {"header": {"stamp": {"sec": 10**400, "nanosec": 0}}},
        {"position": [10**400] * 7},
        {"position": [[]] * 7},
        {"name": {"one": 1}, "position": [1.0]},
    ],
)
def test_hostile_values_are_no_reading_and_no_crash(changed: dict[str, Any]) -> None:
    encoders = driver("ws://127.0.0.1:1")
    now = time.monotonic()
    assert encoders._take(Chunk(published(joint_state(1, **changed)).encode(), now, now)) == []
