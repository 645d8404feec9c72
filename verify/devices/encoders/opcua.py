"""Axis angles from an OPC UA server, polled by the Read service; nothing else is ever called.

One request reads all nodes. Each value carries the source time stamp: the time of its last change
(OPC UA Part 4, DataValue). So an axis whose value changed since the poll before was read at its
stamp, and one whose value did not change still stands there:

    t = middle of the stamps of the axes that moved, known within half their span and half a cycle
    t = what the source's clock shows at least when the request is sent, where none moved

Times count from the first stamp on (a double holds an epoch to 0.2 µs only).
"""

import asyncio
import contextlib
import json
import logging
import math
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC
from importlib import util
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from verify.core.records import Array
from verify.devices import ports
from verify.devices.encoders import intake
from verify.devices.protocols import EncoderReading
from verify.errors import InputError
from verify.io.files import read_bytes

T = TypeVar("T")
ANSWER_TIMEOUT: Final = 1.0  # s, of each request
SESSION_TIMEOUT: Final = 3.0  # s until a session stands: five requests
POLL_RATE: Final = 50.0  # Hz
SOURCE_CYCLE: Final = 0.01  # s, of a controller, unless it is stated
MAX_SPAN: Final = 0.1  # s: axes that moved farther apart in time are not of one instant
POLICIES: Final = ("Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss")
MAX_KEY_BYTES: Final = 1 << 20  # bytes, of a certificate or key
JOIN_TIMEOUT: Final = 1.0  # s


def require_asyncua() -> None:
    """Raise InputError where the package is not installed."""
    if util.find_spec("asyncua") is None:
        remedy = "Run pip install 'verify-robot[opcua]'."
        raise InputError("OPC UA", "needs the package asyncua", "it is not installed", remedy)


@dataclass(frozen=True, slots=True)
class OpcUaSecurity:
    """How the messages to and from a server are signed and encrypted.

    Raises:
        InputError: a file is missing or is none of its kind, or key and certificate differ.
    """

    certificate: Path  # of this computer, with an application URI: X.509, PEM or DER
    private_key: Path  # without a password
    server_certificate: Path | None = None  # None: the one that the server shows is believed
    policy: str = POLICIES[0]

    def __post_init__(self) -> None:
        require_asyncua()
        from cryptography.hazmat.primitives import serialization

        key = _parsed(
            self.private_key, "private key without a password",
            lambda data: serialization.load_pem_private_key(data, None),
            lambda data: serialization.load_der_private_key(data, None),
        )  # fmt: skip
        if self._load(self.certificate).public_key() != key.public_key():
            found = f"is not the key of {self.certificate.name}"
            raise InputError(self.private_key, found, "", "Give the two that were made together.")
        if self.server_certificate is not None:
            self._load(self.server_certificate)
        if not self.application_uri():
            found, expected = "names no application URI", "OPC UA servers compare it"
            remedy = "Make a certificate with a URI as subject alternative name."
            raise InputError(self.certificate, found, expected, remedy)

    def application_uri(self) -> str:
        """The name of the application that the certificate is for; empty: it has none."""
        from cryptography import x509

        try:
            extensions = self._load(self.certificate).extensions
            names = extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except (x509.ExtensionNotFound, ValueError):
            return ""
        return next(iter(names.get_values_for_type(x509.UniformResourceIdentifier)), "")

    async def apply(self, client: Any) -> None:
        """Have a client of asyncua encrypt; what the server refuses is raised as asyncua does."""
        from asyncua import ua
        from asyncua.crypto import security_policies
        from asyncua.crypto.uacrypto import CertProperties

        own, key, server = (
            None if file is None else CertProperties(file, "pem" if _is_pem(file) else "der")
            for file in (self.certificate, self.private_key, self.server_certificate)
        )
        policy = getattr(security_policies, f"SecurityPolicy{self.policy}")
        mode = ua.MessageSecurityMode.SignAndEncrypt
        client.application_uri = self.application_uri()
        await client.set_security(policy, own, key, server_certificate=server, mode=mode)

    @staticmethod
    def _load(file: Path) -> Any:
        from cryptography import x509

        pem, der = x509.load_pem_x509_certificate, x509.load_der_x509_certificate
        return _parsed(file, "X.509 certificate", pem, der)


def _is_pem(file: Path) -> bool:
    return read_bytes(file, MAX_KEY_BYTES).lstrip().startswith(b"-----BEGIN")


def _parsed(file: Path, what: str, pem: Callable[[bytes], Any], der: Callable[[bytes], Any]) -> Any:
    data = read_bytes(file, MAX_KEY_BYTES)
    try:
        return (pem if _is_pem(file) else der)(data)
    except Exception as error:  # of many kinds, as the library does
        remedy = "Export it again in one of these formats."
        raise InputError(file, f"is no {what}", "PEM or DER is expected", remedy) from error


@dataclass(frozen=True, slots=True)
class OpcUaSettings:
    """How a server is reached, and which of its nodes are the axes."""

    url: str  # opc.tcp://[USER:PASSWORD@]HOST:4840
    nodes: tuple[str, ...]  # node ids in the order of the joints; one node may be an array of all
    radians_per_unit: float = math.radians(1.0)
    rate: float = POLL_RATE  # Hz
    cycle: float = SOURCE_CYCLE  # s: values were read within half of it of their stamp
    arrival: bool = False  # take the middle of request and answer instead of the stamps
    latency: float = 0.1  # s, by which a value may be older; used only with `arrival`
    security: OpcUaSecurity | None = None  # None: nothing is signed or encrypted
    user: str = ""  # of the server; empty: the one in the url, or nobody
    password: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        require_asyncua()
        from asyncua import ua

        for node in self.nodes:
            try:
                ua.NodeId.from_string(node)
            except (ua.UaError, ValueError) as error:
                expected = 'a node id is expected, such as "ns=2;s=Axis1.Position" or "ns=4;i=1001"'
                raise InputError("encoders.nodes", f'holds "{node}"', expected, "") from error


@dataclass(slots=True)
class OpcUaPoll:
    """What one request brought."""

    sent: float  # s, host's monotonic clock
    values: list[float] = field(default_factory=list)  # of every axis, in the server's unit
    stamps: list[float | None] = field(default_factory=list)  # s, epoch, of every axis
    server_stamp: float | None = None  # s, epoch, at which the server knew the values
    fault: str = ""  # why the values cannot be used


class OpcUaPort:
    """A session with a server, as a port that gives one poll at a time, as JSON.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, settings: OpcUaSettings) -> None:
        from asyncua import Client, ua

        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what goes wrong, `state` says
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._broken = False
        self._client = Client(settings.url, timeout=ANSWER_TIMEOUT)
        self._period = 1.0 / settings.rate
        self._due = time.monotonic()
        self._sent = 0.0
        self._names = settings.nodes
        wanted = [
            ua.ReadValueId(NodeId=ua.NodeId.from_string(node), AttributeId=ua.AttributeIds.Value)
            for node in settings.nodes
        ]
        self._request = ua.ReadParameters(
            TimestampsToReturn=ua.TimestampsToReturn.Both, NodesToRead=wanted
        )
        self._pending: Future[Any] | None = None
        try:
            self._run(self._connect(settings)).result(SESSION_TIMEOUT)
        except Exception as error:  # of many kinds, where what answers is no OPC UA
            self._broken = True
            self.close()
            pinned = settings.security is not None and settings.security.server_certificate
            if isinstance(error, TimeoutError) and pinned:
                text = "no answer; or it has another certificate than server_certificate"
                raise OSError(text) from error  # a server does not answer what it cannot decrypt
            raise _described(error) from error

    def wait(self, seconds: float) -> bool:
        """Wait for the answer to a poll, which is sent when it is due; OSError: the line broke."""
        return ports.wait_until(self._answered, seconds)

    def take(self) -> bytes:
        """Take the answer that was waited for."""
        pending, self._pending = self._pending, None
        if pending is None:
            return b""
        try:
            found = pending.result()
        except Exception as error:  # of many kinds, as the library does
            self._broken = True
            raise _described(error) from error
        return json.dumps(asdict(_poll(self._sent, self._names, found))).encode()

    def send(self, data: bytes) -> None:  # noqa: ARG002  a port has this verb
        """Refuse: a reader has nothing to send."""
        raise OSError("a server that is polled is not written to")

    def close(self) -> None:
        """End the session, and the thread that held it; never raises."""
        with contextlib.suppress(Exception):  # a server that is gone answers nothing
            self._run(self._end()).result(ANSWER_TIMEOUT)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(JOIN_TIMEOUT)
        if not self._thread.is_alive():
            self._loop.close()

    def _answered(self) -> bool:
        now = time.monotonic()
        if self._pending is None and now >= self._due:
            self._sent, self._due = now, max(self._due + self._period, now)
            self._pending = self._run(self._client.uaclient.read(self._request))
        return self._pending is not None and self._pending.done()

    async def _connect(self, settings: OpcUaSettings) -> None:
        if settings.user:
            self._client.set_user(settings.user)
            self._client.set_password(settings.password)
        if settings.security is not None:
            await settings.security.apply(self._client)
        await self._client.connect()

    async def _end(self) -> None:
        if self._broken:
            self._client.disconnect_socket()
        else:
            await self._client.disconnect()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def _run(self, work: Coroutine[Any, Any, T]) -> "Future[T]":
        return asyncio.run_coroutine_threadsafe(work, self._loop)


def _described(error: Exception) -> OSError:
    """Turn what the library raises into what a port raises."""
    if isinstance(error, OSError):  # TimeoutError too
        return error
    text = " ".join(str(error).split()) or type(error).__name__
    if text.startswith("No matching endpoints"):
        text = "offers no channel of this security: see certificate, private_key, security_policy"
        return OSError(f"the server {text}")
    return OSError(f"the server refuses: {text}")


def _poll(sent: float, names: tuple[str, ...], found: list[Any]) -> OpcUaPoll:
    """Turn the data values of an answer into numbers."""
    poll = OpcUaPoll(sent)
    if len(found) != len(names):
        poll.fault = f"{len(found)} values came for {len(names)} nodes"
        return poll
    for name, data in zip(names, found, strict=True):
        if data.StatusCode is not None and not data.StatusCode.is_good():
            poll.fault = poll.fault or f"node {name} is {data.StatusCode.name}"
            continue
        value = None if data.Value is None else data.Value.Value
        try:
            numbers = np.ravel(np.asarray(value, dtype=float)).tolist()
        except (TypeError, ValueError, OverflowError):
            poll.fault = poll.fault or f"node {name} holds no number"
            continue
        poll.values += numbers
        poll.stamps += [_epoch(data.SourceTimestamp)] * len(numbers)
        poll.server_stamp = _epoch(data.ServerTimestamp)
    return poll


def _epoch(stamp: Any) -> float | None:
    """Turn a time stamp, UTC without its zone, into s since 1970."""
    return None if stamp is None else float(stamp.replace(tzinfo=UTC).timestamp())


class OpcUaEncoders(intake.PortDriver):
    """Joint readings from nodes of an OPC UA server."""

    def __init__(self, settings: OpcUaSettings, angles: intake.AngleMap) -> None:
        name = settings.url.rpartition("@")[2]  # without a password
        name = name if "://" in name else f"opc.tcp://{name}"
        super().__init__(ports.PortLink(name, lambda: OpcUaPort(settings)))
        self._settings, self._joints = settings, angles.joints
        self._intake = intake.ReadingIntake(angles, self.counts)
        self._clock = intake.ControllerClock(None)
        self._epoch: float | None = None  # s, that is taken off every stamp
        self._before: Array | None = None  # (joints,), rad, of the poll before
        self._newest = -math.inf  # s, source's clock: the last stamp of an axis that moved

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call: one reading or none.

        Waits for at most 20 ms on an open line, and for SESSION_TIMEOUT while it connects.
        """
        chunk = self.link.receive()
        if self.link.reopened():
            self._clock.restart(None)
            self._before, self._newest = None, -math.inf
        if chunk is None:
            return []
        poll = OpcUaPoll(**json.loads(chunk.data))
        angle = np.array(poll.values) * self._settings.radians_per_unit
        if poll.fault:
            self._fault = poll.fault
            return self._drop("poll without every axis")
        if len(angle) != self._joints:
            self._fault = f"the nodes hold {len(angle)} numbers, {self._joints} are expected"
            return self._drop("poll without every axis")
        if not np.all(np.abs(angle) <= intake.MAX_JOINT_ANGLE):  # nor what is no number
            return self._drop("poll with impossible angles")
        readings = self._timed(poll, angle, chunk)
        if readings:
            self.link.steady()
            self._fault = ""
        return readings

    def _timed(self, poll: OpcUaPoll, angle: Array, chunk: ports.Chunk) -> list[EncoderReading]:
        if self._settings.arrival:
            asked = replace(chunk, earliest=poll.sent)
            instant, half_width = intake.arrival(asked, self._settings.latency)
            return self._intake.take(instant, chunk.t, half_width, angle)
        given = [stamp for stamp in poll.stamps if stamp is not None]
        if len(given) < self._joints:
            self._fault = 'the server gives no source time stamps; write stamp = "arrival"'
            return self._drop("poll without time stamps")
        self._epoch = math.floor(max(given)) if self._epoch is None else self._epoch
        timed = self._source_time(poll, angle, np.array(given) - self._epoch)
        if isinstance(timed, str):
            return self._drop(timed) if timed else []
        t, half_width = timed
        stamped = self._clock.stamp(t, chunk.t)
        if isinstance(stamped, str):
            return self._drop(stamped)
        return self._intake.take(stamped, chunk.t, half_width, angle)

    def _source_time(
        self, poll: OpcUaPoll, angle: Array, stamps: Array
    ) -> tuple[float, float] | str:
        """When all axes stood at these angles, and within what, s; or why that is not known."""
        before, self._before = self._before, angle
        half_cycle = self._settings.cycle / 2
        if before is None:  # who moved is not known yet, but where all stand now
            server = -math.inf if poll.server_stamp is None else poll.server_stamp
            self._newest = float(np.max(stamps))
            return max(self._newest, server - (self._epoch or 0.0)), half_cycle
        moved = angle != before
        if not np.any(moved):
            return self._clock.least(poll.sent), half_cycle
        newest, oldest = float(np.max(stamps[moved])), float(np.min(stamps[moved]))
        if oldest <= self._newest and newest <= self._newest:
            return "angles that change without their time stamps"
        self._newest = newest
        if newest - oldest > MAX_SPAN:
            return "axes of different instants"
        return (newest + oldest) / 2, (newest - oldest) / 2 + half_cycle
