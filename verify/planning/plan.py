"""Plan the motion of the next session, and predict what it would show."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from verify.core.records import Array
from verify.errors import InputError
from verify.planning import foresight
from verify.planning.constraints import PostureConstraints
from verify.planning.prediction import (
    ClockPrediction,
    FaultPrediction,
    PredictedIdentifiability,
    predict_clock,
    predict_faults,
    predict_geometry,
)
from verify.planning.request import PlanningSetup, PlanRequest, SessionConditions
from verify.planning.roadmap import Roadmap, build_roadmap
from verify.planning.selection import MIN_POSES, TimedMotion, predict_visits

Progress = Callable[[int, int, str], None]
MAX_PAIRS = 36_000  # an hour, ten a second: their prediction takes 3 GB
STAGES = ("postures in view", "poses", "session predicted")


@dataclass(frozen=True, slots=True)
class SessionPrediction:
    """Results that a motion is predicted to give."""

    session: foresight.PredictedSession
    analysis: foresight.PredictedAnalysis
    faults: list[FaultPrediction]
    clock: ClockPrediction
    geometry: PredictedIdentifiability | None


@dataclass(frozen=True, slots=True)
class SessionPlan:
    """The motion, and its predicted results."""

    roadmap: Roadmap
    timed: TimedMotion
    prediction: SessionPrediction


def plan_motion(
    setup: PlanningSetup, request: PlanRequest, conditions: SessionConditions, progress: Progress
) -> SessionPlan:
    """Choose poses, order and pace; the conditions are assumed of the session.

    `progress` is called with stages done, stages in all, and the stage that begins.

    Raises:
        InputError: no posture is in view and allowed; too few, or too little time, for a plan; or
            more pairs than can be predicted.
    """
    rng = np.random.default_rng(request.seed)
    constraints = PostureConstraints(setup, request)
    progress(0, len(STAGES), STAGES[0])
    roadmap = build_roadmap(constraints, rng)
    if len(roadmap.q) < MIN_POSES:
        raise InputError(
            "plan", f"{len(roadmap.q)} postures in view can be reached from each other",
            f"{MIN_POSES} or more are needed",
            "Turn the camera bases, move the rig, or give a wider --within-deg.",
        )  # fmt: skip
    progress(1, len(STAGES), STAGES[1])
    timed = predict_visits(constraints, roadmap, conditions, rng).motion()
    pairs = timed.duration * conditions.rate
    if pairs > MAX_PAIRS:
        raise InputError(
            "--rate-hz", f"{pairs:.3g} pairs in a motion of {timed.duration:.3g} s",
            f"at most {MAX_PAIRS:,} can be predicted",
            "Give a higher --speed-deg-s, fewer poses, a shorter --hold-s or a lower --rate-hz.",
        )  # fmt: skip
    progress(2, len(STAGES), STAGES[2])
    t = np.arange(0.0, timed.duration + 1e-9, 1 / conditions.rate)
    prediction = predict_session(setup, timed.q, t, request, conditions, rng)
    progress(3, len(STAGES), "")
    return SessionPlan(roadmap, timed, prediction)


def predict_session(
    setup: PlanningSetup,
    motion: Callable[[Array], Array],
    t: Array,
    request: PlanRequest,
    conditions: SessionConditions,
    rng: np.random.Generator,
) -> SessionPrediction:
    """Predict what any motion, (n,) s to (n, j) rad, would show, planned or not.

    The left camera takes its pictures at t (n,), s. The request gives the kinds of fault and the
    LEDs' angle of view.

    Raises:
        InputError: no pair of it could be measured.
    """
    session = foresight.simulate_session(setup, motion, t, conditions, request.view_angle, rng)
    if session is None:
        raise InputError(
            "plan", f"none of {len(t)} pairs could be measured",
            "the LEDs must be identified in both pictures",
            "Give LEDs in marker.toml uneven distances or different colours.",
        )  # fmt: skip
    geometry = "kinematics" in request.observe
    return SessionPrediction(
        session,
        foresight.estimate_means(session),
        predict_faults(session.model, request.observe),
        predict_clock(session),
        predict_geometry(setup, session.model) if geometry else None,
    )
