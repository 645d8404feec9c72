"""A session of any length in constant memory: 10,000 pairs from pixels to both reports.

The pairs are rendered as they are asked for, in a process of their own whose peak is then the
chain's: were pictures kept, 10,000 pairs would be 18 GB.

A batch of any number of sessions likewise: each stands for one that was measured, with a name and
a day of its own, and goes through the store, the tables and the fleet report.

    python -m tests.bench.memory [PAIRS]
    python -m tests.bench.memory sessions [N]
"""

import json
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reports import Results
from tests.support.command import verify
from tests.support.fleets import BEGIN, record
from tests.support.simulated import InMemory, in_memory
from verify.analysis.session import analyse
from verify.cli import batch
from verify.fleet.batch import finding, run, tables
from verify.fleet.batch.records import SessionLocation, SessionResults
from verify.fleet.batch.tasks import pack_results, rename_session
from verify.fleet.trends import assess
from verify.io.results import write_report_folder
from verify.io.session.session import open_session
from verify.simulation import library
from verify.simulation.scenario import Scenario, ScenarioPlacement
from verify.simulation.session.simulate import simulate_session

PAIRS = 10_000
MOST_MB = 600.0
SHARE = 0.4  # of the sample's amplitudes: whatever the phases become in ten minutes, all is in view
MEBIBYTE = 1024  # ru_maxrss counts kibibytes


def lines(pairs: int = PAIRS) -> Iterator[str]:
    """Measure in a fresh process; the words of its last line are the outcome."""
    words = [sys.executable, "-m", "tests.bench.memory", "--here", str(pairs)]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    found = json.loads(done.stdout.splitlines()[-1])
    measured = f"{found['measured']} of {found['recorded']} pairs"
    yield f"{measured}, rendered, measured, judged and reported in {found['seconds']:.0f} s"
    stages = ", ".join(f"{name} {peak:.0f} MB" for name, peak in found["peak_mb"].items())
    peak = max(found["peak_mb"].values())
    held = "holds" if peak < MOST_MB else "FAILS"
    yield f"peak memory so far: {stages}; the bound of {MOST_MB:.0f} MB {held}"


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


class CopyingPool:
    """Stands in for the workers: answers with one session's results under each name."""

    def __init__(self, results: Results) -> None:
        self._results = results
        self.settled = 0.0  # MB

    def ready(self) -> None:
        """Nobody need start."""

    def run(self, waiting: deque[Any]) -> Iterator[tuple[Any, SessionResults]]:
        """Answer each task; the memory that has settled is noted."""
        count = 0
        while waiting:
            task = waiting.popleft()
            named = rename_session(self._results, "", task.found.session)
            day = (BEGIN + timedelta(hours=count)).isoformat()
            session = named.summary["session"] | {"started": day}
            named = replace(named, summary=named.summary | {"session": session})
            yield task, pack_results(task.found.session, named, None)
            count += 1
            self.settled = _resident_mb() if count == SETTLED else self.settled

    def close(self) -> None:
        """Nobody need end."""


def sessions(count: int) -> None:
    """Batch so many sessions here, and print what memory did."""
    with tempfile.TemporaryDirectory() as place, pytest.MonkeyPatch.context() as patch:
        pool = CopyingPool(analyse(open_session(record(Path(place) / "one", 1))))
        found = [SessionLocation(f"lab/{i:05d}", f"lab/{i:05d}") for i in range(count)]
        stages, write, read = {}, tables.write, assess.assess
        peak = [0.0]
        stop = threading.Event()

        def sample() -> None:
            while not stop.wait(0.05):
                peak[0] = max(peak[0], _resident_mb())

        def staged(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            def call(*arguments: Any) -> Any:
                done = function(*arguments)
                stages[name], peak[0] = peak[0], 0.0
                return done

            return call

        patch.setattr(batch, "_worker_pool", lambda *_: pool)
        patch.setattr(finding, "find_sessions", lambda *_: (found, []))
        patch.setattr(run, "measure_all", staged("measured", run.measure_all))
        patch.setattr(tables, "write", staged("tables written", write))
        patch.setattr(assess, "assess", staged("assessed", read))
        threading.Thread(target=sample, daemon=True).start()
        outcome = verify("batch", "lab", "-o", Path(place) / "out", "--quiet")
        stop.set()
        stages["reported"] = peak[0]
    growth = max(stages["measured"], stages["tables written"]) - pool.settled
    print(f"exit {outcome.status}; {count} sessions; {pool.settled:.0f} MB after {SETTLED}")
    print(", ".join(f"{name} {most:.0f} MB" for name, most in stages.items()))
    held = "holds" if growth < MOST_GROWTH_MB else "FAILS"
    print(f"grown by {growth:.0f} MB through the tables; the bound of {MOST_GROWTH_MB:.0f} {held}")


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEBIBYTE


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
