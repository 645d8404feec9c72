"""A watch in a process of its own: its station, what it prints, and viewers of its page."""

import json
import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

ENCODERS = 'driver = "sim", rate_hz = 100.0'
STATION = """format = 1
robot = "rv_3sd_melfa"
rig = "sim"
marker = "sim"
left = {{ source = "sim", rate_hz = {rate} }}
right = {{ source = "sim", rate_hz = {rate} }}
encoders = {{ {encoders} }}
alarm = {{ false_alarms_per_hour = 0.1 }}
recording = {{ folder = "recordings" }}
sim = {{ scenario = "multi_joint_rv_3sd" }}
"""


def station_text(rate: float, encoders: str = ENCODERS) -> str:
    """Write a station file: pairs a second, and the encoders' table."""
    return STATION.format(rate=float(rate), encoders=encoders)


@dataclass
class Run:
    """What a run printed."""

    pairs: list[dict[str, Any]] = field(default_factory=list)  # as they come
    settled: list[dict[str, Any]] = field(default_factory=list)
    alarms: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    watched: dict[str, Any] = field(default_factory=dict)
    result: dict[str, Any] = field(default_factory=dict)
    others: dict[str, dict[str, Any]] = field(default_factory=dict)  # the last of each kind
    status: int = -1

    def told(self, kind: str, *, over: bool = False) -> list[dict[str, Any]]:
        return [
            a
            for a in self.alarms
            if a["kind"] == kind and (a["ended_s"] is not None) == over and not a["revised"]
        ]

    def worst(self, joint: int | None = None) -> float:
        """The largest error of any pair in its own standard uncertainty, but for small ones."""
        pairs = [zip(p["error_deg"], p["error_u_deg"], strict=True) for p in self.pairs]
        return max(
            abs(error) / max(u, 0.02)
            for pair in pairs
            for j, (error, u) in enumerate(pair, start=1)
            if error is not None and j != joint
        )


def listen(
    process: "subprocess.Popen[str]",
    run: Run,
    until: Callable[[dict[str, Any]], bool] | None = None,
) -> Run:
    """Take what is said, up to a certain pair, or to the end."""
    for line in process.stdout:
        message = json.loads(line)
        match message["type"]:
            case "pair" if message["settled"]:
                run.settled.append(message)
            case "pair":
                run.pairs.append(message)
                if until is not None and until(message):
                    return run
            case "alarm":
                run.alarms.append(message)
            case "warning":
                run.warnings.append(message["text"])
            case "watched":
                run.watched = message
            case "result":
                run.result = message
            case kind:
                run.others[kind] = message
    run.status = process.wait()
    process.stdout.close()
    if until is not None:
        pytest.fail(f"ended with {run.status} before its time: {run.watched}, {run.warnings}")
    return run


def look_on(url: str, stop: threading.Event, viewers: int) -> list[int]:
    """Start viewers that take everything that the page would; how many messages each has got."""
    received = [0] * viewers

    def view(number: int) -> None:
        while not stop.is_set():
            try:
                address = url.replace("http", "ws") + "live"
                with connect(address, origin=url.rstrip("/"), max_size=None) as socket:
                    while not stop.is_set():
                        socket.recv(timeout=5.0)
                        received[number] += 1
            except (OSError, TimeoutError, WebSocketException):
                stop.wait(0.2)

    for number in range(viewers):
        threading.Thread(target=view, args=(number,), daemon=True).start()
    return received
