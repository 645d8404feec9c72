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
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.small_disk import mounted
from tests.support.watched import Run, listen, look_on, station_text
from verify.core.records import Array
from verify.live.station.keys import SimSettings
from verify.simulation.devices.station import SimulatedStation

RATE, SECONDS, BEGIN, END = 10.0, 14.0, 6.0, 9.0  # pairs a second; s from the devices' opening
AT_ENDS = 2  # pairs that a watch may begin later or end sooner
MARGIN = 0.25  # s about begin and end: a reading there belongs to neither
FALSE = 5.0  # standard uncertainties
TOLERANCE = 0.5  # deg
USUAL = ("No uncertainty is stated", "The LEDs of ")  # of every run of this station
HARMLESS = {"around: nothing", "around: host clock an hour on", "around: 20 viewers"}
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
        self._struck = False

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
        if not self._struck:
            self._struck = True
            print(json.dumps({"type": "struck", "q": first.q.tolist()}), flush=True)
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
    plain = watch.open_devices

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

    watch.open_devices = opened
    main(words)


def run(fault: str) -> Run:
    """Watch with a fault, in a process of its own."""
    watched, stop, name = Run(), threading.Event(), fault.partition(": ")[2]
    with ExitStack() as stack:
        stack.callback(stop.set)
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
            env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        )  # fmt: skip
        if name == "20 viewers":
            listen(process, watched, lambda _: True)
            look_on(watched.others["page"]["url"], stop, 20)
        listen(process, watched)
        watched.warnings += (folder / "errors").read_text().splitlines()
    return watched


def true_error(
    fault: str, began: Any, struck: list[float] | None, station: SimulatedStation, t: Array
) -> Array:
    """Encoder less true angle at instants (n,) of the cameras' clock: (n, joints), rad.

    `struck`: the reading that the fault of the readings begins with.
    """
    station.scene.clock.began = began["t"]
    q = station.scene.world.joints(station.scene.seconds(t))
    first = np.zeros(q.shape[1]) if struck is None else np.array(struck)
    kinds = {"stalled": first - q, "jumped": JUMP + 0 * q, "mirrored": 2 * (first - q)}
    group, _, name = fault.partition(": ")
    wrong = kinds.get(name, 0 * q) if group == "readings" else 0 * q
    present = (t > began["at"]) & (t < began["at"] + END - BEGIN)
    return np.where(present[:, None], wrong, 0.0)


def false_figures(fault: str, watched: Run, station: SimulatedStation) -> tuple[float, list[str]]:
    """The largest departure from the truth in standard uncertainties, and what is false."""
    if not watched.pairs:
        return 0.0, []
    began = watched.others["began"]
    edges = began["at"] + np.array([[0.0], [END - BEGIN]])
    pairs = [p for p in watched.pairs if p["status"] == "measured"]
    pairs = [p for p in pairs if np.all(np.abs(p["t_s"] - edges) > MARGIN)]
    error, u = (np.array([p[k] for p in pairs], float) for k in ("error_deg", "error_u_deg"))
    struck = watched.others.get("struck", {}).get("q")
    t = np.array([p["t_s"] for p in pairs])
    truth = np.rad2deg(true_error(fault, began, struck, station, t))
    ratio = np.abs(error - truth) / u
    count = int(np.sum(np.any(ratio > FALSE, axis=1)))
    faulty = {0, *(np.flatnonzero(np.any(truth != 0, axis=0)) + 1)}
    accused = [a["joint"] for kind in ("change", "tolerance") for a in watched.told(kind)]
    right = "nonconform" if np.any(np.abs(truth) > TOLERANCE) else "conform"
    verdict = watched.result.get("summary", {}).get("verdict", "undecided")
    false = [f"{count} pairs"] if count else []
    false += [f"joint {joint} accused" for joint in accused if joint not in faulty]
    false += [f"verdict {verdict}"] if verdict not in {right, "undecided"} else []
    return float(np.nanmax(ratio, initial=0.0)), false


def row(fault: str, station: SimulatedStation) -> tuple[str, int, bool]:
    """One line of the table, how many figures are false, and whether a loss is silent."""
    watched = run(fault)
    largest, false = false_figures(fault, watched, station)
    summary = watched.result.get("summary", {"pairs": {"recorded": 0}, "verdict": "no verdict"})
    alarms = Counter(f"{a['kind']} {a['joint'] or a['device'] or ''}" for a in watched.alarms)
    said = [f"{n} {what}" for what, n in (alarms | watched.watched.get("dropped", {})).items()]
    texts = [text for text in watched.warnings if not text.startswith(USUAL)]
    lost = len(watched.pairs) < RATE * SECONDS - AT_ENDS
    silent = lost and not (said or texts or watched.status) and fault not in HARMLESS
    silent |= any("Traceback" in text for text in texts) or not watched.pairs
    line = (
        f"{fault:28} exit {watched.status:2}  {len(watched.pairs):3} pairs of "
        f"{RATE * SECONDS:.0f}, recorded {summary['pairs']['recorded']:3}, {summary['verdict']}; "
        f"at most {largest:.1f} u off; false: {', '.join(false) or 'none'}\n"
        f"    {'SILENT ' if silent else ''}{'; '.join(said) or 'no alarm'}"
    )
    return line + "".join(f"\n    {text[:150]}" for text in texts[-3:]), len(false), silent


def table(names: list[str]) -> int:
    """Print the table of faults; 1 where a figure was false, or a loss silent."""
    station = SimulatedStation(SimSettings("multi_joint_rv_3sd"))
    false = silences = 0
    for fault in [f for f in FAULTS if not names or any(name in f for name in names)]:
        text, wrong, silent = row(fault, station)
        false, silences = false + wrong, silences + silent
        print(text, flush=True)
    print(f"false figures: {false}; silent losses: {silences}")
    return int(bool(false or silences))


if __name__ == "__main__":
    watch_with(sys.argv[1], sys.argv[2:])
