"""From an arm before a rig to the motion of the next session, and what that would show."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from verify.core.records import Array
from verify.errors import InputError
from verify.planning.constraints import PostureConstraints
from verify.planning.foresight import (
    PredictedAnalysis,
    PredictedSession,
    estimate_means,
    simulate_session,
)
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
from verify.planning.selection import MIN_POSES, foresee_visits
from verify.planning.timing import TimedMotion

Progress = Callable[[int, int, str], None]
STAGES = ("postures in view", "poses", "session foreseen")


@dataclass(frozen=True, slots=True)
class SessionPrediction:
    """What a motion would show."""

    foreseen: PredictedSession
    judged: PredictedAnalysis
    shown: list[FaultPrediction]
    clock: ClockPrediction
    geometry: PredictedIdentifiability | None


@dataclass(frozen=True, slots=True)
class SessionPlan:
    """The motion, and what it would show."""

    known: Roadmap
    timed: TimedMotion
    prediction: SessionPrediction


def plan_motion(
    bench: PlanningSetup, wish: PlanRequest, conditions: SessionConditions, progress: Progress
) -> SessionPlan:
    """Choose poses, order and pace.

    Args:
        bench: arm, rig, marker.
        wish: what is to be shown, and within which bounds.
        conditions: what the session is taken to be like.
        progress: called with stages done, stages in all, and the stage that begins.

    Raises:
        InputError: no posture is in view and allowed; too few, or too little time, for a plan.
    """
    rng = np.random.default_rng(wish.seed)
    constraints = PostureConstraints(bench, wish)
    progress(0, len(STAGES), STAGES[0])
    known = build_roadmap(constraints, rng)
    if len(known.q) < MIN_POSES:
        raise InputError(
            "plan", f"{len(known.q)} postures in view can be reached from each other",
            f"{MIN_POSES} or more are needed",
            "Turn the camera bases, move the rig, or give a wider --within-deg.",
        )  # fmt: skip
    progress(1, len(STAGES), STAGES[1])
    timed = foresee_visits(constraints, known, conditions, rng).motion()
    progress(2, len(STAGES), STAGES[2])
    t = np.arange(0.0, timed.duration + 1e-9, 1 / conditions.rate)
    prediction = predict_session(bench, timed.q, t, wish, conditions, rng)
    progress(3, len(STAGES), "")
    return SessionPlan(known, timed, prediction)


def predict_session(
    bench: PlanningSetup,
    motion: Callable[[Array], Array],
    t: Array,
    wish: PlanRequest,
    conditions: SessionConditions,
    rng: np.random.Generator,
) -> SessionPrediction:
    """Say what any motion would show, planned or not.

    Args:
        bench: arm, rig, marker.
        motion: (n,) s to (n, j) rad.
        t: (n,), s, when the left camera takes its pictures.
        wish: which kinds of fault are asked for, and how far the LEDs shine.
        conditions: what the session is taken to be like.
        rng: of the readings' noise.

    Raises:
        InputError: no pair of it could be measured.
    """
    foreseen = simulate_session(bench, motion, t, conditions, wish.view_angle, rng)
    if foreseen is None:
        raise InputError(
            "plan", f"none of {len(t)} pairs could be measured",
            "the LEDs must be in both pictures and told apart",
            "Look at marker.toml: LEDs of different distances or colours are told apart.",
        )  # fmt: skip
    asked = "kinematics" in wish.observe
    return SessionPrediction(
        foreseen,
        estimate_means(foreseen, bench.arm),
        predict_faults(foreseen.model, wish.observe),
        predict_clock(foreseen),
        predict_geometry(bench, foreseen.model) if asked else None,
    )
