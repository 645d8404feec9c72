"""An OPC UA server whose nodes are the axes of an arm, over the server of asyncua.

A node for each axis holds its angle in degrees; another holds all of them in radians, as an array.
"""

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import Server, ua

from verify.simulation.emulators.server import EmulatorFaults, in_span
from verify.simulation.emulators.trajectory import EmulatedTrajectory

NAMESPACE = "urn:verify:emulator"


class OpcUaEmulator:
    """One server; `serve` runs it until it is told to end."""

    def __init__(
        self,
        host: str,
        port: int,
        trajectory: EmulatedTrajectory,
        joints: int,
        rate: int = 100,
        faults: EmulatorFaults | None = None,
    ) -> None:
        self._where = (host, port)
        self.trajectory, self._joints = trajectory, joints
        self._rate = rate  # Hz at which the axes are written
        self.faults = EmulatorFaults() if faults is None else faults
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # a client that leaves is no news
        self._loop = asyncio.new_event_loop()
        self._server = Server()
        self._plugged = True
        self._nodes: list[Any] = []
        self._loop.run_until_complete(self._start())

    @property
    def address(self) -> str:
        """What a client opens."""
        return f"opc.tcp://{self._where[0]}:{self._where[1]}"

    def serve(self, until: Callable[[], bool], now: Callable[[], float] = time.monotonic) -> None:
        """Serve until `until` returns True; `now` is a clock, s."""
        self._loop.run_until_complete(self._serve(until, now))

    def close(self) -> None:
        """Close the server."""
        self._loop.run_until_complete(self._server.stop())
        self._loop.close()

    async def _start(self) -> None:
        """Listen; port 0 takes a free one, and keeps it."""
        server = self._server
        await server.init()
        server.set_endpoint(self.address)
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        await server.register_namespace(NAMESPACE)
        axes = [(f"Axis{joint}", 0.0) for joint in range(1, self._joints + 1)]
        for name, first in (*axes, ("Axes", [0.0] * self._joints)):
            node = ua.NodeId.from_string(f"ns=2;s={name}.Position")
            self._nodes.append(await server.nodes.objects.add_variable(node, name, first))
        await server.start()
        self._where = (self._where[0], server.bserver.port)

    async def _serve(self, until: Callable[[], bool], now: Callable[[], float]) -> None:
        start = now()
        count = 0
        while not until():
            t = now() - start
            plugged = not in_span(self.faults.unplug, t)
            if plugged != self._plugged:  # its listener and all connections; the port stays
                self._plugged = plugged
                await (self._server.bserver.start() if plugged else self._server.bserver.stop())
            if plugged and not in_span(self.faults.silence, t):
                await self._write(t)
            count = max(count + 1, math.ceil((now() - start) * self._rate))
            await asyncio.sleep(max(start + count / self._rate - now(), 0.0))

    async def _write(self, t: float) -> None:
        jump = self.faults.jump
        leap = jump[1] if jump is not None and t >= jump[0] else 0.0
        stamp = datetime.now(UTC).replace(tzinfo=None) + timedelta(seconds=leap)
        status = self.faults.status
        bad = status is not None and t >= status[0]
        code = ua.StatusCode(ua.StatusCodes.BadNotReadable if bad else ua.StatusCodes.Good)
        q = self.trajectory(max(t, 0.0)).tolist()
        for node, value in zip(self._nodes, [*map(math.degrees, q), q], strict=True):
            data = ua.DataValue(
                ua.Variant(value, ua.VariantType.Double), code, SourceTimestamp=stamp
            )
            with contextlib.suppress(ua.UaError):
                await node.write_value(data)
