"""From an arm before a rig to the motion of the next session, and what that would show."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from verify.errors import InputError
from verify.planning.constraints import Constraints
from verify.planning.foresight import Foreseen, Judged, foresee, judge
from verify.planning.prediction import (
    ClockShown,
    Geometry,
    Shown,
    clock_shown,
    geometry_shown,
    shown,
)
from verify.planning.roadmap import Roadmap, roadmap
from verify.planning.selection import FEWEST, selection
from verify.planning.timing import Timed
from verify.planning.wishes import Bench, Conditions, Wish
from verify.records import Array

Progress = Callable[[int, int, str], None]
STAGES = ("postures in view", "poses", "session foreseen")


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a motion would show."""

    foreseen: Foreseen
    judged: Judged
    shown: list[Shown]
    clock: ClockShown
    geometry: Geometry | None


@dataclass(frozen=True, slots=True)
class Plan:
    """The motion, and what it would show."""

    known: Roadmap
    timed: Timed
    prediction: Prediction


def plan(bench: Bench, wish: Wish, conditions: Conditions, progress: Progress) -> Plan:
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
    constraints = Constraints(bench, wish)
    progress(0, len(STAGES), STAGES[0])
    known = roadmap(constraints, rng)
    if len(known.q) < FEWEST:
        raise InputError(
            "plan", f"{len(known.q)} postures in view can be reached from each other",
            f"{FEWEST} or more are needed",
            "Turn the camera bases, move the rig, or give a wider --within-deg.",
        )  # fmt: skip
    progress(1, len(STAGES), STAGES[1])
    timed = selection(constraints, known, conditions, rng).motion()
    progress(2, len(STAGES), STAGES[2])
    t = np.arange(0.0, timed.duration + 1e-9, 1 / conditions.rate)
    prediction = predict(bench, timed.q, t, wish, conditions, rng)
    progress(3, len(STAGES), "")
    return Plan(known, timed, prediction)


def predict(
    bench: Bench,
    motion: Callable[[Array], Array],
    t: Array,
    wish: Wish,
    conditions: Conditions,
    rng: np.random.Generator,
) -> Prediction:
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
    foreseen = foresee(bench, motion, t, conditions, wish.view_angle, rng)
    if foreseen is None:
        raise InputError(
            "plan", f"none of {len(t)} pairs could be measured",
            "the LEDs must be in both pictures and told apart",
            "Look at marker.toml: LEDs of different distances or colours are told apart.",
        )  # fmt: skip
    asked = "kinematics" in wish.observe
    return Prediction(
        foreseen,
        judge(foreseen, bench.arm),
        shown(foreseen.model, wish.observe),
        clock_shown(foreseen),
        geometry_shown(bench, foreseen.model) if asked else None,
    )
