"""How often a mistake in the readings is refused and named, and how often a true fault is not.

python -m tests.bench.mistakes [CASES]

Both sample arms' recordings, measured once through their pictures. Each case changes the readings:
by a usual mistake at a random joint, or by a true fault (an offset to 40°, a gain to 5 %, a belt
that slips by up to 20° on the way).
"""

import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from verify.analysis.clock.estimate import estimate_clock
from verify.analysis.measured import measure_pictures
from verify.analysis.mistakes import refuse_other_motion
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.session.session import Session, open_session
from verify.measurement.chain import measure
from verify.measurement.track import Track

SAMPLES = Path(__file__).parents[2] / "sample_sessions"
NAMES = ("multi_joint_fault_6r", "multi_joint_rv_3sd")
CASES = 60
MISTAKES = ("reversed", "zero", "exchanged", "radians", "frozen")
FAULTS = ("offset", "gain", "slip", "none")


def _no_progress(_done: int, _total: int) -> None:
    """Report no progress."""


def mistaken(kind: str, q: Array, rng: np.random.Generator) -> tuple[Array, str]:
    """Readings (m, 6), rad, with a mistake, and what its refusal says."""
    q, joint = q.copy(), int(rng.integers(6))
    if kind == "reversed":
        q[:, joint] *= -1
        return q, f"joint {joint + 1} reversed"
    if kind == "zero":
        turn = int(rng.choice([90, -90, 180]))
        q[:, joint] += np.deg2rad(turn)
        return q, f"joint {joint + 1} with its zero moved"
    if kind == "exchanged":
        i, k = sorted(rng.choice(6, 2, replace=False).tolist())
        q[:, [i, k]] = q[:, [k, i]]
        return q, f"joints {i + 1} and {k + 1} exchanged"
    if kind == "radians":
        q[:, joint] = np.deg2rad(q[:, joint])
        return q, f"joint {joint + 1} taken as radians"
    q[:] = q[0]
    return q, "never change"


def faulty(kind: str, t: Array, q: Array, rng: np.random.Generator) -> Array:
    """Readings (m, 6), rad, at t (m,), s, of an encoder with a true fault."""
    q, joint = q.copy(), int(rng.integers(6))
    if kind == "offset":
        q[:, joint] += np.deg2rad(rng.uniform(1, 40)) * rng.choice([-1, 1])
    elif kind == "gain":
        q[:, joint] *= 1 + rng.uniform(-0.05, 0.05)
    elif kind == "slip":
        q[t > rng.uniform(t[0], t[-1]), joint] += np.deg2rad(rng.uniform(1, 20))
    return q


def refusal(session: Session, track: Track, q: Array) -> str:
    """The refusal's text; empty where the readings are taken."""
    readings = Readings(session.encoders.t, q)
    clock = estimate_clock(track, session.arm, readings)
    try:
        refuse_other_motion(session, track, readings, clock)
    except InputError as error:
        return str(error)
    return ""


def main(cases: int) -> None:
    """Print the counts, and each case that went wrong."""
    counts: Counter[tuple[str, str]] = Counter()
    for name in NAMES:
        session = replace(open_session(SAMPLES / name), clock=None)
        track = measure_pictures(session, _no_progress, measure).track
        for case in range(cases):
            rng = np.random.default_rng([case, len(name)])
            kind = MISTAKES[case % len(MISTAKES)]
            q, words = mistaken(kind, session.encoders.q, rng)
            text = refusal(session, track, q)
            outcome = "named" if words in text else "refused" if text else "taken"
            counts[kind, outcome] += 1
            if outcome != "named":
                print(f"  {name}, {words}: {outcome}: {text}")
            fault = FAULTS[case % len(FAULTS)]
            text = refusal(
                session, track, faulty(fault, session.encoders.t, session.encoders.q, rng)
            )
            counts[fault, "refused" if text else "taken"] += 1
            if text:
                print(f"  {name}, {fault}: {text}")
    for (kind, outcome), count in sorted(counts.items()):
        print(f"{kind}: {outcome} {count}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else CASES)
