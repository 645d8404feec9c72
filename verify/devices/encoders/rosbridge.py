"""Joint states of a ROS 2 system through rosbridge: JSON on a websocket, subscribed to, never sent.

A message names its joints in an order of its own: each angle is taken by its name. Its header
stamp is the controller's clock, counted from the first message on (a double holds an epoch to
0.2 µs only). A driver sends two operations, subscribe and unsubscribe; publish, calls of services
and goals of actions cannot be worded.

Source: rosbridge v2 protocol specification; sensor_msgs/msg/JointState.
"""

import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from verify.core.records import Array
from verify.devices import ports
from verify.devices.encoders import intake
from verify.devices.protocols import EncoderReading

TOPIC: Final = "/joint_states"
MESSAGE_TYPE: Final = "sensor_msgs/msg/JointState"
READ_OPERATIONS: Final = frozenset({"subscribe", "unsubscribe"})
ROS_CYCLE: Final = 0.01  # s: ros2_control updates 100 times a second unless it is told otherwise
PING_PERIOD: Final = 5.0  # s: a bridge that lost its power closes nothing, and answers no ping
MAX_MESSAGE_BYTES: Final = 1 << 20  # bytes
MAX_MESSAGES_PER_READ: Final = 256  # messages: a flood must not hold the caller
MAX_NAMES_LISTED: Final = 8
MAX_STAMP: Final = 1 << 32  # s: ROS counts in 32 bits


class WebSocketPort:
    """A websocket, as a port that gives one message at a time.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, url: str) -> None:
        self._stack = contextlib.ExitStack()
        try:
            self._socket = self._stack.enter_context(
                connect(
                    url,
                    open_timeout=ports.CONNECT_TIMEOUT,
                    close_timeout=ports.SEND_TIMEOUT,
                    ping_interval=PING_PERIOD,
                    ping_timeout=PING_PERIOD,
                    max_size=MAX_MESSAGE_BYTES,
                    compression=None,
                    proxy=None,
                )
            )
        except WebSocketException as error:
            raise OSError(f"what answers there is no websocket: {error}") from error
        self._message: bytes | None = None

    def wait(self, seconds: float) -> bool:
        """Wait for a message; OSError: the connection is closed."""
        if self._message is None:
            try:
                received = self._socket.recv(timeout=max(seconds, 0.0))
            except TimeoutError:
                return False
            except ConnectionClosed as error:
                raise ConnectionResetError(ports.CONNECTION_CLOSED) from error
            self._message = received.encode() if isinstance(received, str) else received
        return True

    def take(self) -> bytes:
        """Take the message that was waited for."""
        message, self._message = self._message or b"", None
        return message

    def send(self, data: bytes) -> None:
        """Send a message of text."""
        try:
            self._socket.send(data.decode())
        except ConnectionClosed as error:
            raise ConnectionResetError(ports.CONNECTION_CLOSED) from error

    def close(self) -> None:
        """Close the connection."""
        self._stack.close()


@dataclass(frozen=True, slots=True)
class JointStateMessage:
    """What a message says of the wanted joints."""

    stamp: tuple[int, int] | None  # s, ns; None where it is missing, or 0 as of who sets none
    position: Array  # (joints,), rad
    missing: tuple[str, ...] = ()  # joints that it does not name


def parse_joint_state(message: Any, names: Sequence[str]) -> JointStateMessage | str:
    """Take the wanted joints of a JointState by their names; the reason, where it is none."""
    try:
        found, position = list(message["name"]), list(message["position"])
        stamp = message["header"]["stamp"]
        seconds, nanoseconds = int(stamp["sec"]), int(stamp["nanosec"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return "message that is no JointState"
    if not (abs(seconds) < MAX_STAMP and 0 <= nanoseconds < 10**9):
        return "message with an impossible time stamp"
    if len(found) != len(position):
        return "message with other than one position a joint"
    if any(found.count(name) > 1 for name in names):
        return "message that names a joint twice"
    missing = tuple(name for name in names if name not in found)
    if missing:
        return JointStateMessage(None, np.zeros(0), missing)
    try:  # null is how most bridges write NaN
        angles = np.array([position[found.index(name)] for name in names], dtype=float)
    except (TypeError, ValueError, OverflowError):
        return "message with impossible angles"
    within = angles.ndim == 1 and np.all(np.abs(angles) <= intake.MAX_JOINT_ANGLE)
    if not within:  # nor what is no number
        return "message with impossible angles"
    return JointStateMessage((seconds, nanoseconds) if seconds or nanoseconds else None, angles)


@dataclass(frozen=True, slots=True)
class RosbridgeSettings:
    """How a topic is reached, and what its joints are called."""

    url: str  # ws://HOST:9090
    names: tuple[str, ...]  # of the robot file's joints, in its order
    topic: str = TOPIC
    cycle: float = ROS_CYCLE  # s, of who stamps: joints were read within half of it of the stamp
    arrival: bool = False  # take the time of arrival instead of the stamp
    latency: float = 0.1  # s, by which a message may come late; used only with `arrival`


class RosbridgeEncoders(intake.PortDriver):
    """Joint readings from a topic of JointState messages."""

    def __init__(self, settings: RosbridgeSettings, angles: intake.AngleMap) -> None:
        super().__init__(ports.PortLink(settings.url, lambda: WebSocketPort(settings.url)))
        self._settings = settings
        self._intake = intake.ReadingIntake(angles, self.counts)
        self._clock = intake.ControllerClock(None)
        self._epoch: int | None = None  # s, that is taken off every stamp

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        chunk = self.link.receive()
        if self.link.reopened():
            self._clock.restart(None)
            self._ask("subscribe", type=MESSAGE_TYPE)
        readings: list[EncoderReading] = []
        earliest = None if chunk is None else chunk.earliest
        for _ in range(MAX_MESSAGES_PER_READ):
            if chunk is None or earliest is None:
                break
            # one that waited behind another came after the last look, not after the other
            new = self._take(replace(chunk, earliest=earliest))
            if self._settings.arrival and new and readings:
                readings.pop()
                self.counts.bad["overtaken by the next one"] += 1
            readings += new
            chunk = self.link.receive(0.0)
        if readings:
            self.link.steady()
            self._fault = ""
        return readings

    def close(self) -> None:
        """End the subscription, and close the connection."""
        if self.link.connected:
            self._ask("unsubscribe")
        super().close()

    def _ask(self, operation: str, **fields: str) -> None:
        """Send an operation; ValueError: one that a reader may not send."""
        if operation not in READ_OPERATIONS:
            raise ValueError(f"{operation} is not among what this driver may send")
        message = {"op": operation, "id": "verify", "topic": self._settings.topic, **fields}
        self.link.send(json.dumps(message).encode())

    def _take(self, chunk: ports.Chunk) -> list[EncoderReading]:
        try:
            message = json.loads(chunk.data)
        except (ValueError, RecursionError):
            return self._drop("message that is no JSON")
        match message:
            case {"op": "publish", "topic": self._settings.topic, "msg": body}:
                return self._joint_state(body, chunk)
            case {"op": "status", "msg": str(text)}:
                self._remark = f"the bridge says: {' '.join(text.split())}"
                return []
        return self._drop("message that is not understood")

    def _joint_state(self, body: Any, chunk: ports.Chunk) -> list[EncoderReading]:
        names = self._settings.names
        state = parse_joint_state(body, names)
        if isinstance(state, str):
            return self._drop(state)
        if state.missing:
            seen = ", ".join(map(str, list(body["name"])[:MAX_NAMES_LISTED]))
            wanted = ", ".join(state.missing)
            self._fault = f"the messages name {seen or 'no joint'}; no joint is called {wanted}"
            # another device's joints share the topic as a rule
            return [] if len(state.missing) == len(names) else self._drop("message without a joint")
        if self._settings.arrival:
            instant, half_width = intake.arrival(chunk, self._settings.latency)
            return self._intake.take(instant, chunk.t, half_width, state.position)
        if state.stamp is None:
            self._fault = 'the messages have no time stamp; write stamp = "arrival"'
            return self._drop("message without a time stamp")
        seconds, nanoseconds = state.stamp
        self._epoch = seconds if self._epoch is None else self._epoch
        stamped = self._clock.stamp(seconds - self._epoch + nanoseconds * 1e-9, chunk.t)
        if isinstance(stamped, str):
            return self._drop(stamped)
        # where in its cycle the controller reads the joints is not known: anywhere
        return self._intake.take(stamped, chunk.t, self._settings.cycle / 2, state.position)
