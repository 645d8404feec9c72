"""A year of three arms through pixels: 300 sessions rendered, and measured by `verify batch`.

    python -m tests.bench.fleet_pixels [SESSIONS OF AN ARM]

Joint 3 of arm_a drifts by 0.02° a month, joint 5 of arm_b steps by 0.3° on 10 June, arm_c stays as
it is. Sessions are 10 pairs of 1280 x 720 each, at even spacing with chance; the rig is placed anew
for each, and exactly known. Wanted: all measured, both named, the step dated to its session, the
drift from the first session on, and nobody else.
"""

import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd

from tests.support.fleets import MONTH, NO_FAILURES, YEAR, record
from verify.fleet.trends.assess import TrendRequest, assess
from verify.simulation.scenario import ScenarioFault

SESSIONS = 100  # of each arm
DRIFT, STEP = 0.02, 0.3  # degrees a month; degrees
STEPS_ON = 160.0  # day of the year: 10 June
ARMS = ("arm_a", "arm_b", "arm_c")
DRIFTS, STEPPED = ("arm_a", 3), ("arm_b", 5)


def fault(arm: str, day: float) -> ScenarioFault | None:
    """What is wrong with an arm on a day."""
    if arm == DRIFTS[0]:
        return ScenarioFault(joint=DRIFTS[1], offset_deg=DRIFT * day / MONTH)
    if arm == STEPPED[0] and day >= STEPS_ON:
        return ScenarioFault(joint=STEPPED[1], offset_deg=STEP)
    return None


def days(sessions: int, seed: int) -> np.ndarray:
    """When an arm is looked at, days of the year, rising."""
    chance = np.random.default_rng(seed).uniform(0.1, 0.9, sessions)
    return (np.arange(sessions) + chance) * YEAR / sessions


def render(place: str, arm: str, number: int, day: float) -> None:
    """Simulate one session."""
    seed = 1_000 * (ARMS.index(arm) + 1) + number
    record(Path(place) / arm / f"{number:03d}", seed, fault(arm, day), day)


def main(sessions: int) -> int:
    """Print what the batch finds; 1 where it is not what there is."""
    with tempfile.TemporaryDirectory() as place, ProcessPoolExecutor(2, get_context("spawn")) as p:
        lab, out = Path(place) / "lab", Path(place) / "out"
        began = time.monotonic()
        when = {arm: days(sessions, n) for n, arm in enumerate(ARMS)}
        tasks = [(str(lab), arm, n, float(d)) for arm in ARMS for n, d in enumerate(when[arm])]
        for _ in p.map(render, *zip(*tasks, strict=True), chunksize=4):
            pass
        rendered = time.monotonic()
        words = ["batch", str(lab), "-o", str(out), "--by", "folder", "--quiet"]
        done = subprocess.run([sys.executable, "-m", "verify", *words], check=False)
        measured = time.monotonic()
        print(f"{len(tasks)} sessions rendered in {rendered - began:.0f} s, measured and reported "
              f"in {measured - rendered:.0f} s, exit status {done.returncode}")  # fmt: skip
        rows = pd.read_parquet(out / "sessions.parquet")
        found = assess(rows, NO_FAILURES, TrendRequest(by="folder"), ())
        return _told(found.table("changes"), when, len(rows))


def _told(changes: pd.DataFrame, when: dict[str, np.ndarray], measured: int) -> int:
    named = {(str(r.arm).rsplit("/", 1)[-1].split()[-1], int(r.joint)): r
             for r in changes.itertuples()}  # fmt: skip
    for (arm, joint), row in named.items():
        print(f"  {arm}, joint {joint}: {row.kind} from session {row.session[-3:]}")
    drift, step = named.get(DRIFTS), named.get(STEPPED)
    true = int((when[STEPPED[0]] < STEPS_ON).sum())
    every = sum(len(times) for times in when.values())
    goals = {
        f"{measured} of {every} are measured": measured == every,
        "the drift is named": drift is not None and drift.kind == "drift",
        "it is dated to the first session": drift is not None and drift.session.endswith("000"),
        "the step is named": step is not None and step.kind == "step",
        f"it is dated to session {true:03d}":
            step is not None and step.session.endswith(f"{true:03d}"),
        "nobody else is accused": set(named) <= {DRIFTS, STEPPED},
    }  # fmt: skip
    for text, met in goals.items():
        print(f"  {'met ' if met else 'MISSED'} {text}", flush=True)
    return int(not all(goals.values()))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else SESSIONS))
