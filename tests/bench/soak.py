"""`verify run` on a station: ten minutes at 30 pairs a second, faults, and kills.

Three runs, each with recording and a viewer of the page, or more: everything simulated, a LABENC
board on a pty, and a MELFA controller over TCP; the emulators are a process of their own and follow
the simulated arm. Goals: no pair lost, p50 under 10 ms and p99 under 30 ms from the later of
picture and bracketing reading to the joint errors, memory flat within 50 MB after a minute.

    python -m tests.bench.soak [MINUTES] [sim|labenc|melfa …] [viewers=N]
    python -m tests.bench.soak faults [NAME …]      one fault each: tests/bench/faults.py
    python -m tests.bench.soak kills [N]            killed at random moments: tests/bench/kills.py
"""

import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from tests.bench import faults, kills
from tests.support.devices.emulated_station import emulator, start_beside
from tests.support.watched import ENCODERS, Run, listen, look_on, station_text

MINUTES = 10.0
RATE = 30.0  # pairs a second
P50, P99 = 10.0, 30.0  # ms
FLAT = 50.0  # MB
SAMPLED = 20.0  # s from one look at the memory to the next, which holds the processes up
SETTLED = 60.0  # s until memory is compared; a short soak: half of it
PORTS = {"labenc": "pty", "melfa": "tcp:0"}


def _resident(pid: int) -> float:
    """Memory of a process and its children, MB."""
    total = 0.0
    pending = [pid]
    while pending:
        p = pending.pop()
        try:
            status = Path(f"/proc/{p}/smaps_rollup").read_text()
            total += next(int(x.split()[1]) for x in status.splitlines() if x.startswith("Pss:"))
            children = Path(f"/proc/{p}/task").glob("*/children")
            pending += [int(c) for f in children for c in f.read_text().split()]
        except (OSError, StopIteration):
            continue
    return total / 1024


def soak(kind: str, seconds: float, viewers: int) -> bool:
    """Run one station and print what came of it; whether all goals were met."""
    began = time.monotonic()
    with ExitStack() as stack:
        encoders = ENCODERS
        if kind != "sim":
            address, go = stack.enter_context(emulator(kind, PORTS[kind], began))
            go()
            encoders = f'driver = "{kind}", port = "{address}"'
        path = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "station.toml"
        path.write_text(station_text(RATE, encoders))
        process = start_beside(path, began, seconds)
        return _followed(kind, process, began, seconds, viewers)


def _followed(
    kind: str, process: "subprocess.Popen[str]", began: float, seconds: float, viewers: int
) -> bool:
    stop = threading.Event()
    memory: list[tuple[float, float]] = []

    def sample() -> None:
        while not stop.wait(min(SAMPLED, seconds / 12)):
            memory.append((time.monotonic() - began, _resident(process.pid)))

    threading.Thread(target=sample, daemon=True).start()
    run = listen(process, Run(), lambda _: True)
    received = look_on(run.others["page"]["url"], stop, viewers)
    listen(process, run)
    stop.set()
    for text in [*run.warnings, *(alarm["text"] for alarm in run.alarms)]:
        print(f"  {text}")
    return _conclude(kind, run.watched, memory, received, seconds)


def _conclude(
    kind: str,
    message: dict[str, object],
    memory: list[tuple[float, float]],
    received: list[int],
    seconds: float,
) -> bool:
    """Print the figures beside their goals."""
    settled = [m for t, m in memory if min(SETTLED, seconds / 2) < t < seconds]
    growth = max(settled) - settled[0] if settled else float("nan")
    pairs, dropped = int(str(message["pairs"])), message["dropped"]
    p50, p99 = (float(str(message[f"latency_{p}_ms"])) for p in ("p50", "p99"))
    share = pairs / (RATE * seconds)
    goals = {
        f"{pairs} pairs in {seconds:.0f} s, {share:.1%} of 30 a second, lost {dropped or 'none'}, "
        f"{message['statuses']}": not dropped,
        f"latency p50 {p50:.1f} ms (goal {P50:.0f}), p99 {p99:.1f} ms (goal {P99:.0f}), of all "
        f"pairs": p50 < P50 and p99 < P99,
        f"memory {settled[0] if settled else 0:.0f} MB with all its processes, grown by "
        f"{growth:.0f} MB (goal {FLAT:.0f})": growth < FLAT,
    }
    print(
        f"{kind}: alarms {message['alarms'] or 'none'}, {len(received)} viewers "
        f"got {min(received)} to {max(received)} messages"
    )
    for text, met in goals.items():
        print(f"  {'met ' if met else 'MISSED'} {text}", flush=True)
    return all(goals.values())


def main(words: list[str]) -> int:
    """Soak; 1 where a goal is missed."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command itself does
    if words[:1] == ["faults"]:
        return faults.table(words[1:])
    known = rf"sim|{'|'.join(PORTS)}|kills|viewers=[1-9]\d*|[\d.]*[1-9][\d.]*"
    if wrong := [word for word in words if not re.fullmatch(known, word)]:
        expected = "a number above 0, sim, labenc, melfa, kills or viewers=N"
        raise SystemExit(f"{wrong[0]}: {expected} is expected")
    numbers = [float(w) for w in words if w.replace(".", "").isdigit()]
    viewers = [int(w.removeprefix("viewers=")) for w in words if w.startswith("viewers=")] or [1]
    if words[:1] == ["kills"]:
        return int(not kills.strike(int(numbers[0]) if numbers else kills.COUNT))
    kinds = [w for w in words if w in {"sim", *PORTS}] or ["sim", *PORTS]
    seconds = 60.0 * (numbers[0] if numbers else MINUTES)
    return int(not min([soak(kind, seconds, viewers[0]) for kind in kinds]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
