"""How long a session of 2,000 pairs takes to judge, diagnosis included, beyond its pixels.

Two sessions, at spot level: base and LEDs from a fixture and a jig, and found through the encoders.
Timed is all of a run but finding the spots and writing reports: poses with what is stated carried
to each, clock, comparison, budget with its Monte-Carlo check, resolved errors, sweeps, diagnosis,
repeated poses, tables. One core and one thread; kernels are compiled before.

    python -m tests.bench.judged [PAIRS]
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read when numpy is imported

import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace

import msgspec
import numpy as np

from reports.session.causes import cause_name
from tests.bench.diagnosis.sessions import STATED
from tests.bench.memory import long_session
from tests.support.leds.truth import true_spots
from tests.support.simulated import InMemory, in_memory, measured_at_spots
from verify.analysis.session import analyse
from verify.core.records import Measurement, StereoPair
from verify.measurement.chain import Setup
from verify.measurement.systematics import stated_systematics

PAIRS = 2_000
FEW = 60  # of the session that has everything compiled
GOAL_S = 20.0
SEED = 20261122


def judged(session: InMemory) -> tuple[float, str]:
    """Judge a session whose spots are found already: seconds, and what was found."""
    spots = [true_spots(session.simulated, side) for side in (0, 1)]

    def measured(_pairs: Iterable[StereoPair], _setup: Setup) -> Iterator[Measurement]:
        systematics = stated_systematics(session.rig, session.marker, turning=False)
        rng = np.random.default_rng(SEED)
        yield from measured_at_spots(session, systematics, rng, spots=spots)

    start = time.perf_counter()
    summary = analyse(session, chain=measured).summary
    spent = time.perf_counter() - start
    causes = ", ".join(cause_name(one) for one in summary["diagnosis"])
    return spent, f"{summary['pairs']['measured']} pairs; found: {causes or 'nothing'}"


def sessions(pairs: int) -> Iterator[tuple[str, InMemory]]:
    """The multi-joint sample for as many pairs, everything stated, registered either way."""
    scenario = long_session(pairs).simulated.scenario
    at_once = msgspec.structs.replace(scenario.recording, skew_s=0.0, skew_jitter_s=0.0)
    given = in_memory(msgspec.structs.replace(scenario, uncertainty=STATED, recording=at_once))
    yield "by fixture and jig", given
    fitted = {"rig": replace(given.rig, base_source="motion"),
              "marker": replace(given.marker, source="motion")}  # fmt: skip
    yield "through the encoders", replace(given, **fitted)


def main(pairs: int) -> int:
    """Print seconds beside the goal; 1 where it is missed."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    for _, session in sessions(FEW):
        judged(session)
    missed = False
    for name, session in sessions(pairs):
        spent, found = judged(session)
        missed |= spent > GOAL_S
        verdict = "FAILS" if spent > GOAL_S else "holds"
        print(f"registered {name}: {spent:.1f} s, goal {GOAL_S:.0f} s: {verdict} ({found})")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else PAIRS))
