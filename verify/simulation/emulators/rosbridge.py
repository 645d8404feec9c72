"""A rosbridge server with one topic of joint states, on a websocket."""

import contextlib
import json
import queue
import random
import threading
from dataclasses import dataclass

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from verify.simulation.emulators.server import EmulatorEngine, TimedMessage
from verify.simulation.emulators.trajectory import EmulatedTrajectory

EXTRA_JOINT = "finger_joint"  # of a gripper, whose joint shares the topic
EPOCH = 1.7e9  # s: the stamp at the emulator's start


class WebSocketEndpoint:
    """A websocket server for one client at a time; a second one takes the first one's place."""

    def __init__(self, host: str, port: int) -> None:
        self._where = (host, port)
        self._inbox: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()  # None: a client came
        self._client: ServerConnection | None = None
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Take one message, or the news that a client has connected."""
        with contextlib.suppress(queue.Empty):
            data = self._inbox.get(timeout=wait)
            return data is None, data or b""
        return False, b""

    def send(self, data: bytes) -> None:
        """Send a message: text where it is text."""
        client = self._client
        if client is not None:
            with contextlib.suppress(ConnectionClosed):
                try:
                    client.send(data.decode())
                except UnicodeDecodeError:
                    client.send(data)

    def unplug(self) -> None:
        """Close everything."""
        self._server.shutdown()
        if self._client is not None:
            self._client.close()
        self._client = None

    def plug(self) -> None:
        """Listen; port 0 takes a free one, and keeps it."""
        self._server = serve(self._listen, *self._where, compression=None)
        self._where = (self._where[0], self._server.socket.getsockname()[1])
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.address = f"ws://{self._where[0]}:{self._where[1]}"

    def _listen(self, client: ServerConnection) -> None:
        self._client = client
        self._inbox.put(None)
        with contextlib.suppress(ConnectionClosed):
            for message in client:
                self._inbox.put(message.encode() if isinstance(message, str) else message)
        if self._client is client:
            self._client = None


@dataclass(frozen=True, slots=True)
class RosbridgeOptions:
    """What the topic is like."""

    names: tuple[str, ...]  # of the joints, in the order of the angles
    topic: str = "/joint_states"
    rate: int = 100  # Hz


class RosbridgeEngine(EmulatorEngine):
    """The bridge, and a robot that publishes its joints in another order each time."""

    def __init__(self, trajectory: EmulatedTrajectory, options: RosbridgeOptions) -> None:
        self.log: list[str] = []  # every operation received
        self._trajectory, self._options = trajectory, options
        self._random = random.Random(0)
        self._subscribed = False
        self._next = 0.0

    def greet(self, t: float) -> None:  # noqa: ARG002  an engine has this verb
        """Take a client, who has subscribed to nothing."""
        self._subscribed = False

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        """Answer an operation, then publish the joint states that are due."""
        messages = []
        if received and (answer := self._answer(received, t)):
            messages.append(TimedMessage(t, answer))
        while self._subscribed and self._next <= t:
            messages.append(TimedMessage(self._next, self._joint_state(self._next)))
            self._next += 1.0 / self._options.rate
        return messages

    def _answer(self, received: bytes, t: float) -> bytes:
        try:
            operation = json.loads(received)
            kind, topic = operation["op"], operation.get("topic")
        except (ValueError, KeyError, TypeError, AttributeError):
            return _error("invalid message")
        self.log.append(str(kind))
        if kind == "subscribe" and topic == self._options.topic:
            self._subscribed, self._next = True, t
            return b""
        if kind == "unsubscribe":
            self._subscribed = False
            return b""
        return _error(f"{kind} {topic} failed")

    def _joint_state(self, t: float) -> bytes:
        joints = {
            **dict(zip(self._options.names, self._trajectory(max(t, 0.0)).tolist(), strict=True)),
            EXTRA_JOINT: 0.02,
        }
        names = list(joints)
        self._random.shuffle(names)
        stamp = EPOCH + t + self._jump
        body = {
            "header": {
                "stamp": {"sec": int(stamp), "nanosec": int(stamp % 1 * 1e9)},
                "frame_id": "base_link",
            },
            "name": names,
            "position": [joints[name] for name in names],
            "velocity": [0.0] * len(names),
            "effort": [None] * len(names),  # as NaN is written: many arms measure none
        }
        return json.dumps({"op": "publish", "topic": self._options.topic, "msg": body}).encode()


def _error(text: str) -> bytes:
    return json.dumps({"op": "status", "level": "error", "msg": text}).encode()
