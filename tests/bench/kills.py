"""A watch killed at random moments: what its recording has lost, and what it leaves behind.

Every second kill strikes the whole process group, as a power cut does; the others only the main
process, as the system does when memory is short: its children must end by themselves. The loss is
the time from the last pair of the recording to the kill.

    python -m tests.bench.soak kills [N]
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.support.command import verify
from tests.support.processes import running, wait_until
from tests.support.watched import Run, listen, station_text
from verify.io.session.session import open_session

COUNT = 100
RATE = 10.0  # pairs a second
MEDIAN, MOST = 0.5, 1.0  # s, of the loss
LATEST = 6.0  # s from the first pairs to a kill
ORPHAN_TIMEOUT = 5.0  # s for children to end


@dataclass(frozen=True)
class Kill:
    """What one kill has left."""

    pairs: int  # in the recording
    loss: float  # s
    status: int  # of `verify run` on the recording
    orphans: int  # processes that outlive the main one


def descendants(pid: int) -> list[int]:
    """All processes below one."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    children = [int(child) for task in tasks for child in task.read_text().split()]
    return children + [p for child in children for p in descendants(child)]


def kill(after: float, *, whole_group: bool) -> Kill:
    """Watch, kill some s after the first pairs, and measure the recording again."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "station.toml").write_text(station_text(RATE))
        process = subprocess.Popen(
            [sys.executable, "-m", "verify", "run", "station.toml", "--json"],
            stdout=subprocess.PIPE, text=True, cwd=folder, start_new_session=True,
        )  # fmt: skip
        listen(process, Run(), lambda pair: pair["frame"] == 3)
        time.sleep(after)
        children = descendants(process.pid)
        (os.killpg if whole_group else os.kill)(process.pid, signal.SIGKILL)
        at = time.monotonic()
        process.communicate()
        with suppress(AssertionError):  # they are counted
            wait_until(lambda: not any(map(running, children)), ORPHAN_TIMEOUT)
        orphans = [child for child in children if running(child)]
        (recording,) = (folder / "recordings").iterdir()
        t = open_session(recording).frames.t_left
        status = verify("run", recording, "-o", folder / "again", "--quiet").status
        return Kill(len(t), at - float(t[-1]), status, len(orphans))


def strike(count: int) -> bool:
    """Kill so often, and print the figures beside their goals; whether all are met."""
    if count < 1:
        raise SystemExit(f"kills {count}: a number of at least 1 is expected")
    draw = np.random.default_rng()
    found = []
    for number in range(count):
        after = float(draw.uniform(0.0, LATEST))
        found.append(kill(after, whole_group=number % 2 == 0))
        print(f"  {number + 1}, {after:.2f} s after the first pairs: {found[-1]}", flush=True)
    losses = np.array([one.loss for one in found])
    opened = sum(one.status in {0, 1, 3} for one in found)
    orphans = sum(one.orphans for one in found)
    median, most = float(np.median(losses)), float(np.max(losses))
    goals = {
        f"{opened} of {count} recordings measured again": opened == count,
        f"lost: median {median:.2f} s (goal {MEDIAN}), at most {most:.2f} s (goal {MOST})": (
            median <= MEDIAN and most <= MOST
        ),
        f"{orphans} processes outlived their main process": not orphans,
    }
    for text, met in goals.items():
        print(f"  {'met ' if met else 'MISSED'} {text}", flush=True)
    return all(goals.values())
