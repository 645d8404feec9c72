"""A watch with one fault each: what it says, what is lost, and whether a figure is false.

Truth is the simulated arm's. A figure is false where a pair's joint error is more than five of its
standard uncertainties from the true one, where a joint is accused that is sound, or where the
verdict contradicts the truth. A fault is silent where pairs are lost and nothing says so.

    python -m tests.bench.soak faults [NAME …]
"""

import ctypes
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.devices.emulated_station import look_on, station_text
from tests.support.small_disk import mounted
from verify.core.records import Array
from verify.live.station.keys import SimSettings
from verify.simulation.devices.station import SimulatedStation

RATE, SECONDS, BEGIN, END = 10.0, 14.0, 6.0, 9.0  # pairs a second; s from the devices' opening
MARGIN = 0.25  # s about begin and end: a reading there belongs to neither
FALSE = 5.0  # standard uncertainties
TOLERANCE = 0.5  # deg
JUMP = np.deg2rad([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
PROCESSES = ("measurement", "right picture", "page", "clock")
THREADS = (
    *("left camera", "right camera", "encoders", "measurement", "comparison", "clock"),
    *("recorder", "listener", "page"),
)
PICTURES = ("late", "doubled", "black", "truncated", "unread")
READINGS = ("silent", "stalled", "jumped", "mirrored", "back in time", "unread")
AROUND = ("nothing", "host clock an hour on", "disk full", "20 viewers", "load of 10")
FAULTS = (
    *(f"process killed: {name}" for name in PROCESSES),
    *(f"thread raises: {name}" for name in THREADS),
    *(f"pictures: {name}" for name in PICTURES),
    *(f"readings: {name}" for name in READINGS),
    *(f"around: {name}" for name in AROUND),
)


class InjectedError(Exception):
    """What a thread is made to raise."""


class FaultyDevice:
    """A device that reads wrongly from begin to end, s of the host's monotonic clock."""

    def __init__(self, device: Any, name: str, begin: float) -> None:
        self._device, self._name, self._begin = device, name, begin
        self._before: Any = None
        self._held: deque[tuple[float, Any]] = deque()

    def __getattr__(self, key: str) -> Any:
        return getattr(self._device, key)

    def read(self) -> Any:
        found, now = self._device.read(), time.monotonic()
        present = self._begin < now < self._begin + END - BEGIN
        if self._name == "unread" and present:
            raise InjectedError
        if self._name == "late":  # each picture comes a quarter of a second later than it was
            if found is not None:
                self._held.append((now + (0.25 if present else 0.0), found))
            return self._held.popleft()[1] if self._held and self._held[0][0] <= now else None
        if isinstance(found, list):
            return [r for reading in found if (r := self._reading(reading, present)) is not None]
        return found if found is None else self._picture(found, present)

    def _picture(self, frame: Any, present: bool) -> Any:
        before, self._before = self._before, frame
        if not present:
            return frame
        image = frame.image.copy()
        if self._name == "black":
            image[:] = 0
        elif self._name == "truncated":
            image[len(image) // 2 :] = 0
        elif before is not None and frame.sequence % 2:
            image = before.image
        return replace(frame, image=image)

    def _reading(self, reading: Any, present: bool) -> Any:
        if not present or self._before is None:
            self._before = reading
            return reading
        first = self._before
        match self._name:
            case "stalled":
                return replace(reading, q=first.q)
            case "jumped":
                return replace(reading, q=reading.q + JUMP)
            case "mirrored":
                return replace(reading, q=2 * first.q - reading.q)
            case "back in time":
                return replace(reading, t=2 * first.t - reading.t)
        return None


def _strike(group: str, name: str) -> None:
    """Kill a process of this watch, or make a thread raise."""
    if group == "process killed":
        children = {child.name: child.pid for child in multiprocessing.active_children()}
        if name == "right picture":
            tasks = Path(f"/proc/{children['measurement']}/task").glob("*/children")
            children[name] = next(int(p) for task in tasks for p in task.read_text().split()[-1:])
        os.kill(children[name] or 0, signal.SIGKILL)
    elif group == "thread raises":
        (thread,) = [t for t in threading.enumerate() if t.name == name]
        error = ctypes.py_object(InjectedError)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), error)
    elif name == "host clock an hour on":
        plain = time.time
        time.time = lambda: plain() + 3600.0


def watch_with(fault: str, words: list[str]) -> None:
    """Be `verify` in a process of its own, with a fault in it."""
    from verify.cli import watch
    from verify.cli.main import main

    group, _, name = fault.partition(": ")
    plain = watch._open_devices

    def opened(station: Any) -> Any:
        devices, begin = plain(station), time.monotonic() + BEGIN
        print(json.dumps({"type": "began", "t": devices.left._scene.clock.began, "at": begin}))
        threading.Timer(BEGIN, _strike, (group, name)).start()
        if group == "pictures":
            left, right = (FaultyDevice(d, name, begin) for d in (devices.left, devices.right))
            return replace(devices, left=left, right=right if name == "doubled" else devices.right)
        if group == "readings":
            return replace(devices, encoders=FaultyDevice(devices.encoders, name, begin))
        return devices

    watch._open_devices = opened
    main(words)


@dataclass
class Outcome:
    """What a watch with a fault printed, and left."""

    fault: str
    began: float = 0.0  # s, cameras' clock
    at: float = 0.0  # s, of the fault
    pairs: list[dict[str, Any]] = field(default_factory=list)
    alarms: Counter[str] = field(default_factory=Counter)
    warnings: list[str] = field(default_factory=list)
    watched: dict[str, Any] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)
    errors: str = ""
    status: int = -1

    def take(self, message: dict[str, Any]) -> None:
        match message["type"]:
            case "began":
                self.began, self.at = message["t"], message["at"]
            case "pair" if not message["settled"]:
                self.pairs.append(message)
            case "alarm" if message["ended_s"] is None and not message["revised"]:
                joint = "" if message["joint"] is None else f" {message['joint']}"
                self.alarms[f"{message['kind']}{joint} {message['device'] or ''}".strip()] += 1
            case "warning":
                self.warnings.append(message["text"])
            case "watched":
                self.watched = message
            case "result":
                self.summary = message["summary"]


def run(fault: str) -> Outcome:
    """Watch with a fault, in a process of its own."""
    outcome, name = Outcome(fault), fault.partition(": ")[2]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / "station.toml").write_text(station_text(RATE))
        if name == "disk full":
            stack.enter_context(mounted(folder / "recordings", "-o", "size=5m"))
        for _ in range(10 if name == "load of 10" else 0):
            stack.callback(subprocess.Popen([sys.executable, "-c", "while 1: pass"]).kill)
        words = ["run", "station.toml", "--json", "--for", f"{SECONDS}s", "-o", "out"]
        words += ["--tolerance", str(TOLERANCE), "--page", "--page-port", "0"]
        process = subprocess.Popen(
            [sys.executable, "-m", __name__, fault, *words], cwd=folder, text=True,
            stdout=subprocess.PIPE, stderr=(folder / "errors").open("w"),
        )  # fmt: skip
        stop = threading.Event()
        stack.callback(stop.set)
        for line in process.stdout or ():
            message = json.loads(line)
            outcome.take(message)
            if message["type"] == "page" and name == "20 viewers":
                look_on(message["url"], stop, 20)
        outcome.status = process.wait()
        outcome.errors = (folder / "errors").read_text()
    return outcome


def true_error(outcome: Outcome, station: SimulatedStation, t: Array) -> Array:
    """Encoder less true angle at instants (n,) of the cameras' clock: (n, joints), rad."""
    station.scene.clock.began = outcome.began
    q, first = station.scene.joints(t), station.scene.joints(np.array([outcome.at]))
    kinds = {"stalled": first - q, "jumped": JUMP + 0 * q, "mirrored": 2 * (first - q)}
    group, _, name = outcome.fault.partition(": ")
    wrong = kinds.get(name, 0 * q) if group == "readings" else 0 * q
    present = (t > outcome.at) & (t < outcome.at + END - BEGIN)
    return np.where(present[:, None], wrong, 0.0)


def false_figures(outcome: Outcome, station: SimulatedStation) -> tuple[float, list[str]]:
    """The largest departure from the truth in standard uncertainties, and what is false."""
    found = [p for p in outcome.pairs if p["status"] == "measured"]
    edges = outcome.at + np.array([[0.0], [END - BEGIN]])
    found = [p for p in found if np.all(np.abs(p["t_s"] - edges) > MARGIN)]
    if not found:
        return 0.0, []
    error, u = (np.array([p[k] for p in found], float) for k in ("error_deg", "error_u_deg"))
    truth = np.rad2deg(true_error(outcome, station, np.array([p["t_s"] for p in found])))
    ratio = np.abs(error - truth) / u
    false = [f"{np.sum(np.any(ratio > FALSE, axis=1))} pairs"] if np.any(ratio > FALSE) else []
    wrong = np.flatnonzero(np.any(truth != 0, axis=0)) + 1
    accusing = [a for a in outcome.alarms if a.split()[0] in {"change", "tolerance"}]
    false += [a for a in accusing if not len(wrong) or int(a.split()[1]) not in wrong]
    right = "nonconform" if np.any(np.abs(truth) > TOLERANCE) else "conform"
    verdict = outcome.summary.get("verdict", "undecided")
    false += [f"verdict {verdict}"] if verdict not in {right, "undecided"} else []
    return float(np.nanmax(ratio, initial=0.0)), false


def row(outcome: Outcome, station: SimulatedStation) -> tuple[str, int, bool]:
    """One line of the table, how many figures are false, and whether a loss is silent."""
    largest, false = false_figures(outcome, station)
    recorded = outcome.summary.get("pairs", {}).get("recorded", 0)
    expected = int(RATE * SECONDS)
    dropped = outcome.watched.get("dropped", {})
    lost = expected - len(outcome.pairs)
    lines = [*outcome.warnings, *filter(str.strip, outcome.errors.splitlines())]
    said = [f"{n} {a}" for a, n in outcome.alarms.items()] + [
        f"{n} {w}" for w, n in dropped.items()
    ]
    harmless = outcome.fault in {"around: nothing", "around: host clock an hour on"}
    silent = not (said or lines or harmless) or "Traceback" in outcome.errors
    text = (
        f"{outcome.fault:26} exit {outcome.status:3}  {len(outcome.pairs):3} pairs, lost {lost:3}, "
        f"recorded {recorded:3}, {outcome.summary.get('verdict', 'no verdict')}; "
        f"largest {largest:.1f} u; FALSE {', '.join(false) or 'none'}\n"
        f"    {'SILENT ' if silent else ''}{'; '.join(said) or 'no alarm'}"
    )
    return text + "".join(f"\n    {line[:150]}" for line in lines[-3:]), len(false), silent


def table(names: list[str]) -> int:
    """Print the table of faults; 1 where a figure was false, or a loss silent."""
    station = SimulatedStation(SimSettings("multi_joint_rv_3sd"))
    false = silences = 0
    for fault in [f for f in FAULTS if not names or any(name in f for name in names)]:
        text, wrong, silent = row(run(fault), station)
        false, silences = false + wrong, silences + silent
        print(text, flush=True)
    print(f"false figures: {false}; silent losses: {silences}")
    return int(bool(false or silences))


if __name__ == "__main__":
    watch_with(sys.argv[1], sys.argv[2:])
