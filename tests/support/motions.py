"""Tracks with known truth for tests of clock, comparison and judgement: no pictures needed."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from tests.support.scene import make_marker, make_rig
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.comparison import Comparison, compare, solve_joints
from verify.analysis.model import JointErrorModel, SessionComparison, build_model
from verify.core.readings import Readings
from verify.core.records import Array
from verify.io.session.session import Session
from verify.measurement.systematics import Systematics, stated_systematics
from verify.measurement.track import Track

ARM = robots.load("iust_6r")
HOME = np.deg2rad([35.0, -60.0, 45.0, 5.0, -80.0, 30.0])
SWING = np.deg2rad([12.0, 8.0, 9.0, 12.0, 14.0, 25.0])
PERIOD = np.array([2.9, 3.7, 3.1, 2.3, 4.3, 2.7])  # s
SIGMA = (5e-5, np.deg2rad(0.02))  # m, rad: what pixels leave of a pose


def swinging(t: Array) -> Array:
    """All joints in sines, (n, 6), rad."""
    phase = np.arange(6)
    return HOME + SWING * np.sin(2 * np.pi * t[:, None] / PERIOD + phase)


def make_track(t: Array, q: Array, rng: np.random.Generator, arm: robots.Arm = ARM) -> Track:
    """Poses of the arm at joints q with white noise of SIGMA."""
    n = len(t)
    poses = robots.forward(arm, q)
    turn = Rotation.from_rotvec(rng.normal(0, SIGMA[1], (n, 3))).as_matrix()
    poses[:, :3, :3] = turn @ poses[:, :3, :3]
    poses[:, :3, 3] += rng.normal(0, SIGMA[0], (n, 3))
    return track_of(t, poses, *SIGMA)


def track_of(t: Array, poses: Array, place: float, turn: float) -> Track:
    """Poses (n, 4, 4) at instants t with standard uncertainties of `place` (m) and `turn` (rad)."""
    n = len(t)
    covariance = np.diag([place**2] * 3 + [turn**2] * 3)
    return Track(
        frame=np.arange(n, dtype=float),
        t=t,
        pan=np.zeros((n, 2)),
        base_T_flange=poses,
        covariance_pixels=np.tile(covariance, (n, 1, 1)),
        covariance_alignment=np.zeros((n, 6, 6)),
        acceleration_prior=np.ones((n, 2)),
        order=np.full(n, 4),
        alignment_error=np.zeros((n, 6)),
        systematic=np.zeros((n, 6, 2)),
        tilt=np.zeros((n, 6, 0)),
        determined=(np.eye(6),) * n,
    )


def read(
    motion: Callable[[Array], Array],
    t: Array,
    offset: float,
    rng: np.random.Generator,
    error: Array | float = 0.0,
) -> Readings:
    """Readings on a clock that needs `offset` added, with 0.005° noise and a constant error."""
    q = motion(t) + rng.normal(0, np.deg2rad(0.005), (len(t), 6)) + error
    return Readings(t - offset, q)


PAIRS = np.arange(1.0, 7.0, 1 / 15)
LOG = np.arange(0.0, 8.0, 0.02)
GIVEN = ClockEstimate(0.0, None, "given", np.zeros((0, 2)))
POSTURES = {
    "iust_6r": (35.0, -60.0, 45.0, 5.0, -80.0, 30.0),
    "rv_3sd_melfa": (20.0, 10.0, 80.0, 30.0, 60.0, -40.0),
}


ESTIMATED = replace(GIVEN, source="estimated", standard_uncertainty=1e-4)


def compared(seed: int, error: Array | float = 0.0) -> tuple[Track, Comparison]:
    rng = np.random.default_rng(seed)
    track = make_track(PAIRS, swinging(PAIRS), rng)
    return track, compare(track, ARM, read(swinging, LOG, 0.0, rng, error), 0.0)


def compared_session(
    track: Track, comparison: Comparison, stated: Systematics, clock: ClockEstimate, **of: Any
) -> SessionComparison:
    """A compared session without a folder; `of` is what its files state, ARM by default."""
    unknown = ("encoder_resolution", "encoder_time_standard_uncertainty", "instrument")
    known = {"arm": ARM, **dict.fromkeys(unknown), **of}
    joints = solve_joints(comparison, known["arm"])
    session = cast("Session", SimpleNamespace(**known))
    return SessionComparison(session, track, stated, clock, comparison, joints)


def model_of(
    track: Track, comparison: Comparison, base: str, body: str | None, clock: ClockEstimate = GIVEN
) -> JointErrorModel:
    rig = replace(make_rig(), base_source=base)
    marker = replace(make_marker(), source=body)
    return build_model(
        comparison, track, rig, marker, clock, stated_systematics(rig, marker, turning=False)
    )
