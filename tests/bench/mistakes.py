"""How often a mistake is refused and named, and how often a true fault is not.

python -m tests.bench.mistakes [CASES]

Three recordings: both sample arms', measured once through their pictures, and a laser tracker's of
a real UR10 as poses.csv (skipped where its data are not beside the clone), with base and target as
its own motion gives them. Each case makes a usual mistake at a random joint, in the poses or in the
session's facts; or a true fault: an offset to 40°, a gain to 5 %, a belt that slips by up to 20°.
"""

import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from tests.support.published import series, write_session
from verify.analysis.instrument import measure_poses, stated_noise
from verify.analysis.measured import measure_pictures, session_clock
from verify.analysis.mistakes import refuse_misread_pans
from verify.analysis.other_motion import refuse_other_motion
from verify.analysis.plausibility import refuse_misread
from verify.calibration.handeye import solve_robustly
from verify.core.readings import Readings
from verify.core.records import Array, no_progress
from verify.errors import InputError
from verify.io.session.session import Session, open_session
from verify.measurement.chain import measure
from verify.measurement.track import Track

SAMPLES = Path(__file__).parents[2] / "sample_sessions"
NAMES = ("multi_joint_fault_6r", "multi_joint_rv_3sd")
CASES = 100  # a recording
READING_MISTAKES = ("reversed", "zero", "exchanged", "radians", "frozen", "ms", "µs")
SESSION_MISTAKES = ("base inverted", "base in metres", "another arm")
POSE_MISTAKES = ("poses inverted", "quaternion order")
FAULTS = ("offset", "gain", "slip", "none")
Recording = tuple[Session, Track]


def tracker_recording(folder: Path) -> Recording:
    """The laser tracker's, every tenth pose; base and target by its own motion."""
    rows = series("B", 10)
    session = open_session(write_session(folder / "tracker", rows))
    flange = robots.forward(session.arm, rows.q)
    solved, _ = solve_robustly(rows.world_T_target, flange, 6.0)
    assert session.instrument is not None
    instrument = replace(session.instrument, flange_T_body=np.linalg.inv(solved.x))
    session = replace(session, instrument=instrument, rig=replace(session.rig, rig_T_base=solved.y))
    return session, measured(session)


def measured(session: Session) -> Track:
    """Measure the pictures, or take the instrument's poses."""
    if session.instrument is None:
        return measure_pictures(session, no_progress, measure).track
    readings = Readings(session.encoders.t, session.encoders.q)
    noise = stated_noise(session.instrument)
    return measure_poses(session, session.instrument, readings, noise).track


def mistaken(kind: str, t: Array, q: Array, rng: np.random.Generator) -> tuple[Array, Array, str]:
    """Readings (m, 6), rad, at t (m,), s, with a mistake, and what its refusal says."""
    q, joint = q.copy(), int(rng.integers(6))
    if kind == "reversed":
        q[:, joint] *= -1
        return t, q, f"joint {joint + 1} reversed"
    if kind == "zero":
        q[:, joint] += np.deg2rad(int(rng.choice([90, -90, 180])))
        return t, q, f"joint {joint + 1} with its zero moved"
    if kind == "exchanged":
        i, k = sorted(rng.choice(6, 2, replace=False).tolist())
        q[:, [i, k]] = q[:, [k, i]]
        return t, q, f"joints {i + 1} and {k + 1} exchanged"
    if kind == "radians":
        q[:, joint] = np.deg2rad(q[:, joint])
        return t, q, f"joint {joint + 1} taken as radians"
    if kind == "frozen":
        return t, np.tile(q[0], (len(q), 1)), "never change"
    unit, size = {"ms": ("milliseconds", 1e3), "µs": ("microseconds", 1e6)}[kind]
    return t * size, q, unit


def misregistered(kind: str, recording: Recording) -> tuple[Recording, str]:
    """A recording whose session.toml, rig.toml or poses.csv holds a mistake."""
    session, track = recording
    if kind == "another arm":
        other = "rv_3sd" if session.arm.name == "iust_6r" else "iust_6r"
        return (replace(session, arm=robots.load(other)), track), f"robot {session.arm.name}"
    if session.instrument is not None and kind in POSE_MISTAKES:
        poses = session.instrument.poses
        assert poses.rotation is not None
        if kind == "quaternion order":
            last = np.roll(Rotation.from_matrix(poses.rotation).as_quat(), -1, axis=1)
            other = replace(poses, rotation=Rotation.from_quat(last).as_matrix())
        else:
            turn = np.swapaxes(poses.rotation, 1, 2)
            place = -np.einsum("nij,nj->ni", turn, poses.position)
            other = replace(poses, rotation=turn, position=place)
        session = replace(session, instrument=replace(session.instrument, poses=other))
        words = "poses inverted" if kind == "poses inverted" else "whose scalar comes last"
        return (session, measured(session)), words
    base = session.rig.rig_T_base.copy()
    if kind == "base inverted":
        base = np.linalg.inv(base)
    else:
        base[:3, 3] /= 1000
    moved = np.linalg.inv(base) @ session.rig.rig_T_base @ track.base_T_flange
    session = replace(session, rig=replace(session.rig, rig_T_base=base))
    return (session, replace(track, base_T_flange=moved)), kind


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


def refusal(recording: Recording, t: Array, q: Array) -> str:
    """The refusal's text; empty where the readings are taken."""
    session, track = recording
    readings = Readings(t, q)
    try:
        clock = session_clock(session, track, readings)
        if session.instrument is not None:
            refuse_misread(session, session.instrument, track, readings, clock)
        refuse_other_motion(session, track, readings, clock)
    except InputError as error:
        return str(error)
    return ""


def exchanged_refusal(session: Session) -> tuple[str, str]:
    """What is said of left and right exchanged, and what should be."""
    exchanged = replace(session, left=session.right, right=session.left)
    seen = measure_pictures(exchanged, no_progress, measure)
    try:
        refuse_misread_pans(exchanged, seen.measurements)
    except InputError as error:
        return str(error), "left and right exchanged"
    text = refusal((exchanged, seen.track), session.encoders.t, session.encoders.q)
    return text, "left and right exchanged"


def run(recording: Recording, cases: int, counts: Counter[tuple[str, str]]) -> None:
    """Count a recording's outcomes, and print each case that went wrong."""
    session, _ = recording
    t, q = session.encoders.t, session.encoders.q
    others = POSE_MISTAKES if session.instrument is not None else ("left and right",)
    kinds = (*READING_MISTAKES, *SESSION_MISTAKES, *others)
    for case in range(cases):
        rng, began = np.random.default_rng([case, len(session.name)]), time.process_time()
        kind, fault = kinds[case % len(kinds)], FAULTS[case % len(FAULTS)]
        if kind == "left and right":
            text, words = exchanged_refusal(session)
        elif kind in READING_MISTAKES:
            *log, words = mistaken(kind, t, q, rng)
            text = refusal(recording, *log)
        else:
            wrong, words = misregistered(kind, recording)
            text = refusal(wrong, t, q)
        outcome = "named" if words in text else "refused" if text else "taken"
        counts[kind, outcome] += 1
        took = time.process_time() - began
        if outcome != "named":
            print(f"  {session.name}, {words}: {outcome} ({took:.0f} s): {text}", flush=True)
        text = refusal(recording, t, faulty(fault, t, q, rng))
        counts[fault, "refused" if text else "taken"] += 1
        if text:
            print(f"  {session.name}, {case}: {fault}: {text}", flush=True)


def main(cases: int) -> None:
    """Print the counts, and each case that went wrong."""
    counts: Counter[tuple[str, str]] = Counter()
    for name in NAMES:
        session = replace(open_session(SAMPLES / name), clock=None)
        run((session, measured(session)), cases, counts)
    with tempfile.TemporaryDirectory() as folder:
        run(tracker_recording(Path(folder)), cases, counts)
    for (kind, outcome), count in sorted(counts.items()):
        print(f"{kind}: {outcome} {count}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else CASES)
