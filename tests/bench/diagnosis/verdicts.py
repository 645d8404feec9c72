"""Verdicts on one joint whose error has no mean to speak of: sessions of poses with known truth."""

from dataclasses import replace

import numpy as np

from tests.support.motions import ARM, HOME, PERIOD, make_track, read
from tests.support.scene import make_marker, make_rig
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.comparison import compare
from verify.analysis.joint_errors import resolve_errors
from verify.analysis.model import build_model, visibility
from verify.analysis.verdict import judge_joint
from verify.core.readings import Readings
from verify.core.records import Array
from verify.measurement.systematics import stated_systematics

TOLERANCE = np.deg2rad(0.2)
CASES = (
    ("healthy", "conform", 1.0),
    ("gain ±0.30° at the ends", "nonconform", 0.95),
    ("backlash 0.6°", "nonconform", 0.95),
    ("eccentricity 0.3°", "nonconform", 0.95),
)
PAIRS = np.arange(1.0, 7.0, 1 / 15)
LOG = np.arange(0.0, 8.0, 0.02)
SWING = np.deg2rad([30.0, 20.0, 20.0, 25.0, 30.0, 40.0])
WIDE = np.deg2rad(95.0)  # of the joint at fault: an eccentricity shows both its ends
GIVEN = ClockEstimate(0.0, None, "given", np.zeros((0, 2)))


def verdicts(seed: int) -> dict[str, str | None]:
    """The verdict on the joint at fault in every case; of a sound arm, on all joints."""
    rng = np.random.default_rng(seed)
    phase, joint = rng.uniform(0, 2 * np.pi, 6), int(rng.integers(6))
    swing = np.where(np.arange(6) == joint, WIDE, SWING)

    def motion(t: Array) -> Array:
        moved: Array = HOME + swing * np.sin(2 * np.pi * t[:, None] / PERIOD + phase)
        return moved

    track = make_track(PAIRS, motion(PAIRS), rng)
    sound = read(motion, LOG, 0.0, rng)
    rig, marker = replace(make_rig(), base_source="fixture"), make_marker(source="jig")
    message: dict[str, str | None] = {}
    for case, _, _ in CASES:
        q = sound.q.copy()
        q[:, joint] += _error(case, motion(LOG)[:, joint])
        comparison = compare(track, ARM, Readings(sound.t, q), 0.0)
        model = build_model(
            comparison, track, rig, marker, GIVEN, stated_systematics(rig, marker, turning=False)
        )
        resolved, least = resolve_errors(model), visibility(model).detectable
        each = {judge_joint(resolved, j, TOLERANCE, float(least[j])).verdict for j in range(6)}
        own = judge_joint(resolved, joint, TOLERANCE, float(least[joint])).verdict
        message[case] = own if case != "healthy" or len(each) == 1 else None
    return message


def _error(case: str, q: Array) -> Array:
    """Reading less true angle, of mean next to nothing."""
    middle, half = (q.max() + q.min()) / 2, np.ptp(q) / 2
    shapes: dict[str, Array] = {
        "healthy": np.zeros_like(q),
        "gain": 0.30 * (q - middle) / half,
        "backlash": 0.3 * np.sign(np.gradient(q)),
        "eccentricity": 0.3 * np.sin(q - middle),
    }
    return np.asarray(np.deg2rad(shapes[case.split(" ")[0]]), dtype=np.float64)
