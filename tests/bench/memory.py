"""A session of any length in constant memory: 10,000 pairs from pixels to both reports.

The pairs are rendered as they are asked for, in a process of their own whose peak is then the
chain's: were pictures kept, 10,000 pairs would be 18 GB.

A batch of any number of sessions likewise: each stands for one that was measured, with a name and
a day of its own, and goes through the store, the tables and the fleet report.

    python -m tests.bench.memory [PAIRS]
    python -m tests.bench.memory sessions [N]
"""

import json
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from tests.bench.goals import Figure, Line
from tests.support.fleets import BEGIN, NO_FAILURES, record
from tests.support.simulated import InMemory, in_memory
from verify.analysis.session import analyse
from verify.cli.options import ToleranceOptions
from verify.fleet.batch import tables
from verify.fleet.batch.records import BatchOptions, SessionLocation, SessionResults
from verify.fleet.batch.run import measure_all
from verify.fleet.batch.tasks import pack_results, rename_session
from verify.fleet.trends.assess import TrendRequest, assess
from verify.io.results import write_report_folder
from verify.io.session.session import open_session
from verify.simulation import library
from verify.simulation.scenario import Scenario, ScenarioPlacement
from verify.simulation.session.simulate import simulate_session

PAIRS = 10_000
MOST_MB = 600.0
SHARE = 0.4  # of the sample's amplitudes: whatever the phases become in ten minutes, all is in view
MEBIBYTE = 1024  # VmHWM counts kibibytes


def lines(pairs: int = PAIRS) -> Iterator[Line]:
    """Measure in a fresh process; the words of its last line are the outcome."""
    words = [sys.executable, "-m", "tests.bench.memory", "--here", str(pairs)]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    found = json.loads(done.stdout.splitlines()[-1])
    measured = f"{found['measured']} of {found['recorded']} pairs"
    yield f"{measured}, rendered, measured, judged and reported in {found['seconds']:.0f} s"
    for name, peak in found["peak_mb"].items():
        yield Figure(f"peak memory, {name}", peak, "MB", most=MOST_MB)


def long_session(pairs: int) -> InMemory:
    """The multi-joint sample with smaller swings for as long as it takes, cameras where they are.

    The camera's place is taken from the short sample: looking for one among thousands of pairs
    would be the largest memory of all.
    """
    sample = library.load("multi_joint_fault_6r")
    played = simulate_session(sample)
    rig_T_base = played.rig.rig_T_base
    turn = Rotation.from_matrix(rig_T_base[:3, :3]).as_rotvec(degrees=True)
    stand = ScenarioPlacement(
        base_rotation_deg=tuple(turn.tolist()),
        base_position_mm=tuple((rig_T_base[:3, 3] * 1000).tolist()),
        pan_deg=tuple(np.degrees(played.pan[0]).tolist()),
    )
    swings = [SHARE * a for a in getattr(sample.motion, "amplitude_deg", [])]
    long: Scenario = msgspec.structs.replace(
        sample,
        recording=msgspec.structs.replace(sample.recording, pairs=pairs),
        motion=msgspec.structs.replace(sample.motion, amplitude_deg=swings),
        rig=msgspec.structs.replace(sample.rig, placement=stand),
    )
    return in_memory(long)


SESSIONS, SETTLED = 10_000, 500  # sessions, and after how many memory is compared
MOST_GROWTH_MB = 50.0


def sessions(count: int) -> None:
    """Batch so many copies of one session here, and print memory's peak at each stage."""
    with tempfile.TemporaryDirectory() as place:
        results = analyse(open_session(record(Path(place) / "one", 1)))
        peaks: dict[str, float] = {}

        def copies(tasks: deque[Any]) -> Iterator[tuple[Any, SessionResults]]:
            for number in range(count):
                task = tasks.popleft()
                named = rename_session(results, "", task.found.session)
                named.summary["session"]["started"] = (BEGIN + timedelta(hours=number)).isoformat()
                yield task, pack_results(task.found.session, named, None)
                if number == SETTLED:
                    peaks[f"{SETTLED} sessions"] = _peak_mb()

        pool: Any = SimpleNamespace(ready=lambda: None, run=copies)
        found = [SessionLocation(f"lab/{i:05d}", "") for i in range(count)]
        options = BatchOptions(ToleranceOptions(None, None, None), "1.0")
        done = measure_all(found, [], Path(place), options, pool, lambda _: None)
        peaks["all measured"] = _peak_mb()
        tables.write(Path(place), done.kept, done.failures)
        peaks["tables written"] = _peak_mb()
        rows = tables.read_flat_columns(Path(place) / "sessions.parquet")
        assess(rows, NO_FAILURES, TrendRequest(), ())
        peaks["fleet assessed"] = _peak_mb()
    growth = peaks["tables written"] - peaks[f"{SETTLED} sessions"]
    print(f"{count} sessions: {', '.join(f'{name} {mb:.0f} MB' for name, mb in peaks.items())}")
    print(Figure("growth through the tables", growth, "MB", most=MOST_GROWTH_MB))


def _peak_mb() -> float:
    """This program's own peak; `getrusage` would count its parent's from before it began."""
    status = Path("/proc/self/status").read_text()
    return float(status.partition("VmHWM:")[2].split()[0]) / MEBIBYTE


def _here(pairs: int) -> None:
    start = time.perf_counter()
    session = long_session(pairs)
    peaks = {"before the first pair": _peak_mb()}
    results = analyse(session)
    peaks["analysed"] = _peak_mb()
    with tempfile.TemporaryDirectory() as folder:
        write_report_folder(results, Path(folder) / "out", force=False, frames=True)
    peaks["reported"] = _peak_mb()
    seconds, counts = time.perf_counter() - start, results.summary["pairs"]
    print(json.dumps({**counts, "seconds": seconds, "peak_mb": peaks}))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--here"]:
        _here(int(sys.argv[2]))
    elif sys.argv[1:2] == ["sessions"]:
        sessions(int(sys.argv[2]) if len(sys.argv) > 2 else SESSIONS)
    else:
        for line in lines(int(sys.argv[1]) if len(sys.argv) > 1 else PAIRS):
            print(line)
