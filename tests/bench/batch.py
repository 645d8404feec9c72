"""A batch on one core and on two, against pure decoding; and what the fleet report finds.

    python -m tests.bench batch

Each of two cores, both, and decoding as `verify` does it take turns, and medians are compared: on a
shared machine one core may be half as fast as the other, so both are beside their mean. The fleets
are drawn at the level of sessions: 3 arms with 6 joints, 100 sessions each in a year.

A rate counts from the first session begun to the last one kept. What comes before and after
(starting Python, loading libraries and compiled code, tables, reports) is no work on videos, and
decoding's own start is not counted either; how long the whole command takes is printed as well.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.bench.chain import SAMPLE, noisy_sample
from tests.bench.goals import Figure, Line
from tests.support.beside import SHARED
from tests.support.fleets import BEGIN, NO_FAILURES, rows
from verify.fleet.trends.assess import TrendRequest, assess
from verify.io.session.session import open_session

RECORDED = SHARED / "sessions" / "multi_joint_fault_6r"  # noise as a camera has it
LONG = 450  # pairs: half a minute at 15 a second
# sessions: so many that what each process does once is lost among them
SIZES = {"short": 40, "recorded": 48, "long": 6}
ROUNDS = 3
LEAST_OF_TWO_CORES, MOST_OF_DECODING = 1.8, 1.3
FLEETS = 200
RUN = "import os, sys; os.sched_setaffinity(0, {cores}); from verify.cli.main import main; main()"


def lines() -> Iterator[Line]:
    """Print throughput, then fleets."""
    yield from throughput()
    yield from fleets()


def throughput() -> Iterator[Line]:
    """Measure the same sessions on one core and on two, and decode them."""
    yield from _of(SAMPLE, SIZES["short"], None)  # pictures without a camera's noise
    if RECORDED.exists():
        yield from _of(RECORDED, SIZES["recorded"])
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "simulated" / f"{LONG}_pairs"
        yield from _of(noisy_sample(folder, LONG, black_level_dn=8.0), SIZES["long"])


def _of(session: Path, sessions: int, most: float | None = MOST_OF_DECODING) -> Iterator[Line]:
    with tempfile.TemporaryDirectory() as place:
        lab = Path(place) / "lab"
        for number in range(sessions):
            shutil.copytree(session, lab / f"{number:02d}")
        cores = sorted(os.sched_getaffinity(0))
        rounds = []
        for number in range(ROUNDS):
            start = time.perf_counter()
            one = pairs_a_second(lab, Path(place) / f"one{number}", cores[:1])
            whole = time.perf_counter() - start
            other = pairs_a_second(lab, Path(place) / f"other{number}", cores[:2][-1:])
            two = pairs_a_second(lab, Path(place) / f"two{number}", cores[:2])
            rounds.append((one, 2 * two / (one + other), two, _decoded_a_second(lab), whole))
    first, gain, second, pure, whole = np.median(rounds, axis=0).tolist()
    pairs = sessions * len(open_session(session))
    yield f"{sessions} times {session.parent.name}/{session.name}:"
    yield f"  {first:.1f} pairs/s on one core, {second:.1f} on {cores[:2]}, {pure:.1f} decoded"
    name = f"batch of {session.name}"
    yield Figure(f"{name}, two cores / the mean of one", gain, least=LEAST_OF_TWO_CORES)
    yield Figure(f"{name}, one core's time / pure decoding's", pure / first, most=most)
    yield f"  {whole - pairs / first:.1f} s of the command, on one core, are no measuring"


def pairs_a_second(lab: Path, out: Path, cores: list[int]) -> float:
    """Measure all sessions of a folder as a batch on some cores."""
    command = [sys.executable, "-c", RUN.format(cores=set(cores)), "batch", str(lab)]
    # Python keeps what it has compiled, unless a container forbids it
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        [*command, "-o", str(out), "--json"], capture_output=True, text=True, check=False, env=kept
    )
    output = [json.loads(line) for line in done.stdout.splitlines()]
    return float([t["pairs_per_s"] for t in output if t["type"] == "progress"][-1])


def _decoded_a_second(lab: Path) -> float:
    """Pairs a second of reading and decoding alone, on one core."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(allowed)[:1]))
    try:
        sessions = [open_session(folder) for folder in sorted(lab.iterdir())]
        start = time.perf_counter()
        count = sum(1 for session in sessions for _ in session.pairs())
        return count / (time.perf_counter() - start)
    finally:
        os.sched_setaffinity(0, allowed)


def fleets() -> Iterator[str]:
    """Count what is found, how well it is dated, and how often somebody is accused falsely."""
    for calibrations in (1, 3):
        right = others = begun = 0
        off: list[int] = []
        for seed in range(FLEETS):
            sessions = rows(seed, drift=0.02, step=0.3, calibrations=calibrations)
            found = assess(sessions, NO_FAILURES, TrendRequest(), ()).table("changes")
            named = {(r.arm, r.joint): r for r in found.itertuples()}
            drift, step = named.get(("arm_a", 3)), named.get(("arm_b", 5))
            right += drift is not None and drift.kind == "drift" and step is not None
            begun += drift is not None and drift.session == "lab/arm_a/000"
            others += len(set(named) - {("arm_a", 3), ("arm_b", 5)})
            if step is not None:
                arm = sessions[sessions["robot"] == "arm_b"].reset_index(drop=True)
                days = (arm["started"] - BEGIN).dt.total_seconds() / 86_400
                place = int(arm.index[arm["session"] == step.session][0])
                off.append(abs(place - int((days < 160).sum())))
        yield (
            f"{FLEETS} fleets, {calibrations} calibrations a year, drift 0.02°/month, step 0.3°: "
            f"both named {right}, the step dated to its session {off.count(0)}, the drift from the "
            f"first on {begun}, others accused {others}"
        )
    for scatter in (1.0, 2.0):
        accused = sum(_accuses(seed, scatter) for seed in range(FLEETS))
        yield (
            f"{FLEETS} fleets without change, sessions scatter {scatter:g} times what they state: "
            f"{accused} accuse somebody (stated: at most 1 %)"
        )


def _accuses(seed: int, scatter: float) -> bool:
    sessions = rows(10_000 + seed, scatter=scatter, calibrations=seed % 3 + 1)
    return len(assess(sessions, NO_FAILURES, TrendRequest(), ()).table("changes")) > 0
