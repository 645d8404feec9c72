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
from functools import partial

import msgspec
import numpy as np

import robots
from reports.session.causes import cause_name
from tests.bench.diagnosis.sessions import STATED, sighting, stated_doubt
from tests.bench.memory import long_session
from tests.support.simulated import InMemory, in_memory
from verify.analysis.session import analyse
from verify.core.records import Array, Measurement, StereoPair
from verify.measurement.chain import Setup
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import stated_systematics

PAIRS = 2_000
FEW = 60  # of the session that has everything compiled
GOAL_S = 20.0
SEED = 20261122


def judged(session: InMemory) -> tuple[float, str]:
    """Judge a session whose spots are found already: seconds, and what was found."""
    spots = [session.simulated.spots(side) for side in (0, 1)]

    def measured(_pairs: Iterable[StereoPair], _setup: Setup) -> Iterator[Measurement]:
        yield from _measured(session, spots)

    start = time.perf_counter()
    summary = analyse(session, chain=measured).summary
    spent = time.perf_counter() - start
    causes = ", ".join(cause_name(one) for one in summary["diagnosis"])
    return spent, f"{summary['pairs']['measured']} pairs; found: {causes or 'nothing'}"


def _measured(session: InMemory, spots: list[Array]) -> Iterator[Measurement]:
    """Poses from true spots with white noise."""
    rig, marker, played = session.rig, session.marker, session.simulated
    systematics, rng = stated_systematics(rig, marker, turning=False), np.random.default_rng(SEED)
    for i, q in enumerate(session.truth):
        left, right = (sighting(played, spots[side][i], side, i, rng) for side in (0, 1))
        start = rig.rig_T_base @ robots.forward(session.arm, q)
        doubt = partial(stated_doubt, session, systematics, left, right)
        pose = fit_pose(left, right, rig, marker, start, doubt)
        yield Measurement(i, left.t, "measured", len(marker), pose, left, right)


def sessions(pairs: int) -> Iterator[tuple[str, InMemory]]:
    """The multi-joint sample for as many pairs, everything stated, registered either way."""
    scenario = long_session(pairs).simulated.scenario
    at_once = msgspec.structs.replace(scenario.recording, skew_s=0.0, skew_jitter_s=0.0)
    given = in_memory(msgspec.structs.replace(scenario, uncertainty=STATED, recording=at_once))
    yield "by fixture and jig", given
    yield (
        "through the encoders",
        replace(
            given,
            rig=replace(given.rig, base_source="motion"),
            marker=replace(given.marker, source="motion"),
        ),
    )


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
